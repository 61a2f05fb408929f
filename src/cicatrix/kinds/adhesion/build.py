"""Build the adhesion law of a case of kind "adhesion", and check it at the stretches of the case."""

from __future__ import annotations

import numpy as np

from ...biology.adhesion import Adhesion, steady_state
from ...biology.clutch import ClutchSubstrate, MotorClutch, elastic_substrate
from ...biology.viscoelastic_substrate import StandardLinearSolid
from ...cases.adhesion_laws import adhesion_of, bond_of
from ...cases.laws import law_of
from .case import AdhesionCase

MAX_CHANCE = 0.1  # probability that a bond switches in one fixed step, above which a note is written


def law_and_notes(case: AdhesionCase) -> tuple[Adhesion, list[str]]:
    """Build the adhesion law of a case; errors as :func:`..cases.adhesion_laws.adhesion_of` raises them."""
    material = law_of(case) if case.law else None
    law, notes = adhesion_of(case.bond, case.substrate, case.cell, material, until_s=case.method.duration_s)
    return law, notes + _of_steps(law, case)


def clutch_of(case: AdhesionCase) -> MotorClutch | None:
    """Build the motors and clutches of a case; None if it has none."""
    given = case.cell.clutch
    if given is None:
        return None
    reach = case.bond.kT_pN_um / given.bond_force_pN
    return MotorClutch(
        bond_of(case.bond), given.stiffness_pN_um, reach, given.motors, given.motor_force_pN, given.velocity_um_per_s
    )


def clutch_substrate(law: Adhesion, stretch: np.ndarray) -> ClutchSubstrate:
    """Return the substrate under the clutches of a cell at stretches (g,): a spring (tangent stiffness) or viscoelastic."""
    substrate, each = law.substrate, np.ones_like(stretch)
    if isinstance(substrate, StandardLinearSolid):
        return ClutchSubstrate(substrate.K_long * each, substrate.K_added * each, substrate.viscosity * each)
    return elastic_substrate(np.asarray(steady_state(law, stretch).stiffness))


def _of_steps(law: Adhesion, case: AdhesionCase) -> list[str]:
    """Return a note if a bond is too likely to switch in one fixed time step; clutches are judged by their rates without load."""
    dt, rates = case.method.dt_s, [float(law.bond.k_on)]
    if dt is None:
        return []
    for time in (0.0, case.method.duration_s):
        rates.append(float(np.max(steady_state(law, np.array(case.substrate.stretch), time).k_off)))
    chance = -np.expm1(-dt * np.nanmax(rates))
    words = (
        f"A bond switches with probability {chance:.2g} in one step of {dt:g} s: a shorter method.dt_s is more exact."
    )
    return [words] if chance > MAX_CHANCE else []
