"""The adhesion law that the tables of a case name, checked at the stretches asked for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
from jax import Array

from ..biology.adhesion import Adhesion, anchored
from ..biology.bond import Bell, Bond, CatchBond
from ..biology.contraction import ConstantForce, Contraction, Feedback
from ..biology.substrate import Column, ExponentialFibre, LinearSubstrate, Pull, Substrate
from ..biology.viscoelastic_substrate import StandardLinearSolid
from ..core.errors import ConvergenceError, InputError
from ..core.units import inner_per_typed
from ..materials.material import EnergyMaterial
from ..mechanics.uniaxial import Tension
from .adhesion import LAW_SUBSTRATES, BondTable, CellTable
from .laws import law_of

ROOM = 1.5  # of a table of stresses beyond what a straight curve would ask for


MOST_TABLES = 12


TABLE_ERROR = 1e-3  # above it the curve has corners that no table follows


def adhesion_of(
    bond: BondTable,
    substrate: Any,
    cell: CellTable,
    law: EnergyMaterial | None = None,
    *,
    until_s: float = 0.0,
    stretches: str = "substrate.stretch",
) -> tuple[Adhesion, list[str]]:
    """Build an adhesion law from its tables, and return it with notes for the user.

    Parameters
    ----------
    bond, cell : BondTable, CellTable
        Rates of the bond; force and number of the cell's bonds.
    substrate : one of the tables of ``AnySubstrate``
        What a bond pulls at; the law is checked at its stretches.
    law : EnergyMaterial, optional
        Material of the substrate where its type is "law".
    until_s : float [s]
        Time until which a viscoelastic substrate is checked.
    stretches : str
        Key of the case file that gave the stretches, for error messages.

    Raises
    ------
    InputError
        If feedback or substrate do not hold at a stretch asked for.
    ConvergenceError
        If a law of a material point has no state where the cell pulls it to.
    """
    contraction, notes = contraction_of(cell), list[str]()
    if substrate.type in LAW_SUBSTRATES:
        pulled, error = _tissue(substrate, law or _material(substrate), contraction, stretches)
        notes = [
            f"The substrate's law was tabulated in uniaxial tension; error of the table {error:.1g} of its largest stress."
        ]
    else:
        pulled = _simple(substrate)
    adhesion = Adhesion(bond_of(bond), pulled, contraction, cell.integrins_per_um2, bond.energy)
    _check_stiffnesses(adhesion, substrate.stretch, stretches)
    if cell.clutch is None:
        for time in (0.0, until_s) if is_viscoelastic(substrate) else (0.0,):
            _check_finite(adhesion, substrate.stretch, time)
    return adhesion, notes


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


def is_viscoelastic(substrate: Any) -> bool:
    """Return whether the force at a substrate that is held relaxes in time."""
    return substrate.type in ("maxwell", "standard-linear-solid")


def _simple(table: Any) -> Substrate:
    if table.type == "linear":
        return LinearSubstrate(table.stiffness_pN_um)
    if table.type == "maxwell":
        return StandardLinearSolid(0.0, table.stiffness_pN_um, table.viscosity_pN_s_um)
    if table.type == "standard-linear-solid":
        return StandardLinearSolid(table.long_pN_um, table.added_pN_um, table.viscosity_pN_s_um)
    k1 = table.k1_MPa * inner_per_typed("MPa", "pN/um^2")
    return Column(ExponentialFibre(k1, table.k2), table.area_um2, table.length_um)


def _material(table: Any) -> EnergyMaterial:
    """Build the material that a substrate's own table names."""
    return law_of(SimpleNamespace(law=(table,), growth=None))


def _tissue(table: Any, law: EnergyMaterial, contraction: Contraction, stretches: str) -> tuple[Column, float]:
    """Tabulate a column of a material in uniaxial tension, as far as the cell pulls it."""
    tension = Tension(law)
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


def _check_stiffnesses(law: Adhesion, stretch: tuple[float, ...], stretches: str) -> None:
    """Refuse a substrate without positive stiffness, and a feedback that does not hold there."""
    substrate = law.substrate
    if isinstance(substrate, Column):
        k = np.asarray(_pulled(substrate, law.contraction, np.array(stretch)).stiffness)
        _check_stiffness(k, stretch, stretches)
        law.contraction.check(k)
    elif isinstance(substrate, LinearSubstrate):
        law.contraction.check(np.asarray(substrate.k))
    elif isinstance(substrate, StandardLinearSolid):
        law.contraction.check(np.asarray(substrate.K_long + substrate.K_added))


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
