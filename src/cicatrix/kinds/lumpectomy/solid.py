"""The breast as a solid: meshed in tetrahedra, and filled with tissue."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...core.errors import InputError
from ...coupling.cycle import Tissue
from ...geometry.isosurface import LEVEL, Isosurface, isosurface, segmented_body
from ...geometry.labels import Label
from ...geometry.meshing import Function
from ...geometry.meshing3d import LEAST_SMOOTHING, BodyMesh, Border, Region, mesh_body
from ...geometry.surface import Surface
from ...geometry.tetrahedra import with_middles
from ...geometry.transfer import QUARTERS
from ...mechanics.body import Frame
from ...mechanics.space import SolidSpace
from ...outcome.change import ShapeChange
from ...outcome.surface import compare_surfaces
from .body import (
    LEAST_SKIN_FLAP_MM,
    Anatomy,
    Plan,
    check_flap,
    intact_body,
    nipple_of,
    quadrature_points,
    resection_of,
    scar_of,
    tissue_at,
)
from .case import LumpectomyCase


@dataclass(frozen=True, eq=False, kw_only=True)
class SolidPlan(Plan):
    """A breast of tetrahedra, in LPS axes.

    Parameters
    ----------
    corners : (n_corners, 3) array [mm]
        Corners of the elements as imaged; they are the first of the nodes.
    border : (n_faces,) uint8 array
        `Border` of each face of the boundary.
    """

    corners: np.ndarray
    border: np.ndarray

    @property
    def space(self) -> SolidSpace:
        """Nodes and elements."""
        space = self.intact.frame.space
        assert isinstance(space, SolidSpace)
        return space

    @cached_property
    def triangles(self) -> np.ndarray:
        """The surface in flat triangles, four to a face, seen from outside (4 n_faces, 3)."""
        return self.space.boundary[:, QUARTERS].reshape(-1, 3)

    @cached_property
    def on_skin(self) -> np.ndarray:
        """Which of ``triangles`` are skin (4 n_faces,) bool."""
        return np.repeat(self.border == Border.SKIN, len(QUARTERS))

    @cached_property
    def cavity_triangles(self) -> np.ndarray:
        """The cavity's border in flat triangles, seen from its inside (n, 3)."""
        cavity = SolidSpace(self.space.positions, self.space.element_nodes[self.cavity])
        return cavity.boundary[:, QUARTERS].reshape(-1, 3)[:, ::-1]

    @cached_property
    def nipple(self) -> int:
        """Node that is taken for the nipple."""
        skin = np.unique(self.triangles[self.on_skin])
        return int(skin[self.nipple_among(self.x_imaged[skin])])

    def from_patient(self, vectors: np.ndarray) -> np.ndarray:
        """LPS components: they are the solid's own."""
        return np.asarray(vectors, float)

    def change(self, before: np.ndarray, after: np.ndarray) -> ShapeChange:
        """Compare the surfaces of loaded shapes (n_nodes, 3) [mm]."""
        return compare_surfaces(before, after, self.triangles, self.on_skin, self.nipple)

    def retraction(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """How far inside the surface of a loaded shape another one's lies: (n_nodes, 3) [mm] -> (n_nodes,) [mm]; 0 within."""
        out = np.zeros(len(before))
        outer = np.unique(self.triangles)
        out[outer] = Surface(before, self.triangles).inward(after[outer])
        return out

    def margin_mm(self, anatomy: Anatomy) -> float:
        """Least distance from the labelled tumour to the edge of the resection's ball [mm]; inf without tumour."""
        tumour = anatomy.labels.position(np.argwhere(anatomy.labels.values == Label.TUMOUR))
        away = np.linalg.norm(tumour - self.centre_mm, axis=-1)
        return float(self.radius_mm - np.max(away, initial=-np.inf))

    def arrays(self) -> dict[str, np.ndarray]:
        """What ``solid_from_arrays`` needs to make the same plan again."""
        return self.tissue_arrays() | {
            "corners": self.corners,
            "tetrahedra": self.space.element_nodes[:, :4],
            "cavity": self.cavity,
            "border": self.border,
        }


def plan_solid(case: LumpectomyCase, anatomy: Anatomy) -> SolidPlan:
    """Mesh the breast with the cavity's border on faces of elements, and fill it with tissue.

    Raises
    ------
    InputError
        If there is no breast, nothing holds it, it has no good mesh, or the resection does not lie inside it.
    """
    centre, radius = resection_of(case, anatomy), case.resection.radius_mm
    edge = case.mesh.edge_mm
    body = segmented_body(anatomy.labels, anatomy.breast, finest_mm=edge / 6, thin_mm=2 / 3 * edge).share
    surface = isosurface(body, LEAST_SMOOTHING * np.asarray(body.spacing_mm))
    mesh = mesh_body(
        anatomy.labels,
        edge,
        tissue=anatomy.breast,
        cavity=_cavity(surface, centre, radius),
        cavity_edge_mm=case.mesh.cavity_edge_mm,
    )
    space = SolidSpace(*with_middles(mesh.nodes, mesh.tetrahedra))
    tissue = tissue_at(case.tissue, anatomy, quadrature_points(space))
    is_cavity = mesh.region == Region.CAVITY
    return _filled(case, mesh.nodes, space, is_cavity, mesh.marker, tissue, centre, radius, _notes(mesh))


def solid_from_arrays(case: LumpectomyCase, arrays: Mapping[str, np.ndarray]) -> SolidPlan:
    """Make the plan of a stopped run again, to the bit, without the image."""
    corners = arrays["corners"]
    space = SolidSpace(*with_middles(corners, arrays["tetrahedra"]))
    tissue = Tissue(arrays["mu"], arrays["kappa"], arrays["density"])
    centre, radius = arrays["centre_mm"], float(arrays["radius_mm"])
    return _filled(case, corners, space, arrays["cavity"], arrays["border"], tissue, centre, radius)


def _cavity(surface: Isosurface, centre: np.ndarray, radius: float) -> Function:
    """Signed distance of the cavity: the ball, kept below a flap of skin.

    Raises
    ------
    InputError
        If its centre does not lie inside the breast, or no ball of its radius fits there.
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
    reach = radius + LEAST_SKIN_FLAP_MM

    def cavity(points: np.ndarray) -> np.ndarray:
        ball = np.linalg.norm(points - centre, axis=1) - radius
        near = ball < reach
        out = ball.copy()
        out[near] = np.maximum(ball[near], surface.distance(points[near], reach) + LEAST_SKIN_FLAP_MM)
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
    tissue: Tissue,
    centre: np.ndarray,
    radius: float,
    notes: tuple[str, ...] = (),
) -> SolidPlan:
    """Join mesh and tissue to the intact body: outer faces carry skin, or are held."""
    held = np.unique(space.facet_nodes(np.flatnonzero(border != Border.SKIN)))
    frame = Frame(space, np.flatnonzero(border == Border.SKIN), held)
    return SolidPlan(
        intact=intact_body(case, frame, tissue),
        tissue=tissue,
        scar=scar_of(case),
        cavity=cavity,
        centre_mm=centre,
        radius_mm=radius,
        nipple_mm=nipple_of(case),
        corners=corners,
        border=border,
        notes=notes,
    )
