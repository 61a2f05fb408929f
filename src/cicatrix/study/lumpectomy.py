"""From a case and a segmented image to the healing cycle: the one place that knows every package."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem
from scipy.ndimage import distance_transform_edt, map_coordinates

from ..core.errors import InputError
from ..core.units import STANDARD_GRAVITY_M_S2, acceleration_mm_s2, days_from_weeks, density_kg_mm3, mm_from_um
from ..coupling.cycle import HealingCycle, Tissue, tissue_law
from ..coupling.deposition import Deposition
from ..geometry.hexgrid import Lattice
from ..geometry.labels import TISSUES, Label
from ..geometry.meshing import component_at, interpolant, label_borders, mesh_section, signed_distance
from ..geometry.section import Raster, Section
from ..geometry.transfer import OUTSIDE, SiteMap, locate_sites
from ..geometry.volume import Volume
from ..healing.automaton import Automaton
from ..healing.rates import rules_at_pitch
from ..materials.neo_hookean import NeoHookean, moduli_from_young
from ..mechanics.body import Body, Frame
from ..mechanics.elements import wrinkling_strain
from ..mechanics.equilibrium import Equilibrium
from ..mechanics.space import Space
from .case import LumpectomyCase

# which way is down, as LPS components, for each position of the patient
DOWN = {"upright": (0.0, 0.0, -1.0), "prone": (0.0, -1.0, 0.0), "supine": (0.0, 1.0, 0.0)}
LEAST_SKIN_FLAP_MM = 3.0  # the cavity stays this far below the skin and off the chest wall


@dataclass(frozen=True, eq=False)
class Anatomy:
    """The segmented image: labels (nz, ny, nx) and tissue probabilities (4, nz, ny, nx) on one grid.

    ``tumour_mm`` (3,) LPS [mm] is where the tumour is known to be, if it is known otherwise than by its label.
    """

    image: Volume | None
    labels: Volume
    probabilities: Volume
    tumour_mm: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """The section, its mesh and the body in it, before anything is removed."""

    section: Section
    mesh: skfem.MeshTri
    intact: Body
    tissue: Tissue
    scar: Tissue
    centre_mm: np.ndarray
    radius_mm: float

    @cached_property
    def cavity(self) -> np.ndarray:
        """Elements that the resection takes out (n_elements,) bool."""
        removed = np.zeros(self.mesh.nelements, bool)
        removed[self.mesh.subdomains["cavity"]] = True
        return removed

    @cached_property
    def cavity_border(self) -> np.ndarray:
        """Mesh edges between the cavity and the tissue around it (n_edges,)."""
        inner, outer = self.mesh.f2t
        return np.flatnonzero((outer >= 0) & (self.cavity[inner] != self.cavity[np.maximum(outer, 0)]))

    @property
    def x_imaged(self) -> np.ndarray:
        """Positions as imaged (n_nodes, 3) [mm]."""
        return self.intact.frame.space.positions

    @cached_property
    def outline(self) -> np.ndarray:
        """Nodes around the section in order, vertices and midpoints (n,)."""
        return _ordered_outline(self.intact.frame.space)

    @cached_property
    def on_skin(self) -> np.ndarray:
        """Which outline nodes lie on the skin (n,) bool."""
        return np.isin(self.outline, self.intact.frame.skin_nodes)

    @cached_property
    def nipple(self) -> int:
        """Row of ``outline`` of the most anterior point of the skin, where the nipple is taken to be."""
        anterior = -self.section.to_patient(self.x_imaged[self.outline, :2])[:, 1]
        return int(np.argmax(np.where(self.on_skin, anterior, -np.inf)))

    def gravity(self, position: str) -> np.ndarray:
        """Gravity in the section's axes (3,) [mm/s^2]."""
        return self.section.from_patient(np.array(DOWN[position])) * acceleration_mm_s2(STANDARD_GRAVITY_M_S2)


