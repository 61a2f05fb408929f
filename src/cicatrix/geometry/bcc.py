"""Body-centred cubic lattice of tetrahedra."""

from __future__ import annotations

import numpy as np

from .tetrahedra import oriented


def bcc_lattice(low: np.ndarray, high: np.ndarray, edge_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Fill a box with tetrahedra whose nodes are the corners and centres of cubes.

    Each face between two cubes is covered by four tetrahedra around the line between the two centres, each face on the box
    by two. Dihedral angles are 60 and 90 degrees, at the box 45 to 120 degrees.

    Parameters
    ----------
    low, high : (3,) array [mm]
        Corners of the box.
    edge_mm : float
        Upper limit of a cube's edge [mm]; the edge is shortened so that a whole number of cubes fills the box.

    Returns
    -------
    points : (n, 3) array [mm]
    tetrahedra : (m, 4) int32 array
    """
    n = np.maximum(np.ceil((high - low) / edge_mm - 1e-9).astype(int), 1)
    cell = (high - low) / n
    corner = np.arange(np.prod(n + 1), dtype=np.int32).reshape(n + 1)
    centre = np.arange(np.prod(n), dtype=np.int32).reshape(n) + np.int32(corner.size)
    steps = [np.indices(corner.shape).reshape(3, -1).T, np.indices(centre.shape).reshape(3, -1).T + 0.5]
    points = np.concatenate(steps) * cell + low
    tetrahedra = np.concatenate([_across(corner, centre, axis) for axis in range(3)])
    return points, oriented(points, tetrahedra)


def _across(corner: np.ndarray, centre: np.ndarray, axis: int) -> np.ndarray:
    """Return the tetrahedra around all cube faces normal to an axis (m, 4): across inner faces, and on faces of the box.

    ``corner`` and ``centre`` are arrays of the node numbers of the cubes' corners and centres.
    """
    corner, centre = np.moveaxis(corner, axis, 0), np.moveaxis(centre, axis, 0)
    ring = [corner[:, :-1, :-1], corner[:, 1:, :-1], corner[:, 1:, 1:], corner[:, :-1, 1:]]
    between = [(centre[:-1], centre[1:], p[1:-1], q[1:-1]) for p, q in zip(ring, ring[1:] + ring[:1])]
    outer = [(centre[end], ring[0][end], ring[k][end], ring[k + 1][end]) for end in (0, -1) for k in (1, 2)]
    return np.concatenate([np.stack(corners, axis=-1).reshape(-1, 4) for corners in between + outer])
