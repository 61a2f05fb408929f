"""What lies outside of a body: air, the chest wall behind it, the trunk beside it, or the edge of the image."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum

import numpy as np
from scipy import ndimage as ndi

from .labels import TISSUES, Label
from .volume import Volume

BorderAt = Callable[[np.ndarray], np.ndarray]


class Border(IntEnum):
    """Type of an outer face of a body.

    The body slides on the chest wall behind it. It is held on its rim, where it ends in tissue beside it, and on cuts, where
    the image ends.
    """

    SKIN = 1
    WALL = 2
    CUT = 3
    RIM = 4


def wall_heights(labels: Volume) -> np.ndarray:
    """Return the y of the border between the breast and the chest behind it (nz, nx) [mm]; NaN in columns without.

    In a map without chest the breast is cut off where the image ends at the rear, and that cut is the wall.
    """
    breast = np.isin(labels.values, TISSUES)
    last = labels.shape[1] - 1 - breast[:, ::-1].argmax(axis=1)
    edge = labels.origin_mm[1] + (last + 0.5) * labels.spacing_mm[1]
    if (labels.values == Label.CHEST).any():
        next_one = np.minimum(last + 1, labels.shape[1] - 1)
        behind = np.take_along_axis(labels.values, next_one[:, None], axis=1)[:, 0] == Label.CHEST
    else:
        behind = breast[:, -1]
    return np.where(breast.any(axis=1) & behind, edge, np.nan)


def behind_wall(labels: Volume, wall_mm: np.ndarray) -> np.ndarray:
    """Return the chest voxels behind the wall, whose y is given (nz, nx) [mm]: (nz, ny, nx) bool."""
    return (labels.values == Label.CHEST) & (labels.axis(1)[None, :, None] > wall_beside(labels, wall_mm)[:, None, :])


def border_at(labels: Volume, wall_mm: np.ndarray) -> BorderAt:
    """Return a function that gives the `Border` at points of the surface inside the image: (n, 3) [mm] -> (n,) uint8.

    A point is on the skin if there is more air than chest near it, otherwise on the wall if more of the chest near it lies
    behind the wall than beside the body. Without any chest label every point is on the skin.

    Parameters
    ----------
    labels : Volume
        (nz, ny, nx) of `Label`, with the body's tissue labelled as tissue.
    wall_mm : (nz, nx) array
        y of the chest wall [mm]; NaN where there is none.
    """
    chest = labels.values == Label.CHEST
    if not chest.any():
        return lambda points: np.full(len(points), Border.SKIN, np.uint8)
    chest_over_air = _smooth(labels, chest, labels.values == Label.AIR)
    behind = behind_wall(labels, wall_mm)
    behind_over_beside = _smooth(labels, behind, chest & ~behind)

    def border(points: np.ndarray) -> np.ndarray:
        held = np.where(behind_over_beside.sample(points) > 0, Border.WALL, Border.RIM)
        return np.where(chest_over_air.sample(points) > 0, held, Border.SKIN).astype(np.uint8)

    return border


def _smooth(labels: Volume, more: np.ndarray, less: np.ndarray) -> Volume:
    """Return the smoothed difference of two masks (nz, ny, nx)."""
    return labels.with_values(ndi.gaussian_filter(more.astype(np.float32) - less, 1.0, mode="nearest"))


def flat_border(labels: Volume, wall_mm: np.ndarray, tolerance_mm: float) -> BorderAt:
    """Return a function that gives the `Border` at points on the image's edge: (n, 3) [mm] -> (n,) uint8.

    A point within a tolerance of the wall (nz, nx) [mm], extended by its nearest columns, is on the wall; others are on a cut.
    """
    wall = extended(wall_mm)

    def border(points: np.ndarray) -> np.ndarray:
        on_wall = np.abs(height_at(labels, wall, points) - points[:, 1]) < tolerance_mm
        return np.where(on_wall, Border.WALL, Border.CUT).astype(np.uint8)

    return border


def height_at(labels: Volume, wall_mm: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the y of the wall (nz, nx) [mm] in the nearest columns of points: (..., 3) [mm] -> (...) [mm]."""
    return labels.with_values(wall_mm[:, None, :]).nearest(points)


def wall_beside(labels: Volume, wall_mm: np.ndarray) -> np.ndarray:
    """Return the wall (nz, nx) [mm] behind the body, and beside it as high as in the nearest column of the body."""
    columns = np.isin(labels.values, TISSUES).any(axis=1)
    return extended(np.where(columns, wall_mm, np.nan))


def extended(wall_mm: np.ndarray) -> np.ndarray:
    """Return a height map (nz, nx) whose NaN are replaced by the values of the nearest columns; all NaN stays."""
    unknown = np.isnan(wall_mm)
    if unknown.all() or not unknown.any():
        return wall_mm
    nearest = ndi.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return wall_mm[tuple(np.asarray(nearest))]