def resection_of(case: LumpectomyCase, anatomy: Anatomy) -> np.ndarray:
    """Centre of the resection (3,) LPS [mm]: as the case says, else the tumour's.

    Raises
    ------
    InputError
        If there is neither.
    """
    if case.resection.centre_mm is not None:
        return np.asarray(case.resection.centre_mm, float)
    if anatomy.tumour_mm is not None:
        return anatomy.tumour_mm
    tumour = np.argwhere(anatomy.labels.values == Label.TUMOUR)
    if not len(tumour):
        raise InputError("resection.centre_mm is missing and the labels hold no tumour: give the centre.")
    return anatomy.labels.position(tumour.mean(axis=0))


def plan(case: LumpectomyCase, anatomy: Anatomy) -> Plan:
    """Cut the section, mesh it with the cavity's border on element edges, and fill it with tissue.

    Raises
    ------
    InputError
        If the section holds no breast, no chest wall, or the resection does not lie inside it.
    """
    centre = resection_of(case, anatomy)
    normal = Section(case.image.plane, 0.0).axes[2]
    position = centre[normal] if case.image.slice_mm is None else case.image.slice_mm
    section = Section(case.image.plane, float(position))
    radius = _radius_in_plane(case.resection.radius_mm, position - centre[normal])
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
    mesh = label_borders(mesh, _is_wall(anatomy.labels, section, raster))
    return _filled(case, section, mesh, _tissue(case, anatomy, section, Space(mesh)), centre, radius)


def margin_mm(planned: Plan, anatomy: Anatomy) -> float:
    """Least distance from the labelled tumour to the edge of the resection's disc in this section [mm]; inf without tumour."""
    raster = planned.section.raster(anatomy.labels, min(anatomy.labels.spacing_mm))
    tumour = anatomy.labels.nearest(planned.section.to_patient(raster.points)) == Label.TUMOUR
    away = np.linalg.norm(raster.points[tumour] - planned.section.from_patient(planned.centre_mm)[:2], axis=-1)
    return float(planned.radius_mm - np.max(away, initial=-np.inf))


def plan_arrays(planned: Plan) -> dict[str, np.ndarray]:
    """What ``plan_from_arrays`` needs to make the same plan again."""
    mesh, tissue = planned.mesh, planned.tissue
    return {
        "points": mesh.p,
        "triangles": mesh.t,
        "cavity": mesh.subdomains["cavity"],
        "skin": mesh.boundaries["skin"],
        "wall": mesh.boundaries["wall"],
        "mu": tissue.mu,
        "kappa": tissue.kappa,
        "density": tissue.density,
        "section_mm": np.array(planned.section.position_mm),
        "centre_mm": planned.centre_mm,
        "radius_mm": np.array(planned.radius_mm),
    }


def plan_from_arrays(case: LumpectomyCase, arrays: Mapping[str, np.ndarray]) -> Plan:
    """Make the plan of a stopped run again, to the bit, without the image."""
    mesh = skfem.MeshTri(arrays["points"], arrays["triangles"]).with_subdomains({"cavity": arrays["cavity"]})
    mesh = mesh.with_boundaries({name: arrays[name] for name in ("skin", "wall")})
    section = Section(case.image.plane, float(arrays["section_mm"]))
    tissue = Tissue(arrays["mu"], arrays["kappa"], arrays["density"])
    return _filled(case, section, mesh, tissue, arrays["centre_mm"], float(arrays["radius_mm"]))


def _radius_in_plane(radius: float, offset: float) -> float:
    if abs(offset) >= radius:
        raise InputError(
            f"image.slice_mm lies {abs(offset):.1f} mm from the centre of the resection, beyond its radius of {radius:g} mm: "
            "the section does not cut the cavity."
        )
    return float(np.sqrt(radius**2 - offset**2))


def _breast(anatomy: Anatomy, section: Section, raster: Raster, centre: np.ndarray) -> np.ndarray:
    tissue = anatomy.probabilities.with_values(anatomy.probabilities.values.sum(axis=0))
    mask = tissue.sample(section.to_patient(raster.points)) > 0.5
    row, column = np.rint(raster.index(centre)).astype(int)
    if not (0 <= row < mask.shape[0] and 0 <= column < mask.shape[1] and mask[row, column]):
        where = ", ".join(f"{c:.1f}" for c in centre)
        raise InputError(f"resection.centre_mm must lie inside the breast; ({where}) mm in the section does not.")
    return component_at(mask, row, column)


