"""Tetrahedral mesh of a segmented body, with a conforming meshed cavity (MMG)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from scipy.spatial import cKDTree

from ..core.errors import InputError
from .bcc import bcc_lattice
from .borders import Border, BorderAt, border_at, flat_border, wall_heights
from .isosurface import Isosurface, SegmentedBody, isosurface, segmented_body
from .mesh_quality import Quality, quality
from .meshing import INSIDE, Function, element_sizes
from .solid import Solid, fitted, remesh, split
from .tetrahedra import boundary, used_only
from .volume import Volume

MIN_VOXEL_SHARE = 1 / 6  # voxels smaller than this fraction of an element edge are averaged
FINENESS = 0.3  # largest distance of an edge from the surface [voxels]
LOOSENESS = 0.2  # largest distance of the edges of a trunk's rim from its surface, as a fraction of an element edge
MIN_CUT = 0.1  # shortest part of an edge that a cut leaves, as a fraction; nodes are moved to the surface later
MAX_CUBES = 300_000  # most lattice cubes in the box around the body; results in one to three million elements


class Region(IntEnum):
    """Region that an element belongs to."""

    TISSUE = 0
    CAVITY = 1


@dataclass(frozen=True, eq=False)
class BodyMesh:
    """Tetrahedral mesh of the body, with the border of the cavity on element faces.

    Parameters
    ----------
    nodes : (n, 3) array [mm]
        LPS positions.
    tetrahedra : (m, 4) int32 array
        Positively oriented.
    region : (m,) uint8 array
        `Region` of each element.
    faces : (k, 3) int32 array
        Outer faces, counter-clockwise seen from outside.
    marker : (k,) uint8 array
        `Border` of each outer face.
    quality : Quality
        Measured quality of the mesh.
    notes : tuple of str
        Messages that say what was left out or filled, and which attempts failed before.
    """

    nodes: np.ndarray
    tetrahedra: np.ndarray
    region: np.ndarray
    faces: np.ndarray
    marker: np.ndarray
    quality: Quality
    notes: tuple[str, ...]

    @property
    def constrained_nodes(self) -> np.ndarray:
        """Constrained nodes: those on the chest wall, on the rim and on cuts (n,)."""
        return np.unique(self.faces[self.marker != Border.SKIN])


@dataclass(frozen=True)
class Attempt:
    """Settings of one attempt to mesh the body.

    Parameters
    ----------
    smooth_mm : float
        Standard deviation of the smoothing of the body fraction [mm]; at least `MIN_SMOOTHING` voxels along each axis.
    lattice_share : float
        Edge of the initial lattice, which is cut at the surface, as a fraction of the element edge.
    n_rounds : int
        Number of remeshing rounds, 2 or more; the cavity is cut before the last one.
    thin_share : float
        Parts thinner than this fraction of an element edge are left out.
    """

    smooth_mm: float
    lattice_share: float
    n_rounds: int
    thin_share: float

    def keeping(self, share: float) -> Attempt:
        """Return the attempt that keeps parts of a thickness, given as a fraction of an element edge."""
        return replace(self, lattice_share=min(self.lattice_share, share), thin_share=min(self.thin_share, 0.5 * share))


MIN_SMOOTHING = 0.8  # lower limit of the smoothing [voxels]
ATTEMPTS = (Attempt(0.0, 1.0, 2, 2 / 3), Attempt(1.3, 0.7, 2, 1.0), Attempt(0.0, 0.5, 3, 2 / 3))


@dataclass(frozen=True, eq=False)
class _Borders:
    """What lies outside of the body: ``inside`` the image by a function of points, and at its edge by the labels and the wall.

    The edges of the rim of a trunk may be rounded if ``is_rim_loose``: tissue is held there.
    """

    inside: BorderAt
    labels: Volume
    wall_mm: np.ndarray
    is_rim_loose: bool
    edge_mm: float

    def resolution_mm(self, share: Volume) -> np.ndarray:
        """Return the size of details that are kept along x, y, z (3,) [mm]: a voxel, and around a trunk a share of an element."""
        voxel = np.asarray(share.spacing_mm)
        return np.maximum(voxel, MIN_VOXEL_SHARE * self.edge_mm) if self.is_rim_loose else voxel

    def clear_of(self, rim: np.ndarray) -> Function:
        """Return a function of points (n, 3) [mm]: 0 up to an element from the faces (k, 3, 3) of a loose rim, 1 from two on."""
        if not self.is_rim_loose or not len(rim):
            return lambda points: np.ones(len(points))
        tree = cKDTree(rim.reshape(-1, 3))
        return lambda points: np.clip(tree.query(points)[0] / self.edge_mm - 1.0, 0.0, 1.0)

    def fitted(self, nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Return those of the outer faces (k, 3) that must lie on the surface closely: all, or those that touch no loose rim."""
        if not self.is_rim_loose:
            return faces
        rim = faces[self.inside(nodes[faces].mean(axis=1)) == Border.RIM]
        return faces[~np.isin(faces, rim).any(axis=1)]


