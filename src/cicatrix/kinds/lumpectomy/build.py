"""Build the healing cycle of a lumpectomy from a case and a segmented image; this module connects all packages below it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from ...core.errors import InputError
from ...core.units import mm_from_um
from ...coupling.cavity import Cavity
from ...coupling.cycle import HealingCycle
from ...coupling.healing import Healing
from ...coupling.ruler import Ruler
from ...geometry.hexgrid import Lattice
from ...geometry.transfer import OUTSIDE, locate_lattice, locate_sites
from ...mechanics.equilibrium import Equilibrium
from .automaton import automaton_healing
from .body import Anatomy, BreastModel
from .case import LumpectomyCase
from .continuum import continuum_healing
from .section import section_from_arrays, section_model
from .sites import box_around, too_many
from .solid import solid_from_arrays, solid_model

CLOT_KPA = 0.01  # shear modulus of clot and wound fluid, assumed: a tenth of fat's, enough to keep walls apart


class HealingFactory(Protocol):
    """Function that builds the wound-healing model named in a case, on the mesh of a breast."""

    def __call__(
        self,
        case: LumpectomyCase,
        model: BreastModel,
        cavity: Cavity,
        ruler: Ruler,
        report: Callable[[str], None] | None,
    ) -> Healing[Any]:
        """Return the healing model of a cavity; ``report``, if given, is called with the simulated day."""
        ...


# the models that `healing.model` may name; their keys are in case.MODEL_KEYS
MODELS: dict[str, HealingFactory] = {
    "automaton": automaton_healing,
    "fields": continuum_healing,
}


def breast_model(case: LumpectomyCase, anatomy: Anatomy) -> BreastModel:
    """Build the breast before surgery: mesh it so that sides of elements form the border of the cavity, and assign tissue.

    Raises
    ------
    InputError
        If there is no breast or no chest wall, the resection does not lie inside the breast, the lattice would be too large, or
        the nipple does not lie on the skin.
    """
    model = section_model(case, anatomy) if case.dimension == 2 else solid_model(case, anatomy)
    _lattice(case, model, model.x_imaged)  # refuses a lattice that is too large now, before hours of computation
    _ = model.nipple  # raises an error now if no skin is near the nipple
    return model


def breast_model_from_arrays(case: LumpectomyCase, arrays: Mapping[str, np.ndarray]) -> BreastModel:
    """Rebuild the breast model of an interrupted run from its stored arrays, bitwise identical, without reading the image."""
    return section_from_arrays(case, arrays) if case.dimension == 2 else solid_from_arrays(case, arrays)


def imaged_in(case: LumpectomyCase, model: BreastModel, position: str) -> np.ndarray | None:
    """Return the initial guess of the shape in a patient position: the imaged shape if imaged in that position, else None."""
    return model.x_imaged if position == case.image.position else None


def equilibrium_of(case: LumpectomyCase, report: Callable[[str], None] | None = None) -> Equilibrium:
    """Build the equilibrium solver with the tolerance of a case; ``report`` is called with a message about each iteration."""
    return Equilibrium(case.solver.relative_tolerance, report)


def ruler_on(case: LumpectomyCase, model: BreastModel, X: np.ndarray) -> Ruler:
    """Place the automaton's lattice over the cavity and the active layer around it, at unloaded positions X (n_nodes, 3) [mm].

    Raises
    ------
    InputError
        If the lattice would have more sites than fit into memory.
    """
    space = model.intact.discretization.space
    lattice, box = _lattice(case, model, X)
    nodes, is_solid = X[space.geometric_nodes], space.n_axes == 3
    sites = locate_lattice(nodes, lattice, box) if is_solid else locate_sites(nodes[..., :2], _places(lattice))
    fillable = (sites.element != OUTSIDE).reshape(lattice.shape)
    is_open = np.append(model.cavity, False)[sites.element].reshape(lattice.shape)
    return Ruler(lattice, sites, fillable, is_open)


def _lattice(case: LumpectomyCase, model: BreastModel, X: np.ndarray) -> tuple[Lattice, np.ndarray]:
    """Return the lattice over the cavity and its active layer, and the box's lower and upper corner (2, n_axes) [mm]."""
    space, pitch_um = model.intact.discretization.space, case.healing.pitch_um
    around = X[space.geometric_nodes[model.cavity]].reshape(-1, 3)[:, : space.n_axes]
    box = box_around(around, case.rules(), pitch_um)
    if reason := too_many(box, pitch_um):
        raise InputError(f"healing.pitch_um {reason}.")
    return Lattice.covering(box[0], box[1], mm_from_um(pitch_um)), box


def _places(lattice: Lattice) -> np.ndarray:
    return lattice.positions().reshape(-1, lattice.ndim)


def healing_cycle(
    case: LumpectomyCase,
    model: BreastModel,
    X: np.ndarray,
    x_intact: np.ndarray,
    equilibrium: Equilibrium,
    has_clot: bool = False,
) -> HealingCycle[Any]:
    """Build the cycle that alternates between mechanical equilibrium and the wound-healing model named in the case.

    X, x_intact (n_nodes, 3) [mm]: unloaded shape, and loaded shape in the healing position, of the intact body. With
    ``has_clot`` the fresh cavity is filled with clot, instead of being empty.

    Raises
    ------
    InputError
        If the lattice does not fit into memory, or the model's keys do not fit together.
    """
    ruler = ruler_on(case, model, X)
    contents = CLOT_KPA / float(model.scar.mu) if has_clot else 0.0
    cavity = Cavity(model.intact, X, model.cavity, model.tissue, model.scar, case.healing.contraction_kPa, contents)
    healing = MODELS[case.healing.model](case, model, cavity, ruler, equilibrium.tell)
    gravity = model.gravity(case.coupling.healing_position)
    return HealingCycle(cavity, x_intact, gravity, ruler, healing, equilibrium, case.coupling.days_per_cycle)
