"""Regular grid of voxels in patient space (LPS: x to the patient's left, y posterior, z superior) [mm]."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy  # SciPy imports its submodules at first use

TOWARDS = {"L": (0, 1), "R": (0, -1), "P": (1, 1), "A": (1, -1), "S": (2, 1), "I": (2, -1)}  # LPS axis and direction


def _is_right_handed(letters: tuple[str, ...]) -> bool:
    directions = np.zeros((3, 3))
    for row, letter in enumerate(letters):
        axis, sign = TOWARDS[letter]
        directions[row, axis] = sign
    return bool(np.linalg.det(directions) > 0.5)


AXES = tuple("".join(letters) for letters in product(TOWARDS, repeat=3) if _is_right_handed(letters))
"""Directions that the x, y and z axes of a file may have, right-handed: "LPS", "RIA", ... (24 in all)."""


@dataclass(frozen=True)
class Volume:
    """Voxels on an axis-aligned LPS grid.

    Parameters
    ----------
    values : (nz, ny, nx) or (n_channels, nz, ny, nx) array
        Voxel values; their unit depends on the use.
    spacing_mm : (3,) tuple of float
        Voxel edge along x, y, z [mm].
    origin_mm : (3,) tuple of float
        Centre of voxel ``[0, 0, 0]`` along x, y, z, LPS [mm].
    """

    values: np.ndarray
    spacing_mm: tuple[float, float, float]
    origin_mm: tuple[float, float, float]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along z, y, x."""
        nz, ny, nx = self.values.shape[-3:]
        return nz, ny, nx

    def with_values(self, values: np.ndarray) -> Volume:
        """Return a volume with other values on the same grid."""
        return Volume(values, self.spacing_mm, self.origin_mm)

    def every(self, steps: tuple[int, int, int]) -> Volume:
        """Return a volume of every n-th voxel along z, y, x, starting with the first."""
        values = self.values[(..., *(slice(None, None, n) for n in steps))]
        sz, sy, sx = (spacing * n for spacing, n in zip(self.spacing_mm[::-1], steps))
        return Volume(np.ascontiguousarray(values), (sx, sy, sz), self.origin_mm)

    def from_axes(self, axes: str) -> Volume:
        """Return the voxels (nz, ny, nx) reordered to LPS; ``axes``, one of `AXES`, are the present directions of x, y, z."""
        source = {TOWARDS[letter][0]: (old, TOWARDS[letter][1]) for old, letter in enumerate(axes)}
        order = [source[new] for new in range(3)]  # old axis and its direction for each new axis
        values = self.values.transpose([2 - old for old, _ in reversed(order)])
        values = values[tuple(slice(None, None, sign) for _, sign in reversed(order))]
        spacing = [self.spacing_mm[old] for old, _ in order]
        ends = [self.axis(2 - old)[0 if sign > 0 else -1] * sign for old, sign in order]
        return Volume(np.ascontiguousarray(values), (spacing[0], spacing[1], spacing[2]), (ends[0], ends[1], ends[2]))

    def voxel(self, points_mm: np.ndarray) -> np.ndarray:
        """Return fractional voxel indices: points (..., 3) x, y, z [mm] -> (..., 3) z, y, x [1]."""
        index = (np.asarray(points_mm, float) - self.origin_mm) / self.spacing_mm
        return index[..., ::-1]

    def position(self, index_zyx: np.ndarray) -> np.ndarray:
        """Return physical positions: indices (..., 3) z, y, x -> (..., 3) x, y, z [mm]."""
        return np.asarray(index_zyx, float)[..., ::-1] * self.spacing_mm + self.origin_mm

    def axis(self, number: int) -> np.ndarray:
        """Return the voxel centres along an array axis (0 z, 1 y, 2 x) [mm]."""
        return self.origin_mm[2 - number] + np.arange(self.shape[number]) * self.spacing_mm[2 - number]

    def nearest(self, points_mm: np.ndarray) -> np.ndarray:
        """Return the values of the nearest voxels: points (..., 3) [mm] -> (...) or (n_channels, ...)."""
        index = np.clip(np.rint(self.voxel(points_mm)).astype(int), 0, np.array(self.shape) - 1)
        return self.values[(..., *np.moveaxis(index, -1, 0))]

    def sample(self, points_mm: np.ndarray, order: int = 1) -> np.ndarray:
        """Interpolate at points (..., 3) [mm] -> (...) or (n_channels, ...); outside the grid the nearest voxel is used."""
        coordinates = np.moveaxis(self.voxel(points_mm), -1, 0)
        channels = self.values if self.values.ndim == 4 else self.values[None]
        out = np.stack(
            [scipy.ndimage.map_coordinates(c, coordinates, order=order, mode="nearest", output=float) for c in channels]
        )
        return out if self.values.ndim == 4 else out[0]
