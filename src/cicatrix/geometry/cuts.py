"""Intersection of tetrahedra with a plane."""

from __future__ import annotations

import numpy as np

# number of corners below the plane -> edges that the plane cuts, in order (corners numbered by height; triangle: last edge twice)
AROUND = {1: [[0, 1], [0, 2], [0, 3], [0, 3]], 2: [[0, 2], [0, 3], [1, 3], [1, 2]], 3: [[3, 0], [3, 1], [3, 2], [3, 2]]}


def plane_cut(points: np.ndarray, tetrahedra: np.ndarray, axis: int, position: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the polygons in which a plane normal to a coordinate axis cuts tetrahedra.

    Parameters
    ----------
    points, tetrahedra : (n, 3) [mm], (m, 4) array
        Mesh.
    axis : int
        Coordinate axis normal to the plane.
    position : float
        Coordinate of the plane [mm]; nodes exactly on it count as above.

    Returns
    -------
    (k, 4, 3) array [mm], (k,) int array
        Corners of each polygon in order (a triangle repeats its third), and the index of its tetrahedron.
    """
    height = points[tetrahedra, axis] - position
    order = np.argsort(height, axis=1, kind="stable")
    n_below = np.count_nonzero(height < 0.0, axis=1)
    polygons, owners = [np.zeros((0, 4, 3))], [np.zeros(0, int)]
    for n, edges in AROUND.items():
        cut = np.flatnonzero(n_below == n)
        ends = np.take_along_axis(tetrahedra[cut], order[cut], axis=1)[:, edges]
        level = points[ends, axis] - position
        share = level[..., 0] / (level[..., 0] - level[..., 1])
        polygons.append(points[ends[..., 0]] + share[..., None] * (points[ends[..., 1]] - points[ends[..., 0]]))
        owners.append(cut)
    return np.concatenate(polygons), np.concatenate(owners)
