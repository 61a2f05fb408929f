"""From a case and a segmented image to the healing cycle: the one place that knows every package."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...cases.continuum_laws import Network
from ...core.errors import InputError
from ...core.units import days_from_weeks, mm_from_um
from ...coupling.continuum import FieldsCycle
from ...coupling.cycle import HealingCycle
from ...coupling.deposition import Deposition
from ...geometry.hexgrid import Lattice
from ...geometry.transfer import OUTSIDE, SiteMap, locate_lattice, locate_sites
from ...healing.automaton import Automaton
from ...mechanics.equilibrium import Equilibrium
from .body import Anatomy, Plan
from .case import LumpectomyCase
from .continuum import fields_of
from .section import plan_section, section_from_arrays
from .sites import box_around, too_many
from .solid import plan_solid, solid_from_arrays


def plan(case: LumpectomyCase, anatomy: Anatomy) -> Plan:
    """Mesh the body with the cavity's border on the sides of elements, and fill it with tissue.

    Raises
    ------
    InputError
        If there is no breast, no chest wall, the resection does not lie inside it, its lattice would be too large, or the
        nipple lies off the skin.
    """
    planned = plan_section(case, anatomy) if case.dimension == 2 else plan_solid(case, anatomy)
    _lattice(case, planned, planned.x_imaged)  # before hours are spent on what would not fit
    _ = planned.nipple  # which may lie nowhere
    return planned


def plan_from_arrays(case: LumpectomyCase, arrays: Mapping[str, np.ndarray]) -> Plan:
    """Make the plan of a stopped run again, to the bit, without the image."""
    return section_from_arrays(case, arrays) if case.dimension == 2 else solid_from_arrays(case, arrays)


def imaged_in(case: LumpectomyCase, planned: Plan, position: str) -> np.ndarray | None:
    """Where a solve in this position may start: the imaged shape is the answer in the position of the image."""
    return planned.x_imaged if position == case.image.position else None


def equilibrium_of(case: LumpectomyCase, tell: Callable[[str], None] | None = None) -> Equilibrium:
    """The mechanical solver that the case asks for; ``tell`` hears of its iterations."""
    return Equilibrium(case.solver.relative_tolerance, tell)


def lattice_on(case: LumpectomyCase, planned: Plan, X: np.ndarray) -> tuple[Automaton, SiteMap]:
    """Lay the lattice over the cavity and its active layer in the unloaded reference, and put the cells on it.

    Raises
    ------
    InputError
        If it would have more sites than fit into memory.
    """
    space = planned.intact.frame.space
    lattice, box = _lattice(case, planned, X)
    nodes, is_solid = X[space.shape_nodes], space.n_axes == 3
    sites = locate_lattice(nodes, lattice, box) if is_solid else locate_sites(nodes[..., :2], _places(lattice))
    fillable = (sites.element != OUTSIDE).reshape(lattice.shape)
    is_open = np.append(planned.cavity, False)[sites.element].reshape(lattice.shape)
    return Automaton(lattice, fillable, is_open, case.rules(), case.run.seed), sites


def _lattice(case: LumpectomyCase, planned: Plan, X: np.ndarray) -> tuple[Lattice, np.ndarray]:
    """Lattice over the cavity with its active layer, and the box that it covers (2, n_axes) [mm]."""
    space, pitch_um = planned.intact.frame.space, case.healing.pitch_um
    around = X[space.shape_nodes[planned.cavity]].reshape(-1, 3)[:, : space.n_axes]
    box = box_around(around, case.rules(), pitch_um)
    lattice = Lattice.covering(box[0], box[1], mm_from_um(pitch_um))
    if reason := too_many(lattice, pitch_um):
        raise InputError(f"healing.pitch_um {reason}.")
    return lattice, box


def _places(lattice: Lattice) -> np.ndarray:
    return lattice.positions().reshape(-1, lattice.ndim)


def healing_cycle(
    case: LumpectomyCase,
    planned: Plan,
    X: np.ndarray,
    x_intact: np.ndarray,
    equilibrium: Equilibrium,
    network: Network | None = None,
) -> HealingCycle:
    """Join mechanics and healing.

    X, x_intact (n_nodes, 3) [mm]: unloaded shape, and loaded shape in the healing position, of the intact body. A network comes
    with healing by fields whose cells sense by it.
    """
    automaton, sites = lattice_on(case, planned, X)
    common = {
        "intact": planned.intact,
        "X": X,
        "x_intact": x_intact,
        "gravity": planned.gravity(case.coupling.healing_position),
        "tissue": planned.tissue,
        "scar": planned.scar,
        "cavity": planned.cavity,
        "contraction": case.healing.contraction_kPa,
        "automaton": automaton,
        "sites": sites,
        "deposition": Deposition(case.healing.deposition == "loaded", case.healing.deposition_prestretch),
        "days_per_cycle": case.coupling.days_per_cycle,
        "days_per_step": case.days_per_step,
        "equilibrium": equilibrium,
    }
    if case.healing.model == "automaton":
        return HealingCycle(**common)
    last_visit = max(visit_cycles(case).values(), default=0)
    return FieldsCycle(**common, **fields_of(case, planned, network), last_visit=last_visit, tell=equilibrium.tell)


def last_cycle(case: LumpectomyCase) -> int:
    """Number of the last cycle that the case allows."""
    return int(np.ceil(days_from_weeks(case.run.max_weeks) / case.coupling.days_per_cycle - 1e-9))


def visit_cycles(case: LumpectomyCase) -> dict[float, int]:
    """Cycle nearest to each visit: weeks -> cycle number."""
    return {w: round(days_from_weeks(w) / case.coupling.days_per_cycle) for w in case.outcome.visits_weeks}