def _cavity(body: np.ndarray, raster: Raster, centre: np.ndarray, radius: float, edge_mm: float):
    """Signed distance of the cavity: the disc, kept below a flap of skin.

    The mesh makes a polygon of it; its corners lie on a circle so much larger that the polygon has the disc's area.
    """
    depth = -float(interpolant(body, raster)(centre[None])[0])
    widest = float(-body.min())
    if radius > widest:
        raise InputError(
            f"resection.radius_mm must be smaller than the breast in this section, where the largest disc has a radius of "
            f"{widest:.1f} mm; got {radius:.1f}."
        )
    if depth < LEAST_SKIN_FLAP_MM:
        raise InputError(
            f"resection.centre_mm must lie at least {LEAST_SKIN_FLAP_MM:g} mm inside the breast; it lies {depth:.1f} mm inside."
        )
    distance, corners = interpolant(body, raster), radius + edge_mm**2 / (12.0 * radius)
    return lambda p: np.maximum(np.hypot(*(p - centre).T) - corners, distance(p) + LEAST_SKIN_FLAP_MM)


def _is_wall(labels: Volume, section: Section, raster: Raster):
    """Say whether points just outside the breast lie in the chest (or beyond the image) rather than in air."""
    values = labels.nearest(section.to_patient(raster.points))
    chest = np.pad(values == Label.CHEST, 1, constant_values=not (labels.values == Label.CHEST).any())
    air = np.pad(values == Label.AIR, 1, constant_values=False)
    if not chest.any():
        raise InputError("The section touches no chest wall: choose another image.plane or image.slice_mm.")
    nearer_chest = distance_transform_edt(~chest) < (distance_transform_edt(~air) if air.any() else np.inf)  # pyright: ignore[reportOperatorIssue]
    return lambda p: map_coordinates(nearer_chest.astype(float), raster.index(p) + 1.0, order=1, mode="nearest") > 0.5


def _filled(
    case: LumpectomyCase, section: Section, mesh: skfem.MeshTri, tissue: Tissue, centre: np.ndarray, radius: float
) -> Plan:
    """Join mesh and tissue to the intact body."""
    wall = mesh.boundaries["wall"]
    if not len(wall):
        raise InputError("The section touches no chest wall: choose another image.plane or image.slice_mm.")
    space = Space(mesh)
    frame = Frame(space, mesh.boundaries["skin"], np.unique(space.facet_nodes(wall)))
    new, skin = case.tissue.scar, case.tissue.skin
    scar = Tissue(*moduli_from_young(new.E_kPa, new.nu), density_kg_mm3(new.density_kg_m3))
    natural = np.broadcast_to(np.eye(3), (*tissue.mu.shape, 3, 3))
    intact = Body(
        frame,
        law=tissue_law(NeoHookean(tissue.mu, tissue.kappa), np.zeros_like(tissue.mu), natural),
        density=tissue.density,
        fraction=np.ones(space.n_elements),
        skin=NeoHookean(*moduli_from_young(skin.E_kPa, skin.nu)),
        skin_thickness=np.full(len(frame.skin_facets), skin.thickness_mm),
        wrinkling_strain=wrinkling_strain(skin.E_kPa, case.tissue.fat.E_kPa),
    )
    return Plan(section, mesh, intact, tissue, scar, centre, radius)


def _tissue(case: LumpectomyCase, anatomy: Anatomy, section: Section, space: Space) -> Tissue:
    """Mix constants by probability at the quadrature points; skin weighs there, but bears load as a membrane."""
    points = np.einsum("qa,eai->eqi", space.table.value, space.positions[space.element_nodes])[..., :2]
    shares = np.moveaxis(anatomy.probabilities.sample(section.to_patient(points)), 0, -1)
    shares[..., TISSUES.index(Label.FAT)] += 1e-3  # where there is nothing at all
    bearing = np.where(np.array(TISSUES) == Label.SKIN, 0.0, shares)
    parts = [getattr(case.tissue, label.name.lower()) for label in TISSUES]
    mu, kappa = _mean(bearing, np.array([moduli_from_young(p.E_kPa, p.nu) for p in parts]))
    (density,) = _mean(shares, np.array([[density_kg_mm3(p.density_kg_m3)] for p in parts]))
    return Tissue(mu, kappa, density)


