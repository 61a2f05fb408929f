"""Tetrahedral mesh of a segmented body, with a conforming meshed cavity (MMG)."""

from __future__ import annotations

from dataclasses import dataclass
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
    detail_share : float
        Details smaller than this fraction of an element edge are smoothed away, the edges of the rim among them; volume and
        distance from the skin are measured against the smooth surface.
    """

    smooth_mm: float
    lattice_share: float
    n_rounds: int
    thin_share: float
    detail_share: float = 0.0

    def resolution_mm(self, share: Volume, edge_mm: float) -> np.ndarray:
        """Return the size of details that are kept along x, y, z (3,) [mm]: at least a voxel."""
        return np.maximum(share.spacing_mm, self.detail_share * edge_mm)


MIN_SMOOTHING = 0.8  # lower limit of the smoothing [voxels]
ATTEMPTS = (Attempt(0.0, 1.0, 2, 2 / 3), Attempt(1.3, 0.7, 2, 1.0), Attempt(0.0, 0.5, 3, 2 / 3))
# with a trunk, whose thin layer the lattice must not tear, and whose rim takes no fine elements
TRUNK_ATTEMPTS = (
    Attempt(0.0, 0.4, 3, 0.25, 1 / 4),
    Attempt(0.0, 0.5, 2, 0.25, 1 / 6),
    Attempt(0.0, 0.5, 2, 0.25, 1 / 4),
    Attempt(0.0, 0.4, 3, 0.25, 1 / 6),
    Attempt(0.0, 0.45, 4, 0.25, 1 / 5),
)


def attempts(has_trunk: bool) -> tuple[Attempt, ...]:
    """Return the attempts to mesh a body with or without a trunk, in order."""
    return TRUNK_ATTEMPTS if has_trunk else ATTEMPTS


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

    def clear_of(self, rim: np.ndarray) -> Function:
        """Return a function that is true at points (n, 3) [mm] farther than an element from faces (k, 3, 3) of a loose rim."""
        if not self.is_rim_loose or not len(rim):
            return lambda points: np.ones(len(points), bool)
        tree = cKDTree(rim.reshape(-1, 3))
        return lambda points: tree.query(points)[0] > self.edge_mm

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
    has_trunk: bool = False,
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
    has_trunk : bool
        Whether the body has a thin trunk around the breast. Then the lattice is finer than its thickness, the edges of its rim
        may be rounded, and details smaller than a share of an element are smoothed away (`TRUNK_ATTEMPTS`).
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
    borders, failed = _Borders(border_at(labels, wall_mm), labels, wall_mm, has_trunk, edge_mm), []
    for attempt in attempts(has_trunk):
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
    detail = attempt.resolution_mm(share, edges.far)
    surface = isosurface(share, np.maximum(attempt.smooth_mm, MIN_SMOOTHING * detail))
    hausdorff = FINENESS * max(detail)
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
    return _measured(body, surface, segmented, borders, float(max(detail)), notes)


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
    body: Solid,
    surface: Isosurface,
    segmented: SegmentedBody,
    borders: _Borders,
    detail_mm: float,
    notes: tuple[str, ...],
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
    skin = (marker == Border.SKIN) & clear(middles)
    measures = quality(
        body.nodes,
        body.tetrahedra,
        faces,
        skin,
        (surface if borders.is_rim_loose else isosurface(segmented.share), surface),
        lambda points: on_skin(points) & clear(points),
        surface.volume if borders.is_rim_loose else segmented.volume,
        detail_mm,
    )
    region = np.where(body.refs == INSIDE, Region.CAVITY, Region.TISSUE).astype(np.uint8)
    lost = 1 - measures.body_volume / segmented.volume
    rounded = (f"details below {detail_mm:.1f} mm smoothed, which takes {100 * lost:.1f} % of the volume",)
    return BodyMesh(
        body.nodes, body.tetrahedra, region, faces, marker, measures, notes + (rounded if borders.is_rim_loose else ())
    )
