"""From a segmented volume to a conforming tetrahedral mesh with a meshed cavity (MMG)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ..core.errors import InputError
from .bcc import bcc_lattice
from .isosurface import Isosurface, Segmented, isosurface, segmented_body, wall_side
from .mesh_quality import Quality, quality
from .meshing import INSIDE, Function, element_sizes
from .solid import Solid, fitted, remesh, split
from .tetrahedra import boundary, used_only
from .volume import Volume

FINEST = 1 / 6  # voxels smaller than this share of an edge are averaged
FINENESS = 0.3  # how far an edge may leave the surface, in voxels
LEAST_CUT = 0.1  # share of an edge that a cut leaves; the nodes are put onto the surface afterwards
LARGEST_N_CUBES = 300_000  # in the box around the body: one to three million elements


class Region(IntEnum):
    """What an element is."""

    TISSUE = 0
    CAVITY = 1


class Border(IntEnum):
    """What an outer face is; chest wall and cuts, where the image ends, are held."""

    SKIN = 1
    WALL = 2
    CUT = 3


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """Tetrahedra that fill the body, with the cavity's border on their faces.

    Parameters
    ----------
    nodes : (n, 3) array [mm]
        LPS positions.
    tetrahedra : (m, 4) int32 array
        Positively oriented.
    region : (m,) uint8 array
        `Region` of each element.
    faces : (k, 3) int32 array
        Outer triangles, seen from outside.
    marker : (k,) uint8 array
        `Border` of each of them.
    quality : Quality
        What the gate measured.
    notes : tuple of str
        What was left out, filled, or tried before.
    """

    nodes: np.ndarray
    tetrahedra: np.ndarray
    region: np.ndarray
    faces: np.ndarray
    marker: np.ndarray
    quality: Quality
    notes: tuple[str, ...]

    @property
    def held_nodes(self) -> np.ndarray:
        """Nodes on the chest wall and on cuts (n,)."""
        return np.unique(self.faces[self.marker != Border.SKIN])


@dataclass(frozen=True)
class Attempt:
    """How the surface is taken from the voxels.

    Parameters
    ----------
    smooth_mm : float
        Smoothing of the share of the body [mm]; no less than `LEAST_SMOOTHING` voxels along each axis.
    lattice_share : float
        Edge of the lattice that is cut, as a share of the elements' edge.
    n_rounds : int
        How often it is remeshed, 2 or more; the cavity is cut before the last.
    thin_share : float
        Parts thinner than this share of an edge are left out.
    """

    smooth_mm: float
    lattice_share: float
    n_rounds: int
    thin_share: float


LEAST_SMOOTHING = 0.8  # voxels
ATTEMPTS = (Attempt(0.0, 1.0, 2, 2 / 3), Attempt(1.3, 0.7, 2, 1.0), Attempt(0.0, 0.5, 3, 2 / 3))


@dataclass(frozen=True)
class _Edges:
    """Element edges [mm], and the cavity that they are fine at."""

    far: float
    near: float
    cavity: Function | None

    def at(self, points: np.ndarray) -> np.ndarray:
        """Edge at points (n, 3) -> (n,) [mm]."""
        if self.cavity is None:
            return np.full(len(points), self.far)
        return element_sizes(self.cavity(points), self.far, self.near)


def mesh_body(
    labels: Volume,
    edge_mm: float,
    *,
    tissue: Volume | None = None,
    cavity: Function | None = None,
    cavity_edge_mm: float = 1.5,
) -> BodyMesh:
    """Mesh the breast of a label map.

    A lattice of tetrahedra is cut at the smoothed surface of the body, remeshed, and its outer nodes are put onto the
    surface; the same is done at the cavity's border. What fails the gate is tried again with the next of `ATTEMPTS`.

    Parameters
    ----------
    labels : Volume
        (nz, ny, nx) of `Label`.
    edge_mm, cavity_edge_mm : float
        Element edge far from and at the cavity's border [mm].
    tissue : Volume, optional
        Share 0 .. 1 of tissue in each voxel, on the grid of the labels.
    cavity : callable, optional
        Signed distance [mm] to the cavity's border at points (n, 3) [mm], negative in it.

    Raises
    ------
    InputError
        Labels without a breast, a body that is held nowhere, too thin, or too small for these edges, a cavity that is not
        within it, or a mesh that fails the gate in every attempt.
    """
    edges = _checked(edge_mm, cavity_edge_mm, cavity)
    is_wall, failed = wall_side(labels), []
    for attempt in ATTEMPTS:
        thin = attempt.thin_share * edge_mm
        body = segmented_body(labels, tissue, finest_mm=FINEST * edge_mm, thin_mm=thin)
        try:
            mesh = _attempt(body, is_wall, edges, attempt, (*body.notes, *failed))
        except RuntimeError as error:  # MMG's own word
            failed.append(f"{attempt}: {error}")
            continue
        if not (faults := mesh.quality.faults()):
            return mesh
        failed.append(f"{attempt}: {', '.join(faults)}")
    raise InputError(
        f"The body has no good mesh with mesh.edge_mm = {edge_mm:g}, choose a smaller edge or smoother labels; "
        f"tried {len(failed)} times, the last with {failed[-1].partition(': ')[2]}."
    )


def _checked(edge_mm: float, cavity_edge_mm: float, cavity: Function | None) -> _Edges:
    for name, value in (("edge_mm", edge_mm), ("cavity_edge_mm", cavity_edge_mm)):
        if not 0 < value < np.inf:
            raise InputError(f"mesh.{name} must be above 0 mm; got {value:g}.")
    return _Edges(edge_mm, min(edge_mm, cavity_edge_mm), cavity)


def _attempt(
    segmented: Segmented, is_wall: Function | None, edges: _Edges, attempt: Attempt, notes: tuple[str, ...]
) -> BodyMesh:
    """Mesh once and measure."""
    share = segmented.share
    surface = isosurface(share, np.maximum(attempt.smooth_mm, LEAST_SMOOTHING * np.asarray(share.spacing_mm)))
    hausdorff = FINENESS * max(share.spacing_mm)
    body = _cut_lattice(surface, edges.far, attempt.lattice_share * edges.far)
    body = remesh(body, edges.at(body.nodes), hausdorff)
    for left in reversed(range(attempt.n_rounds - 1)):
        body = _fitted_skin(body, surface)
        if edges.cavity is not None and left == 0:
            body = split(body, _level_in(body, edges.cavity))
        body = remesh(body, np.minimum(edges.at(body.nodes), _edge_for(body, surface, hausdorff)), hausdorff)
    for by_face in (False, True):
        body = _fitted_skin(body, surface, by_face)
        if edges.cavity is not None:
            body = fitted(body, boundary(body.tetrahedra[body.refs == INSIDE]), edges.cavity, by_face=by_face)
    return _measured(body, surface, segmented, is_wall, notes)


def _cut_lattice(surface: Isosurface, edge: float, lattice_edge: float) -> Solid:
    """Cut the lattice at the surface: what is inside, with flat faces where the image ends."""
    box, reach = _box(surface, lattice_edge), 2 * max(lattice_edge, *surface.share.spacing_mm)
    n_cubes = float(np.prod((box[1] - box[0]) / edge))
    if n_cubes > LARGEST_N_CUBES:
        least = edge * np.cbrt(n_cubes / LARGEST_N_CUBES)
        raise InputError(f"mesh.edge_mm must be at least {least:.2g} mm for a body of this size; got {edge:g}.")
    nodes, tetrahedra = bcc_lattice(box[0], box[1], lattice_edge)
    level = surface.distance(nodes, reach)
    if level.min() > -lattice_edge:
        raise InputError(
            f"mesh.edge_mm must be smaller for this body, which is only about {-2 * level.min():.0f} mm thick; got {edge:g}."
        )
    least = LEAST_CUT * lattice_edge
    level = np.copysign(np.maximum(np.abs(level), least), level)
    touching = tetrahedra[(level[tetrahedra] < 0).any(axis=1)]
    level = level[np.unique(touching)]
    nodes, tetrahedra = used_only(nodes, touching)
    none = np.zeros((0, 3), np.int32)
    lattice = Solid(nodes, tetrahedra, np.zeros(len(tetrahedra), np.int32), none, none[:, 0], box)
    return split(lattice, level).inside().with_flat_faces()


def _box(surface: Isosurface, margin: float) -> np.ndarray:
    """Corners (2, 3) [mm] of a box around the body that ends where the image ends."""
    half = 0.5 * np.asarray(surface.share.spacing_mm)
    nz, ny, nx = surface.share.shape
    first, last = surface.share.position(np.array([[0, 0, 0], [nz - 1, ny - 1, nx - 1]]))
    low = np.maximum(surface.points.min(axis=0) - margin, first - half)
    high = np.minimum(surface.points.max(axis=0) + margin, last + half)
    return np.stack([low, high])


def _fitted_skin(body: Solid, surface: Isosurface, by_face: bool = False) -> Solid:
    """Put the outer nodes onto the surface; those where the image ends stay there."""
    return fitted(body, _free_faces(body), surface.distance, by_face=by_face)


def _free_faces(body: Solid) -> np.ndarray:
    """Outer faces (k, 3) that do not lie where the image ends."""
    faces = boundary(body.tetrahedra)
    return faces[~body.is_flat(faces)]


def _edge_for(body: Solid, surface: Isosurface, limit_mm: float) -> np.ndarray:
    """Edge (n,) [mm] with which the outer faces would leave the surface by no more than the limit."""
    faces = _free_faces(body)
    corners = body.nodes[faces]
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    off = np.abs(surface.distance(middles.reshape(-1, 3))).reshape(-1, 3).max(axis=1)
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
    out = np.full(len(body.nodes), np.inf)
    np.minimum.at(out, faces, (edge * np.clip(np.sqrt(limit_mm / np.maximum(off, 1e-9)), 0.3, 10.0))[:, None])
    return out


def _level_in(body: Solid, cavity: Function) -> np.ndarray:
    """Distance to the cavity's border at the nodes (n,) [mm], checked to lie within the body."""
    level = cavity(body.nodes)
    if not (level < 0).any():
        raise InputError("The cavity lies outside the body: move resection.centre_mm inside the breast.")
    if level[np.unique(boundary(body.tetrahedra))].min() <= 0:
        raise InputError(
            "The cavity reaches the surface of the body: move resection.centre_mm inside or choose a smaller resection.radius_mm."
        )
    return level


def _measured(
    body: Solid, surface: Isosurface, segmented: Segmented, is_wall: Function | None, notes: tuple[str, ...]
) -> BodyMesh:
    """Mark the outer faces and measure."""
    faces = boundary(body.tetrahedra)
    marker = np.where(body.is_flat(faces), Border.CUT, Border.SKIN).astype(np.uint8)

    def on_skin(points: np.ndarray) -> np.ndarray:
        return np.ones(len(points), bool) if is_wall is None else ~is_wall(points)

    marker[(marker == Border.SKIN) & ~on_skin(body.nodes[faces].mean(axis=1))] = Border.WALL
    if (marker == Border.SKIN).all():
        raise InputError(
            "labels: the breast touches neither chest wall (5) nor the image's edge, so that nothing holds it."
        )
    skin = marker == Border.SKIN
    measures = quality(
        body.nodes, body.tetrahedra, faces, skin, (isosurface(segmented.share), surface), on_skin, segmented.volume
    )
    region = np.where(body.refs == INSIDE, Region.CAVITY, Region.TISSUE).astype(np.uint8)
    return BodyMesh(body.nodes, body.tetrahedra, region, faces, marker, measures, notes)
