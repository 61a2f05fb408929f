"""The chest wall as a smooth surface beyond what an image shows of it: its signed distance, and the fold below the breast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy import ndimage as ndi
from scipy.interpolate import RectBivariateSpline
from scipy.sparse.linalg import spsolve

from ..core.errors import InputError
from .labels import TISSUES
from .volume import Volume

GRID_MM = 3.0  # voxel edge of the distance field
MARGIN_MM = 20.0  # the field reaches this far beyond the body
BEYOND_MM = 30.0  # the wall is extended this far beyond the field, for the feet of its perpendiculars
SMOOTHING_MM = 4.0  # standard deviation of the Gaussian that passes half of the wave of which the smoothing passes half
DENSE_MM = 1.0  # distance of the points of the wall, between which it is interpolated linearly
STEPS = 5  # steps to the foot of a perpendicular


def wall_distance(domain: Volume, wall_mm: np.ndarray) -> Volume:
    """Return the signed distance to the chest wall on a regular grid around the body, positive in front of the wall.

    The wall behind the body is smoothed, and extended beyond it with the least bending (a thin-plate spline), so that the
    distance is smooth across the border of the body and of the image. The distance is that to the tangent plane at the foot of
    the perpendicular.

    Parameters
    ----------
    domain : Volume
        (nz, ny, nx) of `Label`; the body's tissue is labelled as tissue.
    wall_mm : (nz, nx) array
        y of the wall [mm]; NaN where it is unknown. Only columns of the body are used.

    Returns
    -------
    Volume
        (mz, my, mx) float [mm], voxels of 3 mm.

    Raises
    ------
    InputError
        If no wall is known behind the body.
    """
    body = np.isin(domain.values, TISSUES)
    known = body.any(axis=1) & np.isfinite(wall_mm)
    if np.count_nonzero(known) < 3:
        raise InputError(
            "labels: no chest wall is found behind the breast (along y); label the chest as 5, or let the breast end at the "
            "rear edge of the image."
        )
    z, x = domain.axis(0)[np.nonzero(known)[0]], domain.axis(2)[np.nonzero(known)[1]]
    index = np.argwhere(body)
    box = domain.position(np.stack([index.min(axis=0), index.max(axis=0)])) + MARGIN_MM * np.array([[-1.0], [1.0]])
    share = domain.spacing_mm[0] * domain.spacing_mm[2] / GRID_MM**2
    surface = _Surface.near(np.stack([x, wall_mm[known], z], axis=-1), share, box)
    grid = _grid(box)
    return grid.with_values(surface.distance(grid))


def inframammary_fold(labels: Volume) -> np.ndarray:
    """Return x of each column and z of the lower border of the breast's base on the wall there (2, nx) [mm].

    z is NaN in columns without breast, and where the image ends below the breast.
    """
    base = np.isin(labels.values, TISSUES).any(axis=1)
    lowest = base.argmax(axis=0)
    z = np.where(base.any(axis=0) & (lowest > 0), labels.axis(0)[lowest] - 0.5 * labels.spacing_mm[2], np.nan)
    return np.stack([labels.axis(2), z])


@dataclass(frozen=True, eq=False)
class _Surface:
    """Smooth surface y(x, z): heights and slopes (nz, nx) on a plane grid with the position of its first node [mm]."""

    heights: np.ndarray
    slopes: tuple[np.ndarray, np.ndarray]
    first_mm: tuple[float, float]

    @classmethod
    def near(cls, points: np.ndarray, share: float, box: np.ndarray) -> _Surface:
        """Return the surface of least bending near points (n, 3) [mm], over a box (2, 3) [mm] and beyond.

        Each point stands for a share of a cell of the plane grid [1].
        """
        (low_x, _, low_z), (high_x, _, high_z) = box + BEYOND_MM * np.array([[-1.0], [1.0]])
        nodes_x, nodes_z = np.arange(low_x, high_x + GRID_MM, GRID_MM), np.arange(low_z, high_z + GRID_MM, GRID_MM)
        index = (points[:, [2, 0]] - (low_z, low_x)) / GRID_MM
        heights = _least_bending(index, points[:, 1], share, (len(nodes_z), len(nodes_x)))
        spline = RectBivariateSpline(nodes_z, nodes_x, heights)
        dense = np.arange(low_z, high_z, DENSE_MM), np.arange(low_x, high_x, DENSE_MM)
        return cls(spline(*dense), (spline(*dense, dy=1), spline(*dense, dx=1)), (low_z, low_x))

    def distance(self, grid: Volume) -> np.ndarray:
        """Return the signed distance of the points of a grid, positive in front: -> (mz, my, mx) [mm].

        A distance transform finds the voxel of the surface nearest to a point, and steps to the foot of the perpendicular on the
        tangent plane refine it.
        """
        points = grid.position(np.moveaxis(np.indices(grid.shape), 0, -1))
        foot = self._nearest_columns(grid, points)
        best = np.full(grid.shape, np.inf)
        out = np.zeros(grid.shape)
        for _ in range(STEPS):
            on, normal = self._at(foot)
            away = points - on
            off = np.linalg.norm(away, axis=-1)
            along = np.einsum("...i,...i->...", away, normal)
            nearer = off < best
            best, out = np.where(nearer, off, best), np.where(nearer, along, out)
            step = np.clip((points - along[..., None] * normal - on)[..., [2, 0]], -GRID_MM, GRID_MM)
            foot = foot + step
        return out

    def _nearest_columns(self, grid: Volume, points: np.ndarray) -> np.ndarray:
        """Return z and x of the voxel of the surface nearest to each point of a grid (mz, my, mx, 2) [mm]."""
        front = points[..., 1] < self._at(points[..., [2, 0]])[0][..., 1]
        index = np.empty((3, *grid.shape), np.int32)
        for mask in (front, ~front):
            ends = ndi.distance_transform_edt(mask, return_distances=False, return_indices=True)
            index[:, mask] = np.asarray(ends)[:, mask]
        return points[tuple(index)][..., [2, 0]]

    def _at(self, foot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points of the surface and its normals towards the front at z and x: (..., 2) [mm] -> two (..., 3)."""
        index = np.moveaxis((foot - self.first_mm) / DENSE_MM, -1, 0)
        y, slope_x, slope_z = (
            ndi.map_coordinates(field, index, order=1, mode="nearest") for field in (self.heights, *self.slopes)
        )
        normal = np.stack([slope_x, -np.ones_like(y), slope_z], axis=-1)
        on = np.stack([foot[..., 1], y, foot[..., 0]], axis=-1)
        return on, normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def _least_bending(index: np.ndarray, heights: np.ndarray, share: float, shape: tuple[int, int]) -> np.ndarray:
    """Return heights of the nodes of a grid (m, n) that pass near given ones and bend least, by the energy of a thin plate.

    A wave of wavenumber k is passed by 1 / (1 + w k^4). The weight w is such that the wave of which a Gaussian with standard
    deviation `SMOOTHING_MM` passes half is passed by half.

    Parameters
    ----------
    index : (p, 2) array
        Fractional row and column of each given height.
    heights : (p,) array
        Given heights [mm].
    share : float
        Share of a cell for which each stands [1].
    shape : (2,) tuple
        Numbers of nodes m and n.
    """
    m, n = shape
    weight = (SMOOTHING_MM**2 / (2 * np.log(2))) ** 2 / GRID_MM**4
    twist = np.sqrt(2.0) * sp.kron(_differences(m, 1), _differences(n, 1))
    parts = [sp.kron(_differences(m, 2), sp.eye_array(n)), sp.kron(sp.eye_array(m), _differences(n, 2)), twist]
    bending = sum((part.T @ part for part in parts), sp.csr_array((m * n, m * n)))
    at = _interpolation(index, shape)
    matrix = sp.csc_array(share * at.T @ at + weight * bending)
    return np.asarray(spsolve(matrix, share * (at.T @ heights))).reshape(m, n)