@dataclass(frozen=True)
class _Edges:
    """Required element edges [mm]: ``far`` from the cavity and ``near`` its border."""

    far: float
    near: float
    cavity: Function | None

    def at(self, points: np.ndarray) -> np.ndarray:
        """Return the element edge at points (n, 3) -> (n,) [mm]."""
        if self.cavity is None:
            return np.full(len(points), self.far)
        return element_sizes(self.cavity(points), self.far, self.near)


def mesh_body(
    labels: Volume,
    edge_mm: float,
    *,
    tissue: Volume | None = None,
    wall_mm: np.ndarray | None = None,
    thinnest_mm: float = np.inf,
    cavity: Function | None = None,
    cavity_edge_mm: float = 1.5,
) -> BodyMesh:
    """Mesh the breast of a label map, with the trunk if that is labelled as tissue.

    A lattice of tetrahedra is cut at the smoothed surface of the body and remeshed, and its outer nodes are moved onto the
    surface; the same is done at the border of the cavity. A mesh that fails the quality criteria is made again with the
    settings of the next of `ATTEMPTS`.

    Parameters
    ----------
    labels : Volume
        (nz, ny, nx) of `Label`.
    edge_mm, cavity_edge_mm : float
        Element edge far from and at the border of the cavity [mm].
    tissue : Volume, optional
        Tissue fraction 0 .. 1 of each voxel, on the grid of the labels.
    wall_mm : (nz, nx) array, optional
        y of the chest wall [mm], NaN where it is unknown; by default from the labels (`wall_heights`).
    thinnest_mm : float
        Thickness of the thinnest parts that must not be left out or torn, such as a trunk [mm].
    cavity : callable, optional
        Signed distance [mm] to the border of the cavity at points (n, 3) [mm], negative inside.

    Raises
    ------
    InputError
        If the labels have no breast; if the body is not supported anywhere, too thin or too large for these edges; if
        the cavity is not inside the body; or if the mesh fails the quality criteria in every attempt.
    """
    edges = _checked(edge_mm, cavity_edge_mm, cavity)
    wall_mm = wall_heights(labels) if wall_mm is None else wall_mm
    borders, failed = _Borders(border_at(labels, wall_mm), labels, wall_mm, np.isfinite(thinnest_mm), edge_mm), []
    for attempt in (attempt.keeping(thinnest_mm / edge_mm) for attempt in ATTEMPTS):
        thin = attempt.thin_share * edge_mm
        body = segmented_body(labels, tissue, finest_mm=MIN_VOXEL_SHARE * edge_mm, thin_mm=thin)
        try:
            mesh = _attempt(body, borders, edges, attempt, (*body.notes, *failed))
        except RuntimeError as error:  # raised by MMG
            failed.append(f"{attempt}: {error}")
            continue
        if not (faults := mesh.quality.faults()):
            return mesh
        failed.append(f"{attempt}: {', '.join(faults)}")
    raise InputError(
        f"The body could not be meshed well with mesh.edge_mm = {edge_mm:g}: choose a smaller edge or smoother labels "
        f"(tried {len(failed)} times, the last with {failed[-1].partition(': ')[2]})."
    )


