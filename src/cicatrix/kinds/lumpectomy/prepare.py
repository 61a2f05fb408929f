"""The steps from a segmented image to a cycle that is ready to heal, for scripts that need no folder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...coupling.cycle import HealingCycle
from ...healing.automaton import Automaton
from .body import Anatomy, Plan
from .build import equilibrium_of, healing_cycle, imaged_in, plan
from .case import LumpectomyCase


def prepare(case: LumpectomyCase, anatomy: Anatomy) -> tuple[Plan, HealingCycle]:
    """Mesh, unload and load again in the healing position.

    Raises
    ------
    InputError
        If the section or the resection is at fault.
    ConvergenceError
        If no equilibrium is found.
    """
    planned, equilibrium = plan(case, anatomy), equilibrium_of(case)
    X, _ = equilibrium.unloaded(planned.intact, planned.x_imaged, planned.gravity(case.image.position))
    home = case.coupling.healing_position
    x, _ = equilibrium.loaded(planned.intact, X, planned.gravity(home), imaged_in(case, planned, home))
    return planned, healing_cycle(case, planned, X, x, equilibrium)


def reseeded(cycle: HealingCycle, seed: int, feedback: float | None = None) -> HealingCycle:
    """The same body and wound with another seed, and another feedback if given (0 is one-way)."""
    old = cycle.automaton
    rules = old.rules if feedback is None else replace(old.rules, feedback=feedback)
    return replace(cycle, automaton=Automaton(old.lattice, old.fillable, old.open0, rules, seed))


def loaded_in(planned: Plan, cycle: HealingCycle, gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Loaded shapes before surgery and with the fresh cavity, under any gravity (3,) [mm/s^2] of the section's axes."""
    before, _ = cycle.equilibrium.loaded(planned.intact, cycle.X, gravity)
    fresh = cycle.body(cycle.unhealed(before))
    after, _ = cycle.equilibrium.loaded(fresh, cycle.X, gravity, before)
    return before, cycle.extension.fill(after, fresh.fraction)
