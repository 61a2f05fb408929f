"""Model of the whole breast: a tetrahedral mesh with the tissue at its quadrature points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...core.errors import InputError
from ...geometry.borders import Border
from ...geometry.isosurface import LEVEL, Isosurface, isosurface, segmented_body
from ...geometry.labels import Label
from ...geometry.meshing import Function
from ...geometry.meshing3d import MIN_SMOOTHING, BodyMesh, Region, attempts, mesh_body
from ...geometry.surface import Surface
from ...geometry.tetrahedra import with_middles
from ...geometry.transfer import QUARTERS
from ...mechanics.space import SolidSpace
from ...outcome.change import ShapeChange
from ...outcome.surface import compare_surfaces
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
from .fascia import Wall, distance_in_solid, in_fold
from .ligaments import with_ligaments


@dataclass(frozen=True, eq=False, kw_only=True)
class SolidModel(BreastModel):
    """Model of the whole breast in tetrahedra, in LPS axes.

    Parameters
    ----------
    corners : (n_corners, 3) array [mm]
        Corners of the elements as imaged; they are the first of the body's nodes.
    border : (n_faces,) uint8 array
        `Border` of each face of the boundary.
    """

    corners: np.ndarray
    border: np.ndarray

    @property
    def space(self) -> SolidSpace:
        """Nodes and elements."""
        space = self.intact.discretization.space
        assert isinstance(space, SolidSpace)
        return space

    @cached_property
    def triangles(self) -> np.ndarray:
        """The surface in flat triangles, four to a face, seen from outside (4 n_faces, 3)."""
        return self.space.boundary[:, QUARTERS].reshape(-1, 3)

    @cached_property
    def on_skin(self) -> np.ndarray:
        """Whether each of ``triangles`` is skin (4 n_faces,) bool."""
        return np.repeat(self.border == Border.SKIN, len(QUARTERS))

    @cached_property
    def cavity_triangles(self) -> np.ndarray:
        """The cavity's border in flat triangles, seen from its inside (n, 3)."""
        cavity = SolidSpace(self.space.positions, self.space.element_nodes[self.cavity])
        return cavity.boundary[:, QUARTERS].reshape(-1, 3)[:, ::-1]

    @cached_property
    def nipple(self) -> int:
        """Node that represents the nipple."""
        skin = np.unique(self.triangles[self.on_skin])
        return int(skin[self.nipple_among(self.x_imaged[skin])])

    def from_patient(self, vectors: np.ndarray) -> np.ndarray:
        """Return LPS components unchanged: they are the components in the solid's axes."""
        return np.asarray(vectors, float)

    def nipple_position(self, x: np.ndarray) -> np.ndarray:
        """Return the nipple's position in a shape (n_nodes, 3) [mm] (3,)."""
        return x[self.nipple]

    def to_patient(self, vector: np.ndarray) -> np.ndarray:
        """Return a vector (3,) unchanged: its components are LPS."""
        return np.asarray(vector, float)

    def _body_change(self, before: np.ndarray, after: np.ndarray) -> ShapeChange:
        """Measure the change of the surface between two loaded shapes (n_nodes, 3) [mm]."""
        return compare_surfaces(before, after, self.triangles, self.on_skin, self.nipple)

    def retraction(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return the depth of the surface of shape ``after`` below that of ``before``: (n_nodes, 3) [mm] -> (n_nodes,) [mm].

        It is negative where the surface lies outside, and 0 at nodes inside the body.
        """
        out = np.zeros(len(before))
        outer = np.unique(self.triangles)
        out[outer] = Surface(before, self.triangles).inward(after[outer])
        return out

    def margin_mm(self, anatomy: Anatomy) -> float:
        """Compute the smallest distance from the labelled tumour to the edge of the resection's ball [mm]; inf without tumour."""
        tumour = anatomy.labels.position(np.argwhere(anatomy.labels.values == Label.TUMOUR))
        away = np.linalg.norm(tumour - self.centre_mm, axis=-1)
        return float(self.radius_mm - np.max(away, initial=-np.inf))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays from which ``solid_from_arrays`` builds the same model again."""
        return self.common_arrays() | {
            "corners": self.corners,
            "tetrahedra": self.space.element_nodes[:, :4],
            "cavity": self.cavity,
            "border": self.border,
        }


def solid_model(case: LumpectomyCase, anatomy: Anatomy) -> SolidModel:
    """Mesh the breast with the cavity's border on faces of elements, and fill it with tissue.

    Raises
    ------
    InputError
        If there is no breast, it touches no chest wall, meshing fails, or the resection does not lie inside the breast.
    """
    centre, radius = resection_of(case, anatomy), case.resection.radius_mm
    edge = case.mesh.edge_mm
    thin = attempts(anatomy.has_trunk)[0].thin_share * edge
    body = segmented_body(anatomy.domain, anatomy.body, finest_mm=edge / 6, thin_mm=thin).share
    surface = isosurface(body, MIN_SMOOTHING * np.asarray(body.spacing_mm))
    return _meshed(case, anatomy, _cavity(surface, centre, radius), centre, radius)


def intact_solid(case: LumpectomyCase, anatomy: Anatomy) -> SolidModel:
    """Mesh the breast without a resection, and fill it with tissue, for mechanics alone.

    Raises
    ------
    InputError
        If there is no breast, it touches no chest wall, or meshing fails.
    """
    return _meshed(case, anatomy, None, np.full(3, np.nan), 0.0)


def _meshed(
    case: LumpectomyCase, anatomy: Anatomy, cavity: Function | None, centre: np.ndarray, radius: float
) -> SolidModel:
    mesh = mesh_body(
        anatomy.domain,
        case.mesh.edge_mm,
        tissue=anatomy.body,
        wall_mm=anatomy.wall_mm,
        has_trunk=anatomy.has_trunk,
        cavity=cavity,
        cavity_edge_mm=case.mesh.cavity_edge_mm,
    )
    space = SolidSpace(*with_middles(mesh.nodes, mesh.tetrahedra))
    shares = shares_at(anatomy, quadrature_points(space))
    wall = _wall(anatomy, space, np.flatnonzero(mesh.marker == Border.WALL)) if case.fascia.slides else None
    is_cavity = mesh.region == Region.CAVITY
    breast = anatomy.breast_share(anatomy.labels.values, anatomy.body.values)
    return _filled(case, mesh.nodes, space, is_cavity, mesh.marker, shares, wall, breast, centre, radius, _notes(mesh))


def _wall(anatomy: Anatomy, space: SolidSpace, facets: np.ndarray) -> Wall:
    """Return the chest wall behind a mesh, with its facets on the wall."""
    centres = space.positions[space.facet_nodes(facets)].mean(axis=1)
    return Wall(distance_in_solid(anatomy.wall_distance), in_fold(anatomy.fold, centres))


def solid_from_arrays(case: LumpectomyCase, arrays: Mapping[str, np.ndarray]) -> SolidModel:
    """Rebuild the breast model of an interrupted run from its stored arrays, bitwise identical, without reading the image."""
    corners = arrays["corners"]
    space = SolidSpace(*with_middles(corners, arrays["tetrahedra"]))
    centre, radius = arrays["centre_mm"], float(arrays["radius_mm"])
    cavity, border, shares = (arrays[name] for name in ("cavity", "border", "shares"))
    wall, breast = Wall.from_arrays(arrays), float(arrays["breast_share"])
    return _filled(case, corners, space, cavity, border, shares, wall, breast, centre, radius)


def _cavity(surface: Isosurface, centre: np.ndarray, radius: float) -> Function:
    """Return the signed distance to the cavity: the ball, except the layer below the skin that surgery preserves.

    Raises
    ------
    InputError
        If the centre does not lie inside the breast, or no ball of this radius fits into the breast.
    """
    depth = -float(surface.distance(centre[None])[0])
    if depth <= 0:
        where = ", ".join(f"{c:.1f}" for c in centre)
        raise InputError(f"resection.centre_mm must lie inside the breast; ({where}) mm does not.")
    check_flap(depth)
    share = surface.share
    inner = share.position(np.argwhere(share.values > LEVEL)[:: max(1, share.values.size // 200_000)])
    widest = float(-surface.distance(inner).min())
    if radius > widest:
        raise InputError(
            f"resection.radius_mm must be smaller than the breast, where the largest ball has a radius of "
            f"{widest:.1f} mm; got {radius:.1f}."
        )
    reach = radius + MIN_SKIN_FLAP_MM

    def cavity(points: np.ndarray) -> np.ndarray:
        ball = np.linalg.norm(points - centre, axis=1) - radius
        near = ball < reach
        out = ball.copy()
        out[near] = np.maximum(ball[near], surface.distance(points[near], reach) + MIN_SKIN_FLAP_MM)
        return out

    return cavity


def _notes(mesh: BodyMesh) -> tuple[str, ...]:
    q = mesh.quality
    measured = (
        f"mesh: {len(mesh.tetrahedra)} tetrahedra, least angle {q.least_dihedral_deg:.0f} degrees, "
        f"volume off by {100 * q.volume_error:+.2f} %, skin by {q.skin_distance:.2f} mm"
    )
    return measured, *mesh.notes


def _filled(
    case: LumpectomyCase,
    corners: np.ndarray,
    space: SolidSpace,
    cavity: np.ndarray,
    border: np.ndarray,
    shares: np.ndarray,
    wall: Wall | None,
    breast_share: float,
    centre: np.ndarray,
    radius: float,
    notes: tuple[str, ...] = (),
) -> SolidModel:
    """Build the model from mesh, tissue shares and chest wall."""
    skin, behind = np.flatnonzero(border == Border.SKIN), np.flatnonzero(border == Border.WALL)
    rim = np.flatnonzero((border == Border.RIM) | (border == Border.CUT))
    discretization = supported(case, space, skin, behind, rim)
    wall_nodes = np.unique(space.facet_nodes(behind))
    tissue = with_ligaments(tissue_of(case.tissue, shares), case.tissue.ligaments, discretization, wall_nodes)
    return SolidModel(
        intact=intact_body(case, discretization, tissue, wall),
        tissue=tissue,
        scar=scar_of(case),
        shares=shares,
        wall=wall,
        breast_share=breast_share,
        cavity=cavity,
        centre_mm=centre,
        radius_mm=radius,
        side=case.image.side,
        nipple_mm=nipple_of(case),
        corners=corners,
        border=border,
        notes=notes,
    )
