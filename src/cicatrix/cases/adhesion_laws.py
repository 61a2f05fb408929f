"""Build the adhesion law from the tables of a case, and check it at the stretches of the case."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
from jax import Array

from ..biology.adhesion import Adhesion, steady_state
from ..biology.bond import Bell, Bond, CatchBond
from ..biology.contraction import CellContraction, ConstantForce, Feedback
from ..biology.substrate import Column, ExponentialFibre, LinearSubstrate, Pull, Substrate
from ..biology.viscoelastic_substrate import StandardLinearSolid
from ..core.errors import ConvergenceError, InputError
from ..core.units import unit_factor
from ..materials.material import EnergyMaterial
from ..mechanics.uniaxial import Tension
from .adhesion import LAW_SUBSTRATES, BondTable, CellTable
from .laws import law_of

ROOM = 1.5  # factor on the extension of a stress table predicted by linear extrapolation


MAX_TABLES = 12  # largest number of stress tables that are tried


TABLE_ERROR = 1e-3  # largest relative error of a table; a larger one means that the curve has corners


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
        Substrate that a bond pulls at, with the stretches at which the law is checked.
    law : EnergyMaterial, optional
        Material of the substrate where its type is "law".
    until_s : float [s]
        Time until which a viscoelastic substrate is checked.
    stretches : str
        Key of the case file that gave the stretches, for error messages.

    Raises
    ------
    InputError
        If the feedback or the substrate is not defined at one of the stretches.
    ConvergenceError
        If the substrate's law has no equilibrium at a stretch that the cell's force produces.
    """
    contraction, notes = contraction_of(cell), list[str]()
    if substrate.type in LAW_SUBSTRATES:
        pulled, error = _tissue(substrate, law or _material(substrate), contraction, stretches)
        notes = [
            f"The substrate's law was tabulated in uniaxial tension; the table's error is {error:.1g} of the largest stress."
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
    """Build a bond (slip or catch) from its table of rates."""
    catch = table.catch
    if catch is not None:
        return CatchBond(table.k_on_per_s, catch.k_catch_per_s, catch.k_slip_per_s, catch.f_catch_pN, catch.f_slip_pN)
    return Bell(table.k_on_per_s, table.k_off_per_s, table.kT_pN_um)


def contraction_of(table: CellTable) -> CellContraction:
    """Build the law of the cell's force: constant, or dependent on the stiffness of the substrate."""
    if table.feedback is None:
        return ConstantForce(table.force_pN or 0.0)  # 0 for clutches, which have a force of their own
    given = table.feedback
    return Feedback(given.f0_pN, given.beta, given.k_a_pN_um, given.k_N_pN_um)


def is_viscoelastic(substrate: Any) -> bool:
    """Return whether the substrate is viscoelastic: its force relaxes at constant displacement."""
    return substrate.type in ("maxwell", "standard-linear-solid")


def _simple(table: Any) -> Substrate:
    if table.type == "linear":
        return LinearSubstrate(table.stiffness_pN_um)
    if table.type == "maxwell":
        return StandardLinearSolid(0.0, table.stiffness_pN_um, table.viscosity_pN_s_um)
    if table.type == "standard-linear-solid":
        return StandardLinearSolid(table.long_pN_um, table.added_pN_um, table.viscosity_pN_s_um)
    k1 = table.k1_MPa * unit_factor("MPa", "pN/um^2")
    return Column(ExponentialFibre(k1, table.k2), table.area_um2, table.length_um)


def _material(table: Any) -> EnergyMaterial:
    """Build the material of a substrate from the parameters in the table [substrate]."""
    return law_of(SimpleNamespace(law=(table,), growth=None))


def _tissue(table: Any, law: EnergyMaterial, contraction: CellContraction, stretches: str) -> tuple[Column, float]:
    """Tabulate the uniaxial tension of a column of material, up to the stretch that the cell's force produces."""
    tension = Tension(law)
    stretch = np.array(table.stretch)
    low, high = min(1.0, stretch.min()), max(1.0 + 1e-3, stretch.max())
    for _ in range(MAX_TABLES):
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
                    f"The substrate's law cannot be tabulated: cubic interpolation errs by {error:.1g} of the largest stress."
                )
            return column, error
        high += ROOM * (needed - high) if needed > high else high - low
    raise InputError(
        f"substrate: its stress does not balance the pull of the cell up to a stretch of {high:.4g}; give less force"
    )


@jax.jit
def _pulled(column: Column, contraction: CellContraction, stretch: Array) -> Pull:
    return column.pulled(contraction, stretch, 0.0)


def _check_stiffnesses(law: Adhesion, stretch: tuple[float, ...], stretches: str) -> None:
    """Raise an error for a substrate without positive stiffness, or a feedback that is not valid at its stiffness."""
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
    at, when = steady_state(law, np.array(stretch), time), f" after {time:g} s" if time else ""
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