def _mean(shares: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Mean of some values of each tissue, by shares: (..., n_tissues), (n_tissues, n) -> (n, ...)."""
    return np.moveaxis(shares @ values / shares.sum(axis=-1, keepdims=True), -1, 0)


def imaged_in(case: LumpectomyCase, planned: Plan, position: str) -> np.ndarray | None:
    """Where a solve in this position may start: the imaged shape is the answer in the position of the image."""
    return planned.x_imaged if position == case.image.position else None


def equilibrium_of(case: LumpectomyCase, tell: Callable[[str], None] | None = None) -> Equilibrium:
    """The mechanical solver that the case asks for; ``tell`` hears of its iterations."""
    return Equilibrium(case.solver.relative_tolerance, tell)


def lattice_on(case: LumpectomyCase, planned: Plan, X: np.ndarray) -> tuple[Automaton, SiteMap]:
    """Lay the lattice over the cavity and its active layer in the unloaded reference, and put the cells on it."""
    space = planned.intact.frame.space
    nodes = space.element_nodes[:, :6]
    h = case.healing
    rules = rules_at_pitch(
        h.pitch_um,
        p_edge=h.p_edge,
        p_layer=h.p_layer,
        layer_um=h.layer_um,
        motility_substeps=h.motility_substeps,
        redistribution=h.redistribution,
        feedback=h.feedback if case.coupling.mode == "two-way" else 0.0,
        min_free_neighbours=max(1, h.contact_inhibition),
    )
    around = X[nodes[planned.cavity]].reshape(-1, 3)[:, :2]
    pitch = mm_from_um(h.pitch_um)
    margin = (rules.layer_sites + 3 * rules.motility_substeps + 4) * pitch
    lattice = Lattice.covering(around.min(axis=0) - margin, around.max(axis=0) + margin, pitch)
    sites = locate_sites(X[nodes][..., :2], lattice.positions().reshape(-1, 2))
    fillable = (sites.element != OUTSIDE).reshape(lattice.shape)
    is_open = np.append(planned.cavity, False)[sites.element].reshape(lattice.shape)
    return Automaton(lattice, fillable, is_open, rules, case.run.seed), sites


def healing_cycle(
    case: LumpectomyCase, planned: Plan, X: np.ndarray, x_intact: np.ndarray, equilibrium: Equilibrium
) -> HealingCycle:
    """Join mechanics and healing.

    X, x_intact (n_nodes, 3) [mm]: unloaded shape, and loaded shape in the healing position, of the intact body.
    """
    automaton, sites = lattice_on(case, planned, X)
    return HealingCycle(
        intact=planned.intact,
        X=X,
        x_intact=x_intact,
        gravity=planned.gravity(case.coupling.healing_position),
        tissue=planned.tissue,
        scar=planned.scar,
        cavity=planned.cavity,
        contraction=case.healing.contraction_kPa,
        automaton=automaton,
        sites=sites,
        deposition=Deposition(case.healing.deposition == "loaded", case.healing.deposition_prestretch),
        days_per_cycle=case.coupling.days_per_cycle,
        days_per_step=case.healing.days_per_step,
        equilibrium=equilibrium,
    )


def last_cycle(case: LumpectomyCase) -> int:
    """Number of the last cycle that the case allows."""
    return int(np.ceil(days_from_weeks(case.run.max_weeks) / case.coupling.days_per_cycle - 1e-9))


def _ordered_outline(space: Space) -> np.ndarray:
    """Boundary nodes of the section in order around it (n,): vertex, midpoint, vertex, ..."""
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


def visit_cycles(case: LumpectomyCase) -> dict[float, int]:
    """Cycle nearest to each visit: weeks -> cycle number."""
    return {w: round(days_from_weeks(w) / case.coupling.days_per_cycle) for w in case.outcome.visits_weeks}