def _checked(edge_mm: float, cavity_edge_mm: float, cavity: Function | None) -> _Edges:
    for name, value in (("edge_mm", edge_mm), ("cavity_edge_mm", cavity_edge_mm)):
        if not 0 < value < np.inf:
            raise InputError(f"mesh.{name} must be above 0 mm; got {value:g}.")
    return _Edges(edge_mm, min(edge_mm, cavity_edge_mm), cavity)


def _attempt(
    segmented: SegmentedBody, borders: _Borders, edges: _Edges, attempt: Attempt, notes: tuple[str, ...]
) -> BodyMesh:
    """Mesh the body with the settings of one attempt and measure the quality of the mesh."""
    share = segmented.share
    surface = isosurface(share, np.maximum(attempt.smooth_mm, MIN_SMOOTHING * borders.resolution_mm(share)))
    hausdorff = FINENESS * max(borders.resolution_mm(share))
    at_rim = LOOSENESS * edges.far if borders.is_rim_loose else hausdorff
    body = _cut_lattice(surface, edges.far, attempt.lattice_share * edges.far)
    body = remesh(body, edges.at(body.nodes), at_rim)
    for left in reversed(range(attempt.n_rounds - 1)):
        body = _fitted_skin(body, surface)
        if edges.cavity is not None and left == 0:
            body = split(body, _level_in(body, edges.cavity))
        body = remesh(body, np.minimum(edges.at(body.nodes), _edge_for(body, surface, borders, hausdorff)), at_rim)
    for by_face in (False, True):
        body = _fitted_skin(body, surface, by_face)
        if edges.cavity is not None:
            body = fitted(body, boundary(body.tetrahedra[body.refs == INSIDE]), edges.cavity, by_face=by_face)
    return _measured(body, surface, segmented, borders, notes)


def _cut_lattice(surface: Isosurface, edge: float, lattice_edge: float) -> Solid:
    """Return the part of a tetrahedral lattice inside the surface, cut there, with flat faces where the image ends."""
    box, reach = _box(surface, lattice_edge), 2 * max(lattice_edge, *surface.share.spacing_mm)
    n_cubes = float(np.prod((box[1] - box[0]) / edge))
    if n_cubes > MAX_CUBES:
        least = edge * np.cbrt(n_cubes / MAX_CUBES)
        raise InputError(f"mesh.edge_mm must be at least {least:.2g} mm for a body of this size; got {edge:g}.")
    nodes, tetrahedra = bcc_lattice(box[0], box[1], lattice_edge)
    level = surface.distance(nodes, reach)
    if level.min() > -lattice_edge:
        raise InputError(
            f"mesh.edge_mm must be smaller for this body, which is only about {-2 * level.min():.0f} mm thick; got {edge:g}."
        )
    least = MIN_CUT * lattice_edge
    level = np.copysign(np.maximum(np.abs(level), least), level)
    touching = tetrahedra[(level[tetrahedra] < 0).any(axis=1)]
    level = level[np.unique(touching)]
    nodes, tetrahedra = used_only(nodes, touching)
    none = np.zeros((0, 3), np.int32)
    lattice = Solid(nodes, tetrahedra, np.zeros(len(tetrahedra), np.int32), none, none[:, 0], box)
    return split(lattice, level).inside().with_flat_faces()


