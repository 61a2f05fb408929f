"""Model of a plane section of the breast: cut, meshed, and filled with tissue."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem
from scipy.ndimage import distance_transform_edt, map_coordinates

from ...core.errors import InputError
from ...geometry.borders import Border, BorderAt, height_at, wall_beside
from ...geometry.labels import Label
from ...geometry.meshing import component_at, interpolant, label_borders, mesh_section, signed_distance
from ...geometry.section import Raster, Section
from ...mechanics.space import Space
from ...outcome.change import ShapeChange
from ...outcome.shape import compare
from .body import (
    MIN_SKIN_FLAP_MM,
    Anatomy,
    BreastModel,
    check_flap,
    intact_body,
    nipple_of,
    quadrature_points,
    resection_of,
    scar_of,
    shares_at,
    supported,
    tissue_of,
)
from .case import LumpectomyCase
from .fascia import Wall, distance_in_section, in_fold
from .ligaments import with_ligaments


@dataclass(frozen=True, eq=False, kw_only=True)
class SectionModel(BreastModel):
    """Model of a plane section of the breast.

    Parameters
    ----------
    section : Section
        Plane of the section.
    mesh : skfem.MeshTri
        Mesh with the subdomain "cavity" and the boundaries "skin", "wall" and "rim".
    """

    section: Section
    mesh: skfem.MeshTri

    @property
    def slice_mm(self) -> float:
        """Position of the section along its normal, LPS [mm]."""
        return float(self.section.position_mm)

    def from_patient(self, vectors: np.ndarray) -> np.ndarray:
        """Convert LPS components to the section's axes: (..., 3) -> (..., 3)."""
        return self.section.from_patient(vectors)

    def nipple_position(self, x: np.ndarray) -> np.ndarray:
        """Return the nipple's position in the plane of the section in a shape (n_nodes, 3) [mm] (2,)."""
        return x[self.outline[self.nipple], :2]

    def to_patient(self, vector: np.ndarray) -> np.ndarray:
        """Return the LPS components (3,) of a vector in the plane of the section (2,)."""
        origin = self.section.to_patient(np.zeros(2))
        return self.section.to_patient(np.asarray(vector, float)) - origin

    def _body_change(self, before: np.ndarray, after: np.ndarray) -> ShapeChange:
        """Measure the change of the outline between two loaded shapes (n_nodes, 3) [mm]."""
        rows = self.outline
        return compare(before[rows], after[rows], self.on_skin, self.nipple)

    def margin_mm(self, anatomy: Anatomy) -> float:
        """Compute the smallest distance from the labelled tumour to the edge of the resection's disc in this section [mm]."""
        raster = self.section.raster(anatomy.labels, min(anatomy.labels.spacing_mm))
        tumour = anatomy.labels.nearest(self.section.to_patient(raster.points)) == Label.TUMOUR
        away = np.linalg.norm(raster.points[tumour] - self.section.from_patient(self.centre_mm)[:2], axis=-1)
        return float(self.radius_mm - np.max(away, initial=-np.inf))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays from which ``section_from_arrays`` builds the same model again."""
        mesh = self.mesh
        return self.common_arrays() | {
            "points": mesh.p,
            "triangles": mesh.t,
            "cavity": mesh.subdomains["cavity"],
            "skin": mesh.boundaries["skin"],
            "wall": mesh.boundaries["wall"],
            "rim": mesh.boundaries["rim"],
            "section_mm": np.array(self.section.position_mm),
        }

    @cached_property
    def cavity_border(self) -> np.ndarray:
        """Mesh edges between the cavity and the tissue around it (n_edges,)."""
        inner, outer = self.mesh.f2t
        return np.flatnonzero((outer >= 0) & (self.cavity[inner] != self.cavity[np.maximum(outer, 0)]))

    @cached_property
    def outline(self) -> np.ndarray:
        """Nodes around the section in order, vertices and midpoints (n,)."""
        return _ordered_outline(self.intact.discretization.space)

    @cached_property
    def on_skin(self) -> np.ndarray:
        """Whether each node of ``outline`` lies on the skin (n,) bool."""
        return np.isin(self.outline, self.intact.discretization.skin_nodes)

    @cached_property
    def nipple(self) -> int:
        """Index into ``outline`` of the node that represents the nipple."""
        rows = np.flatnonzero(self.on_skin)
        skin = self.x_imaged[self.outline[rows], :2]
        return int(rows[self.nipple_among(self.section.to_patient(skin))])


def section_model(case: LumpectomyCase, anatomy: Anatomy) -> SectionModel:
    """Cut the section, mesh it with the cavity's border on element edges, and fill it with tissue.

    Raises
    ------
    InputError
        If the section has no breast or no chest wall, or the resection does not lie inside the breast.
    """
    centre = resection_of(case, anatomy)
    section, radius = plane_of(case, centre)
    raster = section.raster(anatomy.labels, min(*anatomy.labels.spacing_mm, 1.0))
    centre2 = section.from_patient(centre)[:2]
    inside = _breast(anatomy, section, raster, centre2)
    body = signed_distance(inside, raster.pixel_mm)
    cavity = _cavity(body, raster, centre2, radius, case.mesh.cavity_edge_mm)
    points = raster.points[inside]
    mesh = mesh_section(
        interpolant(body, raster),
        cavity,
        points.min(axis=0),
        points.max(axis=0),
        case.mesh.edge_mm,
        case.mesh.cavity_edge_mm,
    )
    mesh = label_borders(mesh, _border(anatomy, section, raster))
    points = section.to_patient(quadrature_points(Space(mesh))[..., :2])
    wall = _wall(anatomy, section, mesh) if case.fascia.slides else None
    breast = anatomy.breast_share(anatomy.labels.nearest(section.to_patient(raster.points)), inside)
    return _filled(case, section, mesh, shares_at(anatomy, points), wall, breast, centre, radius)


def _wall(anatomy: Anatomy, section: Section, mesh: skfem.MeshTri) -> Wall:
    """Return the chest wall behind a section, with the edges of its mesh on the wall."""
    centres = mesh.p[:, mesh.facets[:, mesh.boundaries["wall"]]].mean(axis=1).T
    distance = distance_in_section(anatomy.wall_distance, section)
    return Wall(distance, in_fold(anatomy.fold, section.to_patient(centres)))


def section_from_arrays(case: LumpectomyCase, arrays: Mapping[str, np.ndarray]) -> SectionModel:
    """Rebuild the breast model of an interrupted run from its stored arrays, bitwise identical, without reading the image."""
    mesh = skfem.MeshTri(arrays["points"], arrays["triangles"]).with_subdomains({"cavity": arrays["cavity"]})
    mesh = mesh.with_boundaries({name: arrays[name] for name in ("skin", "wall", "rim")})
    section = Section(case.image.plane, float(arrays["section_mm"]))
    wall = Wall.from_arrays(arrays)
    breast, radius = float(arrays["breast_share"]), float(arrays["radius_mm"])
    return _filled(case, section, mesh, arrays["shares"], wall, breast, arrays["centre_mm"], radius)


def plane_of(case: LumpectomyCase, centre: np.ndarray) -> tuple[Section, float]:
    """Return the section of a resection whose centre (3,) LPS [mm] is given, and the radius of its disc there [mm].

    Raises
    ------
    InputError
        If the section does not cut the resection.
    """
    normal = Section(case.image.plane, 0.0).axes[2]
    position = centre[normal] if case.image.slice_mm is None else case.image.slice_mm
    section = Section(case.image.plane, float(position))
    return section, _radius_in_plane(case.resection.radius_mm, position - centre[normal])


def _radius_in_plane(radius: float, offset: float) -> float:
    if abs(offset) >= radius:
        raise InputError(
            f"image.slice_mm lies {abs(offset):.1f} mm from the centre of the resection, beyond its radius of {radius:g} mm: "
            "the section does not cut the cavity."
        )
    return float(np.sqrt(radius**2 - offset**2))


def _breast(anatomy: Anatomy, section: Section, raster: Raster, centre: np.ndarray) -> np.ndarray:
    mask = anatomy.body.sample(section.to_patient(raster.points)) > 0.5
    row, column = np.rint(raster.index(centre)).astype(int)
    if not (0 <= row < mask.shape[0] and 0 <= column < mask.shape[1] and mask[row, column]):
        where = ", ".join(f"{c:.1f}" for c in centre)
        raise InputError(f"resection.centre_mm must lie inside the breast; ({where}) mm in the section does not.")
    return component_at(mask, row, column)


def _cavity(body: np.ndarray, raster: Raster, centre: np.ndarray, radius: float, edge_mm: float):
    """Return the signed distance to the cavity: the disc, except the layer below the skin that surgery preserves.

    The mesh approximates the disc by a polygon. Its corners lie on a slightly larger circle, so that it has the area of the disc.
    """
    depth = -float(interpolant(body, raster)(centre[None])[0])
    widest = float(-body.min())
    if radius > widest:
        raise InputError(
            f"resection.radius_mm must be smaller than the breast in this section, where the largest disc has a radius of "
            f"{widest:.1f} mm; got {radius:.1f}."
        )
    check_flap(depth)
    distance, corners = interpolant(body, raster), radius + edge_mm**2 / (12.0 * radius)
    return lambda p: np.maximum(np.hypot(*(p - centre).T) - corners, distance(p) + MIN_SKIN_FLAP_MM)


def _border(anatomy: Anatomy, section: Section, raster: Raster) -> BorderAt:
    """Return a function of points just outside the body: on the skin nearer to air than to chest, else on the wall or the rim.

    Without chest in the image, or with a trunk, the body is held where the image ends; with a trunk that is never the wall.
    """
    labels = anatomy.domain
    values = labels.nearest(section.to_patient(raster.points))
    is_cut = not (labels.values == Label.CHEST).any()
    chest = np.pad(values == Label.CHEST, 1, constant_values=is_cut or anatomy.has_trunk)
    air = np.pad(values == Label.AIR, 1, constant_values=False)
    if not chest.any():
        raise InputError("The section touches no chest wall: choose another image.plane or image.slice_mm.")
    around = section.to_patient(raster.widened().points)
    before = raster.pixel_mm if is_cut else 0.5 * raster.pixel_mm  # pixels on the wall are behind it
    behind = around[..., 1] > height_at(labels, wall_beside(labels, anatomy.wall_mm), around) - before
    nearer_chest = _nearer(chest, air)
    nearer_wall = _nearer(chest & behind, chest & ~behind)

    def border(p: np.ndarray) -> np.ndarray:
        held = np.where(_share(nearer_wall, raster, p) > 0.5, Border.WALL, Border.RIM)
        return np.where(_share(nearer_chest, raster, p) > 0.5, held, Border.SKIN)

    return border


def _nearer(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Check which pixels lie nearer to one mask than to another; an empty mask is infinitely far away."""
    nearer, farther = (
        np.asarray(distance_transform_edt(~mask)) if mask.any() else np.full(mask.shape, np.inf)
        for mask in (one, other)
    )
    return nearer < farther


