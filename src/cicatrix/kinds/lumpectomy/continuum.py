"""A lumpectomy that heals by fields: the breast's set of values on the patient's tissue."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...cases.continuum_laws import Network, local_of, mobility_of, scarring_of, thin_fronts
from ...cases.continuum_values import BREAST_CAVITY
from ...core.units import inner_per_typed
from ...coupling.continuum import FieldsCycle, Fresh
from ...coupling.cycle import HealingCycle
from ...healing.continuum import Tolerance
from ...materials.neo_hookean import moduli_from_young
from .body import Plan
from .case import LumpectomyCase

KPA_PER_MPA = inner_per_typed("MPa", "kPa")
PRESSURES = ("kf_MPa", "t_rho_MPa", "t_rho_c_MPa")


class HealedCase(NamedTuple):
    """What a lumpectomy's case says of healing by fields (:class:`.fields.Healed`)."""

    values: dict[str, float]
    mechanosensing: Any
    is_sheet: bool = False


def healed(case: LumpectomyCase) -> HealedCase:
    """Values of docs/theory/wound.md for this breast.

    Those of the breast's cavity, but: what collagen bears and cells pull is as much softer as this fat is than the tissue which
    that set was found with; the matrix is the scar of the case; the pull of healthy tissue does not count, as part of the shape
    before surgery. Then what ``healing.parameters`` says.
    """
    mu_fat, _ = moduli_from_young(case.tissue.fat.E_kPa, case.tissue.fat.nu)
    mu, kappa = moduli_from_young(case.tissue.scar.E_kPa, case.tissue.scar.nu)
    softer = mu_fat / (2.0 * BREAST_CAVITY["k0_MPa"] * KPA_PER_MPA)
    scaled = {name: softer * BREAST_CAVITY[name] for name in PRESSURES}
    own = {"k0_MPa": 0.5 * mu / KPA_PER_MPA, "kv_MPa": (kappa - mu / 3.0) / KPA_PER_MPA}
    values = BREAST_CAVITY | scaled | own | case.healing.parameters.model_dump(exclude_none=True)
    healthy = {"T_0_MPa": values["t_rho_MPa"] / (values["K_t"] ** 2 + 1.0)}
    return HealedCase(healthy | values, case.healing.mechanosensing)


def fields_of(case: LumpectomyCase, planned: Plan, network: Network | None) -> dict[str, Any]:
    """What :class:`..coupling.by_fields.FieldsCycle` needs besides a body and a lattice.

    Raises
    ------
    InputError
        If the adhesion does not hold at rest, or the network has no such input or output.
    """
    says = healed(case)
    v = says.values
    scarring, sensed = scarring_of(says, network)
    phi = np.where(planned.cavity[:, None], v["phi_wound"], np.ones_like(planned.tissue.mu))
    tolerance = case.healing.time_tolerance
    return {
        "scarring": scarring,
        "mobility": mobility_of(says),
        "fresh": Fresh(v["rho_wound"], v["c_wound"], local_of(phi, v["kappa"], sensed, scarring.n_axes)),
        "tolerance": Tolerance(tolerance, min(0.1 * tolerance, 1e-5)),
        "is_coupled": case.coupling.mode == "two-way",
    }


def thin_fronts_of(case: LumpectomyCase, cycle: HealingCycle) -> tuple[str, ...]:
    """Warn where a front of cells would be thinner than elements can show."""
    return thin_fronts(healed(case), cycle.transport, cycle.beds) if isinstance(cycle, FieldsCycle) else ()
