"""Tetrahedral mesh under construction: cutting by a level set and remeshing (both by MMG), and fitting to a surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mmgpy
import numpy as np

from ..core.posix_signals import restored_signals
from .meshing import INSIDE, Function
from .tetrahedra import area_vectors, boundary, dihedral_angles, oriented, used_only, volumes

SPLIT_ONLY = {"noinsert": True, "noswap": True, "nomove": True}
GRADATION = 1.3  # largest ratio of adjacent edges
MIN_ANGLE_DEG = 15.0  # fitting does not reduce a dihedral angle below this, or below the initial one if smaller
STEP_MM = 1e-3  # step of the central differences for the gradient of a distance
BOX_REF = 20  # MMG reference number of triangles on the first face of the box; MMG itself uses 0 to 10


@dataclass(frozen=True, eq=False)
class Solid:
    """Tetrahedral mesh under construction, with those of its faces that lie on the bounding box of the image.

    Parameters
    ----------
    nodes : (n, 3) array [mm]
    tetrahedra : (m, 4) int32 array
        Positively oriented.
    refs : (m,) int32 array
        MMG reference of each tetrahedron: `INSIDE` where the last level set is negative.
    flat : (k, 3) int32 array
        Triangles on the box.
    flat_refs : (k,) int32 array
        `BOX_REF` plus the face of the box: 0 to 2 for the low x, y, z faces, 3 to 5 for the high ones.
    box : (2, 3) array [mm]
        Low and high corner of the box.
    """

    nodes: np.ndarray
    tetrahedra: np.ndarray
    refs: np.ndarray
    flat: np.ndarray
    flat_refs: np.ndarray
    box: np.ndarray

    def inside(self) -> Solid:
        """Return the part of the mesh that is inside the level set."""
        nodes, tetrahedra = used_only(self.nodes, self.tetrahedra[self.refs == INSIDE])
        refs = np.zeros(len(tetrahedra), np.int32)
        return replace(self, nodes=nodes, tetrahedra=tetrahedra, refs=refs)

    def with_flat_faces(self) -> Solid:
        """Return the mesh with ``flat`` and ``flat_refs`` set to the outer faces that lie on the box."""
        faces = boundary(self.tetrahedra)
        hit = np.isclose(self.nodes[faces][:, :, None], self.box, rtol=0, atol=1e-6).all(axis=1).reshape(-1, 6)
        on_box = hit.any(axis=1)
        refs = (BOX_REF + hit[on_box].argmax(axis=1)).astype(np.int32)
        return replace(self, flat=faces[on_box].astype(np.int32), flat_refs=refs)

    def is_flat(self, faces: np.ndarray) -> np.ndarray:
        """Check which of the outer faces (k, 3) lie on the box: (k,) bool."""
        _, group = np.unique(np.sort(np.concatenate([self.flat, faces]), axis=1), axis=0, return_inverse=True)
        group = group.ravel()
        return np.isin(group[len(self.flat) :], group[: len(self.flat)])

    def free(self) -> np.ndarray:
        """Return 1 where a node may move along an axis, otherwise 0 (n, 3): nodes on a face of the box stay on that face."""
        out = np.ones_like(self.nodes)
        for ref in np.unique(self.flat_refs):
            out[self.flat[self.flat_refs == ref].ravel(), (ref - BOX_REF) % 3] = 0
        return out


def split(solid: Solid, level: np.ndarray) -> Solid:
    """Cut elements where the level set (n,) is zero, and mark those inside in ``refs``."""
    mesh = _mmg(solid)
    with restored_signals():
        mesh.remesh_levelset(np.ascontiguousarray(level, float)[:, None], verbose=-1, **SPLIT_ONLY)
    return _solid(mesh, solid.box)


def remesh(solid: Solid, size: np.ndarray, hausdorff_mm: float) -> Solid:
    """Remesh to the edge length ``size`` (n,) [mm] at the nodes; borders between regions are preserved."""
    mesh = _mmg(solid)
    mesh["metric"] = np.ascontiguousarray(size, float)[:, None]
    limits = {"hmin": 0.3 * float(size.min()), "hmax": float(size.max())}
    with restored_signals():
        mesh.remesh(verbose=-1, hausd=hausdorff_mm, hgrad=GRADATION, **limits)
    return _solid(mesh, solid.box)


def fitted(solid: Solid, faces: np.ndarray, distance: Function, *, by_face: bool = False) -> Solid:
    """Return the mesh with the nodes of given faces (k, 3) moved onto the surface on which ``distance`` [mm] is zero.

    With ``by_face`` the nodes are moved until the faces around each node have a mean distance of about zero instead.
    If an element would get a dihedral angle below `MIN_ANGLE_DEG` (or below its angle before, if smaller), the displacements
    of its nodes are halved up to six times, and set to zero if that is not enough.
    """
    at = np.unique(faces)
    off = _mean_distance(solid.nodes, faces, distance)[at] if by_face else distance(solid.nodes[at])
    slope = _gradient(distance, solid.nodes[at]) * solid.free()[at]
    square = np.sum(slope**2, axis=1, keepdims=True)
    move = np.zeros_like(solid.nodes)
    move[at] = np.where(square > 0.1, -off[:, None] * slope / np.maximum(square, 0.1), 0.0)
    return replace(solid, nodes=solid.nodes + _damped(solid, move))


def _damped(solid: Solid, move: np.ndarray) -> np.ndarray:
    """Return displacements (n, 3) [mm], reduced as in `fitted` at nodes of elements that would get too small an angle."""
    moved = solid.tetrahedra[(move != 0).any(axis=1)[solid.tetrahedra].any(axis=1)]
    least = np.minimum(_worst_angle(solid.nodes, moved), MIN_ANGLE_DEG)
    for _ in range(6):
        bad = _worst_angle(solid.nodes + move, moved) < least
        if not bad.any():
            return move
        move = np.where(np.isin(np.arange(len(move)), moved[bad])[:, None], 0.5 * move, move)
    return np.where(np.isin(np.arange(len(move)), moved[bad])[:, None], 0.0, move)


def _worst_angle(nodes: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Return the smallest dihedral angle of each element (m,) [degrees]; -1 for an inverted element."""
    angle = dihedral_angles(nodes, tetrahedra).min(axis=1)
    return np.where(volumes(nodes, tetrahedra) > 0, angle, -1.0)