def _share(mask: np.ndarray, raster: Raster, p: np.ndarray) -> np.ndarray:
    """Interpolate a mask, padded by a pixel, at points (n, 2) [mm] -> (n,) [1]."""
    return map_coordinates(mask.astype(float), raster.index(p) + 1.0, order=1, mode="nearest")


def _filled(
    case: LumpectomyCase,
    section: Section,
    mesh: skfem.MeshTri,
    shares: np.ndarray,
    wall: Wall | None,
    breast_share: float,
    centre: np.ndarray,
    radius: float,
) -> SectionModel:
    """Build the model from mesh, tissue shares and chest wall."""
    skin, behind, rim = (mesh.boundaries[name] for name in ("skin", "wall", "rim"))
    if not len(behind) + len(rim):
        raise InputError("The section touches no chest wall: choose another image.plane or image.slice_mm.")
    space = Space(mesh)
    discretization = supported(case, space, skin, behind, rim)
    wall_nodes = np.unique(space.facet_nodes(behind))
    tissue = with_ligaments(tissue_of(case.tissue, shares), case.tissue.ligaments, discretization, wall_nodes)
    return SectionModel(
        intact=intact_body(case, discretization, tissue, wall),
        tissue=tissue,
        scar=scar_of(case),
        shares=shares,
        wall=wall,
        breast_share=breast_share,
        cavity=np.isin(np.arange(mesh.nelements), mesh.subdomains["cavity"]),
        centre_mm=centre,
        radius_mm=radius,
        side=case.image.side,
        nipple_mm=nipple_of(case),
        section=section,
        mesh=mesh,
    )


def _ordered_outline(space: Space) -> np.ndarray:
    """Return the boundary nodes of the section in order around it (n,): vertex, midpoint, vertex, ..."""
    edges = space.facet_nodes(space.mesh.boundary_facets())
    following: dict[int, list[tuple[int, int]]] = {}
    for a, b, middle in edges.tolist():
        following.setdefault(a, []).append((b, middle))
        following.setdefault(b, []).append((a, middle))
    start = int(edges[0, 0])
    path, previous, here = [], -1, start
    while True:
        after, middle = next(step for step in following[here] if step[1] != previous)
        path += [here, middle]
        previous, here = middle, after
        if here == start:
            return np.array(path)
