"""Comparison of a section's outlines before and after surgery."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from .change import ShapeChange


def compare(before: np.ndarray, after: np.ndarray, skin: np.ndarray, nipple: int) -> ShapeChange:
    """Compare two closed outlines of the same material points.

    Parameters
    ----------
    before, after : (n, 3) array [mm]
        Outline points in order around the section; the third component is the displacement along the normal.
    skin : (n,) bool array
        Points on the skin; the others lie on the chest wall.
    nipple : int
        Index of the nipple among the points.
    """
    old, new = before[:, :2], after[:, :2]
    inward = signed_distance_to(old, new[skin])
    weights = _lengths(old)[skin]
    rms = np.sqrt(np.sum(weights * inward**2) / np.sum(weights))
    areas = area(old), area(new)
    return ShapeChange(
        volume_change_percent=float(100.0 * (areas[1] - areas[0]) / areas[0]),
        nipple_displacement_mm=float(np.linalg.norm(after[nipple] - before[nipple])),
        surface_retraction_max_mm=float(max(inward.max(), 0.0)),
        surface_retraction_rms_mm=float(rms),
        concavity_depth_mm=float(dent_depth(new) - dent_depth(old)),
    )


def area(outline: np.ndarray) -> float:
    """Return the area inside a closed polygon (n, 2) [mm] -> [mm^2]."""
    x, y = outline.T
    return float(0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)))


def signed_distance_to(outline: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distance of points (m, 2) from a closed polygon (n, 2), positive inside: (m,) [mm]."""
    start, edge = outline, np.roll(outline, -1, axis=0) - outline
    r = points[:, None] - start
    along = np.clip(np.sum(r * edge, axis=-1) / np.maximum(np.sum(edge**2, axis=-1), 1e-30), 0.0, 1.0)
    distance = np.linalg.norm(r - along[..., None] * edge, axis=-1).min(axis=1)
    x, y = points[:, 0, None], points[:, 1, None]
    (x0, y0), (x1, y1) = start.T, np.roll(start, -1, axis=0).T
    with np.errstate(divide="ignore", invalid="ignore"):
        crosses = ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return np.where(crosses.sum(axis=1) % 2 == 1, distance, -distance)


def dent_depth(outline: np.ndarray) -> float:
    """Return the largest distance of an outline (n, 2) from its convex hull [mm]."""
    equations = ConvexHull(outline).equations
    return float(np.min(-(outline @ equations[:, :2].T + equations[:, 2]), axis=1).max())


def _lengths(outline: np.ndarray) -> np.ndarray:
    """Return the length of outline that belongs to each point (n,) [mm]: half the sum of its two edges."""
    edges = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)
    return 0.5 * (edges + np.roll(edges, 1))
