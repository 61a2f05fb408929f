"""Comparison of a solid's surfaces before and after surgery."""

from __future__ import annotations

import numpy as np

from ..geometry.surface import Surface
from .change import ShapeChange


def compare_surfaces(
    before: np.ndarray, after: np.ndarray, triangles: np.ndarray, on_skin: np.ndarray, nipple: int
) -> ShapeChange:
    """Compare two closed surfaces of the same material points.

    Parameters
    ----------
    before, after : (n, 3) array [mm]
        Surface points.
    triangles : (k, 3) int array
        Triangles of the surface, counter-clockwise seen from outside.
    on_skin : (k,) bool array
        Triangles on the skin; the others lie where the body is supported.
    nipple : int
        Index of the nipple among the points.
    """
    old, new = Surface(before, triangles), Surface(after, triangles)
    skin = np.unique(triangles[on_skin])
    inward = old.inward(after[skin])
    weights = old.node_areas(on_skin)[skin]
    deeper = new.depth_below_hull(after[skin]) - old.depth_below_hull(before[skin])
    return ShapeChange(
        volume_change_percent=100.0 * (new.volume - old.volume) / old.volume,
        nipple_displacement_mm=float(np.linalg.norm(after[nipple] - before[nipple])),
        surface_retraction_max_mm=float(max(inward.max(), 0.0)),
        surface_retraction_rms_mm=float(np.sqrt(np.sum(weights * inward**2) / np.sum(weights))),
        concavity_depth_mm=float(max(deeper.max(), 0.0)),
    )
