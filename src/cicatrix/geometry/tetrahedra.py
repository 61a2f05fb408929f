"""Tetrahedral meshes: volumes, angles, midside nodes, boundary faces, and checks of an imported mesh."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ..core.errors import InputError

EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # edges of a tetrahedron, in the order of its midside nodes
FACES = np.array(  # outward faces of a tetrahedron: corners, then the midside nodes of their edges 01, 12, 02
    [[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]]
)
OPPOSITE = [2, 3, 1, 0]  # indices of the faces opposite to corners 0 to 3
FLAT = 1e-6  # a tetrahedron is flat if its volume over its longest edge cubed is below this (regular: 0.118)
LARGEST_MM = 1e12  # coordinates above this are refused
FAR = 10.0  # a mesh is far from the origin if its centre is this many times its extent away
TURNED = [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]  # node order that reverses the orientation of a tetrahedron


def far_origin(points: np.ndarray) -> np.ndarray:
    """Return a point about which to compute, so that little is lost to rounding: nodes (n, 3) [mm] -> (3,) [mm].

    It is the origin unless the mesh lies more than ten times its extent away; then it is the mesh's centre in whole mm.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    centre = np.round(0.5 * (low + high))
    return centre if np.linalg.norm(centre) > FAR * (high - low).max() else np.zeros(3)


