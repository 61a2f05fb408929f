"""The surface of a segmented body between its voxels, and the signed distance to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage as ndi
from scipy.spatial import cKDTree

from ..core.errors import InputError
from .labels import TISSUES, Label
from .meshing import Function
from .volume import Volume

LEVEL = 0.5  # a voxel on the surface is half body
MARGIN = 4  # voxels around the body that are kept


def body_share(labels: Volume, tissue: Volume | None = None) -> tuple[Volume, tuple[str, ...]]:
    """Share of the body in each voxel, cut to the box around its largest piece, without holes.

    Parameters
    ----------
    labels : Volume
        (nz, ny, nx) of `Label`; the body is what is fat, gland, skin or tumour.
    tissue : Volume, optional
        Share 0 .. 1 of tissue in each voxel of the same grid; left out, each voxel counts whole or not at all.

    Returns
    -------
    Volume
        (nz, ny, nx) float32, 0 .. 1; it ends where the image ends, or `MARGIN` voxels off the body.
    tuple of str
        What was left out or filled.

    Raises
    ------
    InputError
        If the labels hold no breast, or the grids differ.
    """
    if tissue is not None and tissue.shape != labels.shape:
        raise InputError(
            f"tissue shares must lie on the grid of the labels, {labels.shape} voxels; got {tissue.shape}."
        )
    mask = np.isin(labels.values, TISSUES) if tissue is None else tissue.values > LEVEL
    if not mask.any():
        raise InputError(
            "labels: no voxel of the breast; at least one of 1 fat, 2 gland, 3 skin or 4 tumour is needed."
        )
    box = _box(mask)
    mask = mask[box]
    body, notes = _whole(mask)
    share = body.astype(np.float32)
    if tissue is not None:
        near = ndi.binary_dilation(body)
        filled = body & ~mask
        share = np.where(near & ~filled, np.clip(tissue.values[box], 0, 1), share).astype(np.float32)
    origin = labels.position(np.array([s.start for s in box]))
    out = Volume(share, labels.spacing_mm, (float(origin[0]), float(origin[1]), float(origin[2])))
    return out, notes


def _box(mask: np.ndarray) -> tuple[slice, slice, slice]:
    """Box around a mask, `MARGIN` voxels wider."""
    box = ndi.find_objects(mask.astype(np.uint8))[0]
    z, y, x = (slice(max(s.start - MARGIN, 0), s.stop + MARGIN) for s in box)
    return z, y, x


def _whole(mask: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Largest piece of a mask with its holes filled, and what that changed."""
    pieces, n = ndi.label(mask)  # pyright: ignore[reportGeneralTypeIssues]
    notes = []
    if n > 1:
        sizes = np.bincount(pieces.ravel())[1:]
        mask = pieces == 1 + int(np.argmax(sizes))
        notes.append(
            f"the largest of {n} pieces was kept; {sizes.sum() - sizes.max()} of {sizes.sum()} voxels left out"
        )
    filled = ndi.binary_fill_holes(mask)
    n_holes = int(filled.sum() - mask.sum())  # pyright: ignore[reportOptionalMemberAccess]
    if n_holes:
        notes.append(f"holes of {n_holes} voxels inside the body were filled")
    return filled, tuple(notes)  # pyright: ignore[reportReturnType]


@dataclass(frozen=True, eq=False)
class Isosurface:
    """Points of a surface with its outward normals, dense against what is measured from it.

    Parameters
    ----------
    points : (n, 3) array [mm]
        Where lines between neighbouring voxel centres cross the surface.
    normals : (n, 3) array
        Unit vectors out of the body.
    share : Volume
        (nz, ny, nx), smoothed share of the body: more than half is inside.
    """

    points: np.ndarray
    normals: np.ndarray
    share: Volume

    @cached_property
    def tree(self) -> cKDTree:
        """Nearest-neighbour search among the points."""
        return cKDTree(self.points)

    def distance(self, x: np.ndarray, reach_mm: float = np.inf) -> np.ndarray:
        """Signed distance, negative inside: (n, 3) [mm] -> (n,) [mm]; what is farther than ``reach_mm`` is said to be that far.

        Within two voxels of the surface it is measured to the tangent plane at the nearest point.
        """
        away, near = self.tree.query(x, distance_upper_bound=reach_mm)
        sign = np.where(self.share.sample(x) > LEVEL, -1.0, 1.0)
        out = sign * np.minimum(away, reach_mm)
        close = away < 2 * max(self.share.spacing_mm)
        to_point = x[close] - self.points[near[close]]
        out[close] = np.einsum("ij,ij->i", to_point, self.normals[near[close]])
        return out


def isosurface(share: Volume, smooth_voxels: float = 0.0) -> Isosurface:
    """Surface where the smoothed share of the body is one half.

    Parameters
    ----------
    share : Volume
        (nz, ny, nx), 0 .. 1.
    smooth_voxels : float
        Standard deviation of the smoothing along each axis, in voxels: what is finer is the image's steps, not her shape.
    """
    u = share.with_values(ndi.gaussian_filter(share.values, smooth_voxels, mode="nearest"))
    points = np.concatenate([_crossings(u, axis) for axis in range(3)])
    steps = 0.5 * np.diag(u.spacing_mm)
    slope = np.stack([(u.sample(points + h) - u.sample(points - h)) / h.sum() for h in steps], axis=-1)
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    return Isosurface(points, -slope / np.maximum(length, 1e-12), u)


def _crossings(u: Volume, axis: int) -> np.ndarray:
    """Where lines along an array axis cross the level (n, 3) [mm]."""
    low, high = (np.take(u.values, np.arange(k, u.shape[axis] - 1 + k), axis) for k in (0, 1))
    index = np.nonzero((low > LEVEL) != (high > LEVEL))
    at = np.stack(index, axis=-1).astype(float)
    at[:, axis] += (LEVEL - low[index]) / (high[index] - low[index])
    return u.position(at)


def wall_side(labels: Volume) -> Function | None:
    """Say of points (n, 3) [mm] of the surface whether chest or air is nearer; None where the labels hold no chest."""
    if not (labels.values == Label.CHEST).any():
        return None
    kinds = (labels.values == Label.CHEST).astype(np.float32) - (labels.values == Label.AIR)
    chest_over_air = labels.with_values(ndi.gaussian_filter(kinds, 1.0, mode="nearest"))
    return lambda points: chest_over_air.sample(points) > 0
