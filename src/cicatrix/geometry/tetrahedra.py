"""Tetrahedra: a body-centred cubic lattice of them, their volumes, angles and borders."""

from __future__ import annotations

from itertools import combinations

import numpy as np

FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # opposite to corners 0 to 3, seen from outside


def bcc_lattice(low: np.ndarray, high: np.ndarray, edge_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedra on the corners and centres of cubes that fill a box.

    Each face between two cubes is shared by four tetrahedra around the line between their centres; each face on the box
    by two. Dihedral angles are 60 and 90 degrees, at the box 45 to 120.

    Parameters
    ----------
    low, high : (3,) array [mm]
        Corners of the box.
    edge_mm : float
        Longest edge of a cube [mm]; it is made a little shorter to fill the box.

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
    """Tetrahedra on the cubes' faces normal to an axis (m, 4)."""
    corner, centre = np.moveaxis(corner, axis, 0), np.moveaxis(centre, axis, 0)
    ring = [corner[:, :-1, :-1], corner[:, 1:, :-1], corner[:, 1:, 1:], corner[:, :-1, 1:]]
    between = [(centre[:-1], centre[1:], p[1:-1], q[1:-1]) for p, q in zip(ring, ring[1:] + ring[:1])]
    outer = [(centre[end], ring[0][end], ring[k][end], ring[k + 1][end]) for end in (0, -1) for k in (1, 2)]
    return np.concatenate([np.stack(corners, axis=-1).reshape(-1, 4) for corners in between + outer])


def used_only(points: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drop points that no tetrahedron uses: (n, 3), (m, 4) -> (k, 3), (m, 4) int32."""
    used, renumbered = np.unique(tetrahedra, return_inverse=True)
    return points[used], renumbered.reshape(-1, 4).astype(np.int32)


def volumes(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Signed volumes: (n, 3) [mm], (m, 4) -> (m,) [mm^3]."""
    a, b, c, d = points[tetrahedra].transpose(1, 0, 2)
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6


def oriented(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Swap two corners wherever the volume is negative: (m, 4) -> (m, 4)."""
    return np.where(volumes(points, tetrahedra)[:, None] < 0, tetrahedra[:, [0, 1, 3, 2]], tetrahedra)


def dihedral_angles(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Angles between the faces of each tetrahedron: (n, 3), (m, 4) -> (m, 6) [degrees]."""
    normals = [area_vectors(points, tetrahedra[:, face]) for face in FACES]
    normals = [n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300) for n in normals]
    cosines = [-np.einsum("ij,ij->i", a, b) for a, b in combinations(normals, 2)]
    return np.degrees(np.arccos(np.clip(np.stack(cosines, axis=-1), -1, 1)))


def area_vectors(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Normals as long as the area: (n, 3) [mm], (m, 3) -> (m, 3) [mm^2]."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return 0.5 * np.cross(b - a, c - a)


def border(tetrahedra: np.ndarray) -> np.ndarray:
    """Faces of one tetrahedron only, seen from outside: (m, 4) -> (k, 3)."""
    faces = tetrahedra[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]