def with_middles(points: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Add the midpoint of every edge as a node: (n, 3) [mm], (m, 4) -> (n + n_edges, 3) [mm], (m, 10); given nodes stay first."""
    pairs = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    edges, number = np.unique(pairs, axis=0, return_inverse=True)
    middles = len(points) + number.reshape(-1, len(EDGES))
    return np.vstack([points, points[edges].mean(axis=1)]), np.hstack([tetrahedra, middles])


def volumes(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the signed volumes from the corner nodes: (n, 3) [mm], (m, 4 or 10) -> (m,) [mm^3]."""
    a, b, c, d = np.moveaxis(points[tetrahedra[:, :4]], 1, 0)
    return np.einsum("ei,ei->e", np.cross(b - a, c - a), d - a) / 6.0


def boundary(tetrahedra: np.ndarray) -> np.ndarray:
    """Return the nodes of the boundary faces, outward: (m, 4) -> (n_faces, 3), (m, 10) -> (n_faces, 6)."""
    return owned_boundary(tetrahedra)[0]


def middles_between(is_marked: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the midside nodes of boundary faces whose edge has two marked ends: (n,) bool, (m, 10) -> (k, 3) int.

    A row is a midside node and the two ends of its edge, in ascending order.
    """
    edges = boundary(tetrahedra)[:, [[3, 0, 1], [4, 1, 2], [5, 0, 2]]].reshape(-1, 3)
    edges[:, 1:] = np.sort(edges[:, 1:], axis=1)
    return np.unique(edges[is_marked[edges[:, 1:]].all(axis=1)], axis=0)


def owned_boundary(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the faces of :func:`boundary`, and the index of the tetrahedron to which each face belongs (n_faces,)."""
    faces = tetrahedra[:, FACES[:, : 3 if tetrahedra.shape[1] == 4 else 6]].reshape(4 * len(tetrahedra), -1)
    corners = np.sort(faces[:, :3])
    order = np.lexsort(corners.T)
    is_new = np.ones(len(order) + 1, bool)  # whether the corners differ from those of the previous face
    is_new[1:-1] = (corners[order[1:]] != corners[order[:-1]]).any(axis=1)
    rows = np.sort(order[is_new[:-1] & is_new[1:]])
    return faces[rows], rows // 4


def neighbours(tetrahedra: np.ndarray) -> np.ndarray:
    """Return the pairs of tetrahedra that share a face: (m, 4 or 10) -> (2, n_inner_faces)."""
    faces = np.sort(tetrahedra[:, FACES[:, :3]].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = (faces[order[1:]] == faces[order[:-1]]).all(axis=1)
    return np.sort(np.stack([order[:-1][same], order[1:][same]]) // 4, axis=0)


def unmirrored(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Reverse the node order of all tetrahedra if all have negative volume (a mirrored mesh): (m, 4 or 10) -> the same."""
    all_turned = (volumes(points, tetrahedra) < 0.0).all()
    return tetrahedra[:, TURNED[: tetrahedra.shape[1]]] if all_turned else tetrahedra


def oriented(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Swap two corners of each tetrahedron with negative volume: (m, 4) -> (m, 4)."""
    return np.where(volumes(points, tetrahedra)[:, None] < 0, tetrahedra[:, [0, 1, 3, 2]], tetrahedra)


def used_only(points: np.ndarray, tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drop points that no tetrahedron uses: (n, 3), (m, 4) -> (k, 3), (m, 4) int32."""
    used, renumbered = np.unique(tetrahedra, return_inverse=True)
    return points[used], renumbered.reshape(-1, 4).astype(np.int32)


def area_vectors(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the normals of triangles with the area as their length: (n, 3) [mm], (m, 3) -> (m, 3) [mm^2]."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return 0.5 * np.cross(b - a, c - a)


def dihedral_angles(points: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the six dihedral angles of each tetrahedron: nodes (n, 3), corners (m, 4) -> (m, 6) [degrees]."""
    normals = [area_vectors(points, tetrahedra[:, face]) for face in FACES[OPPOSITE, :3]]
    normals = [n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300) for n in normals]
    cosines = [-np.einsum("ij,ij->i", a, b) for a, b in combinations(normals, 2)]
    return np.degrees(np.arccos(np.clip(np.stack(cosines, axis=-1), -1, 1)))


def check(points: np.ndarray, tetrahedra: np.ndarray, is_fixed: np.ndarray, is_sliding: np.ndarray) -> None:
    """Check an imported mesh and its supports; raise InputError for the first fault.

    Parameters
    ----------
    points : (n, 3) array [mm]
        Nodes, which meet :func:`check_coordinates`.
    tetrahedra : (m, 4) or (m, 10) int array
        Corners, then midside nodes, oriented.
    is_fixed : (n,) bool array
        Fixed nodes.
    is_sliding : (n,) bool array
        Corners of boundary faces that may slide in their own plane.

    Raises
    ------
    InputError
        If the mesh or the supports have a fault; the message gives the fault, its location and the requirement.
    """
    _check_numbers(points, tetrahedra)
    _check_shapes(points, tetrahedra)
    if tetrahedra.shape[1] == 10:
        _check_middles(points, tetrahedra)
    _check_surface(points, tetrahedra)
    _check_supports(points, tetrahedra, is_fixed, is_sliding)


def check_coordinates(points: np.ndarray) -> None:
    """Check that coordinates (n, 3) [mm] are numbers, and none so large that volumes overflow.

    Raises
    ------
    InputError
        If one is not.
    """
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"node {bad[0]} has a coordinate that is not a number; all must be finite")
    huge = np.flatnonzero((np.abs(points) > LARGEST_MM).any(axis=1))
    if huge.size:
        raise InputError(
            f"node {huge[0]} has a coordinate of {np.abs(points[huge[0]]).max():.3g} mm: is the unit right?"
        )


def _check_numbers(points: np.ndarray, tetrahedra: np.ndarray) -> None:
    unused = np.setdiff1d(np.arange(len(points)), tetrahedra)
    if unused.size:
        raise InputError(
            f"{unused.size} nodes belong to no tetrahedron, the first is node {unused[0]} at {_place(points[unused[0]])}: "
            "remove them"
        )
    _, first, count = np.unique(np.sort(tetrahedra[:, :4]), axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        twice = first[count > 1].min()
        raise InputError(
            f"{np.count_nonzero(count > 1)} tetrahedra occur more than once, the first is number {twice} at "
            f"{_centre(points, tetrahedra, twice)}: each must occur once"
        )


def _check_shapes(points: np.ndarray, tetrahedra: np.ndarray) -> None:
    corners = points[tetrahedra[:, :4]]
    longest = np.linalg.norm(corners[:, [i for i, _ in EDGES]] - corners[:, [j for _, j in EDGES]], axis=2).max(axis=1)
    quality = volumes(points, tetrahedra) / np.maximum(longest, 1e-30) ** 3
    bad = np.flatnonzero(quality < FLAT)
    if bad.size:
        raise InputError(
            f"{bad.size} tetrahedra are inverted or flat, the first is number {bad[0]} at {_centre(points, tetrahedra, bad[0])}: "
            "all must have positive volume"
        )


def _check_middles(points: np.ndarray, tetrahedra: np.ndarray) -> None:
    """Raise an error for tetrahedra with a midside node that is nearer to the midpoint of another edge."""
    ends = points[tetrahedra[:, np.array(EDGES)]]
    away = np.linalg.norm(points[tetrahedra[:, 4:]][:, :, None] - ends.mean(axis=2)[:, None], axis=3)
    bad = np.flatnonzero((away.argmin(axis=2) != np.arange(len(EDGES))).any(axis=1))
    if bad.size:
        raise InputError(
            f"{bad.size} tetrahedra have a midside node that lies nearer to the midpoint of another edge, the first is number "
            f"{bad[0]} at {_centre(points, tetrahedra, bad[0])}: midside nodes must be in VTK order, (0,1) (1,2) (0,2) (0,3) "
            "(1,3) (2,3)"
        )


def _check_surface(points: np.ndarray, tetrahedra: np.ndarray) -> None:
    faces = np.sort(tetrahedra[:, FACES[:, :3]].reshape(-1, 3), axis=1)
    shared, count = np.unique(faces, axis=0, return_counts=True)
    if (count > 2).any():
        at = _place(points[shared[count > 2][0]].mean(axis=0))
        raise InputError(f"a face at {at} belongs to more than two tetrahedra: the mesh overlaps itself there")
    outer = boundary(tetrahedra[:, :4])
    sides = np.sort(outer[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    if (count != 2).any():
        at = _place(points[edges[count != 2][0]].mean(axis=0))
        raise InputError(f"the surface meets itself along an edge at {at}: each edge of it must belong to two faces")


def _check_supports(points: np.ndarray, tetrahedra: np.ndarray, is_fixed: np.ndarray, is_sliding: np.ndarray) -> None:
    if not is_fixed.any() and not is_sliding.any():
        raise InputError("no node is fixed: mark some by point data `fixed` = 1, so that the body is supported")
    _check_motions(points, is_fixed, boundary(tetrahedra[:, :4]), is_sliding)
    pairs = neighbours(tetrahedra)
    joined = sp.coo_array((np.ones(pairs.shape[1]), tuple(pairs)), shape=(len(tetrahedra),) * 2)
    n_pieces, piece = connected_components(joined, directed=False)
    if n_pieces > 1:
        at = _place(points[tetrahedra[piece == np.bincount(piece).argmin(), :4]].mean(axis=(0, 1)))
        raise InputError(
            f"the body falls into {n_pieces} pieces, the smallest near {at}: all tetrahedra must be connected through faces"
        )


def _check_motions(points: np.ndarray, is_fixed: np.ndarray, faces: np.ndarray, is_sliding: np.ndarray) -> None:
    """Raise an error for supports that leave a translation or rotation of the body free; ``faces``: outer faces (n, 3)."""
    walls = faces[is_sliding[faces].all(axis=1)]
    normals, arms = area_vectors(points, walls), points - points.mean(axis=0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    held = [(np.flatnonzero(is_fixed), axis) for axis in np.eye(3)] + [(corner, normals) for corner in walls.T]
    rows = [np.hstack([np.broadcast_to(along, (len(nodes), 3)), np.cross(arms[nodes], along)]) for nodes, along in held]
    pushes = np.vstack(rows) / np.linalg.norm(arms, axis=1).max() ** np.repeat([0, 1], 3)
    if np.linalg.matrix_rank(pushes, tol=1e-6 * np.abs(pushes).max(initial=0.0)) < 6:
        who, what = (
            ("the supports let", "three nodes, not in line,")
            if is_fixed.any()
            else ("sliding nodes alone let", "some nodes")
        )
        raise InputError(f"{who} the body translate or rotate: mark {what} by point data `fixed` = 1")


def _place(point: np.ndarray) -> str:
    return "({}) mm".format(", ".join(f"{value:.1f}" for value in point))


def _centre(points: np.ndarray, tetrahedra: np.ndarray, number: int) -> str:
    return _place(points[tetrahedra[number, :4]].mean(axis=0))
