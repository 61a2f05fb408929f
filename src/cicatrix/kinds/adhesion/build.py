"""From a case of kind "adhesion" to its law, checked at the stretches asked for."""

from __future__ import annotations

import numpy as np

from ...biology.adhesion import Adhesion, anchored
from ...biology.clutch import Ground, MotorClutch, ground_of
from ...biology.viscoelastic_substrate import StandardLinearSolid
from ...cases.adhesion_laws import adhesion_of, bond_of
from ...cases.laws import law_of
from .case import AdhesionCase

MOST_CHANCE = 0.1  # of a bond to switch in a fixed step, above which it is noted


def law_and_notes(case: AdhesionCase) -> tuple[Adhesion, list[str]]:
    """Build the adhesion law of a case; errors as :func:`..cases.adhesion_laws.adhesion_of` raises them."""
    material = law_of(case) if case.law else None
    law, notes = adhesion_of(case.bond, case.substrate, case.cell, material, until_s=case.method.duration_s)
    return law, notes + _of_steps(law, case)


def clutch_of(case: AdhesionCase) -> MotorClutch | None:
    """Make the motors and clutches that a case names."""
    given = case.cell.clutch
    if given is None:
        return None
    reach = case.bond.kT_pN_um / given.bond_force_pN
    return MotorClutch(
        bond_of(case.bond), given.stiffness_pN_um, reach, given.motors, given.motor_force_pN, given.velocity_um_per_s
    )


def ground_under(law: Adhesion, stretch: np.ndarray) -> Ground:
    """What clutches pull at together at stretches (g,): the substrate's tangent stiffness, or its springs and dashpot."""
    substrate, each = law.substrate, np.ones_like(stretch)
    if isinstance(substrate, StandardLinearSolid):
        return Ground(substrate.K_long * each, substrate.K_added * each, substrate.viscosity * each)
    return ground_of(np.asarray(anchored(law, stretch).stiffness))


def _of_steps(law: Adhesion, case: AdhesionCase) -> list[str]:
    """Say so if fixed steps are long; of clutches, before they bear anything."""
    dt, rates = case.method.dt_s, [float(law.bond.k_on)]
    if dt is None:
        return []
    for time in (0.0, case.method.duration_s):
        rates.append(float(np.max(anchored(law, np.array(case.substrate.stretch), time).k_off)))
    chance = -np.expm1(-dt * np.nanmax(rates))
    words = (
        f"A bond switches with a chance of {chance:.2g} in one step of {dt:g} s: a shorter method.dt_s is more exact."
    )
    return [words] if chance > MOST_CHANCE else []
