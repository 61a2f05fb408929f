"""From a case of kind "adhesion" to its law, checked at the stretches asked for."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import numpy as np
from jax import Array

from ..biology.adhesion import Adhesion, anchored
from ..biology.bond import Bell, Bond, CatchBond
from ..biology.clutch import Ground, MotorClutch, ground_of
from ..biology.contraction import ConstantForce, Contraction, Feedback
from ..biology.substrate import Column, ExponentialFibre, LinearSubstrate, Pull, Substrate
from ..biology.viscoelastic_substrate import StandardLinearSolid
from ..core.errors import ConvergenceError, InputError
from ..core.units import inner_per_typed
from ..materials.material import EnergyMaterial
from .adhesion_case import LAW_SUBSTRATES, AdhesionCase, BondTable, CellTable
from .laws import law_of
from .uniaxial import Tension

ROOM = 1.5  # of a table of stresses beyond what a straight curve would ask for
MOST_TABLES = 12
MOST_CHANCE = 0.1  # of a bond to switch in a fixed step, above which it is noted
TABLE_ERROR = 1e-3  # above it the curve has corners that no table follows


def adhesion_of(case: AdhesionCase, stretches: str = "substrate.stretch") -> tuple[Adhesion, list[str]]:
    """Make the adhesion of a case, and sentences about how; ``stretches`` is the key that they were given by.

    Raises
    ------
    InputError
        If feedback or substrate do not hold at a stretch asked for.
    ConvergenceError
        If a law of a material point has no state where the cell pulls it to.
    """
    contraction, notes = contraction_of(case.cell), list[str]()
    if case.substrate.type in LAW_SUBSTRATES:
        substrate, error = _tissue(case, contraction, stretches)
        notes = [
            f"The substrate's law was tabulated in uniaxial tension; error of the table {error:.1g} of its largest stress."
        ]
    else:
        substrate = _simple(case)
    law = Adhesion(bond_of(case.bond), substrate, contraction, case.cell.integrins_per_um2, case.bond.energy)
    _check(law, case, stretches)
    return law, notes + _of_steps(law, case)


def bond_of(table: BondTable) -> Bond:
    """Make the bond that a table names."""
    catch = table.catch
    if catch is not None:
        return CatchBond(table.k_on_per_s, catch.k_catch_per_s, catch.k_slip_per_s, catch.f_catch_pN, catch.f_slip_pN)
    return Bell(table.k_on_per_s, table.k_off_per_s, table.kT_pN_um)


def contraction_of(table: CellTable) -> Contraction:
    """Make the contraction that a table names."""
    if table.feedback is None:
        return ConstantForce(table.force_pN or 0.0)  # clutches bring their own
    given = table.feedback
    return Feedback(given.f0_pN, given.beta, given.k_a_pN_um, given.k_N_pN_um)


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


def yields(case: AdhesionCase) -> bool:
    """Whether the substrate gives way in time."""
    return case.substrate.type in ("maxwell", "standard-linear-solid")


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


def _simple(case: AdhesionCase) -> Substrate:
    table = case.substrate
    if table.type == "linear":
        return LinearSubstrate(table.stiffness_pN_um)
    if table.type == "maxwell":
        return StandardLinearSolid(0.0, table.stiffness_pN_um, table.viscosity_pN_s_um)
    if table.type == "standard-linear-solid":
        return StandardLinearSolid(table.long_pN_um, table.added_pN_um, table.viscosity_pN_s_um)
    k1 = table.k1_MPa * inner_per_typed("MPa", "pN/um^2")
    return Column(ExponentialFibre(k1, table.k2), table.area_um2, table.length_um)


def _material(case: AdhesionCase) -> EnergyMaterial:
    if case.substrate.type == "law":
        return law_of(case)
    return law_of(SimpleNamespace(law=(case.substrate,), growth=None))


def _tissue(case: AdhesionCase, contraction: Contraction, stretches: str) -> tuple[Column, float]:
    """A column of a law, tabulated as far as the cell pulls it."""
    tension, table = Tension(_material(case)), case.substrate
    stretch = np.array(table.stretch)
    low, high = min(1.0, stretch.min()), max(1.0 + 1e-3, stretch.max())
    for _ in range(MOST_TABLES):
        curve, error = tension.table(low, high)
        column = Column(curve, table.area_um2, table.length_um)
        pull = _pulled(column, contraction, stretch)
        k = np.asarray(pull.stiffness)
        _check_stiffness(k, table.stretch, stretches)
        contraction.check(k)
        needed = float(np.max(stretch + np.asarray(pull.force) / (k * table.length_um)))
        pulled = stretch + np.asarray(pull.displacement) / table.length_um
        if np.all(pulled <= high):
            if error > TABLE_ERROR:
                raise ConvergenceError(
                    f"The substrate's law cannot be tabulated: cubic pieces miss its stress by {error:.1g} of the largest one."
                )
            return column, error
        high += ROOM * (needed - high) if needed > high else high - low
    raise InputError(
        f"substrate: its stress does not rise by what the cell pulls with, up to a stretch of {high:.4g}; give less force"
    )


@jax.jit
def _pulled(column: Column, contraction: Contraction, stretch: Array) -> Pull:
    return column.pulled(contraction, stretch, 0.0)


def _check(law: Adhesion, case: AdhesionCase, stretches: str) -> None:
    """Refuse what does not hold, before any time is spent."""
    substrate, stretch = law.substrate, case.substrate.stretch
    if isinstance(substrate, Column):
        k = np.asarray(_pulled(substrate, law.contraction, np.array(stretch)).stiffness)
        _check_stiffness(k, stretch, stretches)
        law.contraction.check(k)
    elif isinstance(substrate, LinearSubstrate):
        law.contraction.check(np.asarray(substrate.k))
    elif isinstance(substrate, StandardLinearSolid):
        law.contraction.check(np.asarray(substrate.K_long + substrate.K_added))
    if case.cell.clutch is None:
        for time in (0.0, case.method.duration_s) if yields(case) else (0.0,):
            _check_finite(law, stretch, time)


def _check_finite(law: Adhesion, stretch: tuple[float, ...], time: float) -> None:
    at, when = anchored(law, np.array(stretch), time), f" after {time:g} s" if time else ""
    for name, values in at._asdict().items():
        if not np.all(np.isfinite(values)):
            worst = stretch[int(np.argmin(np.isfinite(values)))]
            raise InputError(
                f"the adhesion has no finite {name} at a stretch of {worst:g}{when}: a force of {float(np.max(at.force)):.4g} "
                "pN is too much for this substrate"
            )


def _check_stiffness(k: np.ndarray, stretch: tuple[float, ...], stretches: str) -> None:
    for one, value in zip(stretch, k):
        if not np.isfinite(value):
            raise InputError(f"{stretches} {one:g}: the stress of the substrate overflows there")
        if value <= 0.0:
            raise InputError(
                f"{stretches} {one:g}: the tangent stiffness there must be positive; got {value:.4g} pN/um"
            )