def _mean_distance(nodes: np.ndarray, faces: np.ndarray, distance: Function) -> np.ndarray:
    """Return the area-weighted mean distance of the faces (k, 3) around each node (n,) [mm]; exact for a quadratic distance."""
    corners = nodes[faces]
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    off = distance(middles.reshape(-1, 3)).reshape(-1, 3).mean(axis=1)
    area = np.linalg.norm(area_vectors(nodes, faces), axis=1)
    total, weight = (
        np.bincount(faces.ravel(), np.repeat(value, 3), len(nodes)) for value in (off * area, np.maximum(area, 1e-12))
    )
    return total / np.maximum(weight, 1e-12)


def _gradient(distance: Function, points: np.ndarray) -> np.ndarray:
    """Return the gradient (n, 3) of a distance at points (n, 3) [mm], by central differences."""
    steps = STEP_MM * np.eye(3)
    return np.stack([distance(points + h) - distance(points - h) for h in steps], axis=-1) / (2 * STEP_MM)


def _mmg(solid: Solid) -> mmgpy.MmgMesh3D:
    mesh = mmgpy.MmgMesh3D()
    mesh.set_mesh_size(vertices=len(solid.nodes), tetrahedra=len(solid.tetrahedra), triangles=len(solid.flat))
    mesh.set_vertices(solid.nodes)
    mesh.set_tetrahedra(solid.tetrahedra, solid.refs)
    if len(solid.flat):
        mesh.set_triangles(solid.flat, solid.flat_refs)
    return mesh


def _solid(mesh: mmgpy.MmgMesh3D, box: np.ndarray) -> Solid:
    nodes = mesh.get_vertices()
    tetrahedra, refs = mesh.get_tetrahedra_with_refs()
    triangles, marks = mesh.get_triangles_with_refs()
    flat, flat_refs = triangles[marks >= BOX_REF], marks[marks >= BOX_REF]
    for ref in np.unique(flat_refs):
        end, axis = divmod(int(ref) - BOX_REF, 3)
        nodes[flat[flat_refs == ref].ravel(), axis] = box[end, axis]
    return Solid(nodes, oriented(nodes, tetrahedra), refs, flat, flat_refs, box)
