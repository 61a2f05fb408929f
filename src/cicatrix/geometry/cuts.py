"""Where a plane cuts tetrahedra."""

from __future__ import annotations

import numpy as np

# by number of corners below the plane, corners sorted by height: the edges around the cut, a triangle's last one twice
AROUND = {1: [[0, 1], [0, 2], [0, 3], [0, 3]], 2: [[0, 2], [0, 3], [1, 3], [1, 2]], 3: [[3, 0], [3, 1], [3, 2], [3, 2]]}


def plane_cut(points: np.ndarray, tetrahedra: np.ndarray, axis: int, position: float) -> tuple[np.ndarray, np.ndarray]:
    """Polygons in which the plane of a constant coordinate cuts tetrahedra.

    Parameters
    ----------
    points, tetrahedra : (n, 3) [mm], (m, 4) array
        Mesh.
    axis : int
        Which coordinate is constant.
    position : float
        Its value [mm]; nodes exactly there count as above.

    Returns
    -------
    (k, 4, 3) array [mm], (k,) int array
        Corners in order, the third twice in a triangle, and the number of the tetrahedron.
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
