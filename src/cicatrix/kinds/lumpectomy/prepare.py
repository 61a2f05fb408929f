"""Steps from a segmented image to a cycle that is ready to heal, for scripts that need no run folder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...coupling.automaton_healing import AutomatonHealing, AutomatonTissue
from ...coupling.cycle import HealingCycle
from ...healing.automaton import Automaton
from .body import Anatomy, BreastModel
from .build import breast_model, equilibrium_of, healing_cycle, imaged_in
from .case import LumpectomyCase


def prepare(case: LumpectomyCase, anatomy: Anatomy) -> tuple[BreastModel, HealingCycle]:
    """Mesh the body, compute its unloaded shape, and load it in the healing position.

    Raises
    ------
    InputError
        If the section or the resection is not valid.
    ConvergenceError
        If no equilibrium is found.
    """
    model, equilibrium = breast_model(case, anatomy), equilibrium_of(case)
    X, _ = equilibrium.unloaded(model.intact, model.x_imaged, model.gravity(case.image.position))
    home = case.coupling.healing_position
    x, _ = equilibrium.loaded(model.intact, X, model.gravity(home), imaged_in(case, model, home))
    return model, healing_cycle(case, model, X, x, equilibrium)


def reseeded(
    cycle: HealingCycle[AutomatonTissue], seed: int, feedback: float | None = None
) -> HealingCycle[AutomatonTissue]:
    """Return the same body and wound with another seed of the automaton, and another feedback if given (0 is one-way)."""
    healing = cycle.healing
    assert isinstance(healing, AutomatonHealing)
    old = healing.automaton
    rules = old.rules if feedback is None else replace(old.rules, feedback=feedback)
    automaton = Automaton(old.lattice, old.fillable, old.open0, rules, seed)
    return replace(cycle, healing=replace(healing, automaton=automaton))


def loaded_in(model: BreastModel, cycle: HealingCycle, gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the loaded shapes before surgery and with the fresh cavity, under gravity (3,) [mm/s^2] in the body's axes."""
    before, _ = cycle.equilibrium.loaded(model.intact, cycle.X, gravity)
    after, _ = cycle.equilibrium.loaded(cycle.opened, cycle.X, gravity, before)
    return before, cycle.extension.fill(after, cycle.opened.fraction)