def _interpolation(index: np.ndarray, shape: tuple[int, int]) -> sp.csr_array:
    """Return the matrix of bilinear interpolation at fractional indices (p, 2) of a grid (m, n): (p, m n)."""
    low = np.floor(index).astype(int)
    up = index - low
    rows = np.arange(len(index))
    parts = [
        (np.abs(1 - i - up[:, 0]) * np.abs(1 - j - up[:, 1]), (low[:, 0] + i) * shape[1] + low[:, 1] + j)
        for i in (0, 1)
        for j in (0, 1)
    ]
    values, columns = (np.concatenate(part) for part in zip(*parts, strict=True))
    return sp.csr_array((values, (np.tile(rows, 4), columns)), shape=(len(index), shape[0] * shape[1]))


def _differences(n: int, order: int) -> sp.csr_array:
    """Return the matrix (n - order, n) of forward differences of first or second order."""
    return sp.csr_array(np.diff(np.eye(n), order, axis=0))


def _grid(box: np.ndarray) -> Volume:
    """Return an empty volume over a box (2, 3) [mm]."""
    nx, ny, nz = np.ceil((box[1] - box[0]) / GRID_MM).astype(int) + 1
    x, y, z = box[0].tolist()
    return Volume(np.zeros((nz, ny, nx)), (GRID_MM, GRID_MM, GRID_MM), (x, y, z))