def _box(surface: Isosurface, margin: float) -> np.ndarray:
    """Return the low and high corner (2, 3) [mm] of a box around the body, enlarged by a margin [mm] but within the image."""
    half = 0.5 * np.asarray(surface.share.spacing_mm)
    nz, ny, nx = surface.share.shape
    first, last = surface.share.position(np.array([[0, 0, 0], [nz - 1, ny - 1, nx - 1]]))
    low = np.maximum(surface.points.min(axis=0) - margin, first - half)
    high = np.minimum(surface.points.max(axis=0) + margin, last + half)
    return np.stack([low, high])


def _fitted_skin(body: Solid, surface: Isosurface, by_face: bool = False) -> Solid:
    """Move the outer nodes onto the surface, as in `fitted`; nodes on a face of the image stay in its plane."""
    return fitted(body, _free_faces(body), surface.distance, by_face=by_face)


def _free_faces(body: Solid) -> np.ndarray:
    """Return the outer faces (k, 3) that do not lie on the boundary of the image."""
    faces = boundary(body.tetrahedra)
    return faces[~body.is_flat(faces)]


def _edge_for(body: Solid, surface: Isosurface, borders: _Borders, limit_mm: float) -> np.ndarray:
    """Return the element edge at each node (n,) [mm] for which outer faces deviate from the surface by the limit; inf inside."""
    faces = borders.fitted(body.nodes, _free_faces(body))
    corners = body.nodes[faces]
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    off = np.abs(surface.distance(middles.reshape(-1, 3))).reshape(-1, 3).max(axis=1)
    edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
    out = np.full(len(body.nodes), np.inf)
    np.minimum.at(out, faces, (edge * np.clip(np.sqrt(limit_mm / np.maximum(off, 1e-9)), 0.3, 10.0))[:, None])
    return out


def _level_in(body: Solid, cavity: Function) -> np.ndarray:
    """Return the signed distance to the border of the cavity at the nodes (n,) [mm]; check that the cavity is inside the body."""
    level = cavity(body.nodes)
    if not (level < 0).any():
        raise InputError("The cavity lies outside the body: move resection.centre_mm inside the breast.")
    if level[np.unique(boundary(body.tetrahedra))].min() <= 0:
        raise InputError(
            "The cavity reaches the surface of the body: move resection.centre_mm inside or choose a smaller resection.radius_mm."
        )
    return level


def _measured(
    body: Solid, surface: Isosurface, segmented: SegmentedBody, borders: _Borders, notes: tuple[str, ...]
) -> BodyMesh:
    """Return the finished mesh, with marked outer faces and measured quality."""
    faces = boundary(body.tetrahedra)
    middles = body.nodes[faces].mean(axis=1)
    on_edge = flat_border(borders.labels, borders.wall_mm, max(surface.share.spacing_mm))
    marker = np.where(body.is_flat(faces), on_edge(middles), borders.inside(middles)).astype(np.uint8)

    def on_skin(points: np.ndarray) -> np.ndarray:
        return borders.inside(points) == Border.SKIN

    if (marker == Border.SKIN).all():
        raise InputError(
            "labels: the breast touches neither chest wall (5) nor the image's edge, so that nothing supports it."
        )
    clear = borders.clear_of(body.nodes[faces[(marker == Border.RIM) | (marker == Border.CUT)]])
    skin = (marker == Border.SKIN) & (clear(middles) > 0)
    centres = body.nodes[body.tetrahedra].mean(axis=1)
    measures = quality(
        body.nodes,
        body.tetrahedra,
        faces,
        skin,
        (isosurface(segmented.share), surface),
        lambda points: on_skin(points) & (clear(points) > 0),
        (clear(centres), segmented.weighted_volume(clear)),
        float(max(borders.resolution_mm(surface.share))),
    )
    region = np.where(body.refs == INSIDE, Region.CAVITY, Region.TISSUE).astype(np.uint8)
    return BodyMesh(body.nodes, body.tetrahedra, region, faces, marker, measures, notes)
