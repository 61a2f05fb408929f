"""Continuum healing model of a lumpectomy.

It is built with the parameter values of a reference breast cavity, adapted to the stiffness of this patient's fat and scar.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...cases.continuum_laws import front_resolution_warning, local_of, mobility_of, network_of, scarring_of
from ...cases.continuum_values import BREAST_CAVITY
from ...core.units import unit_factor
from ...coupling.cavity import Cavity
from ...coupling.continuum_healing import ContinuumHealing, FreshWound, inner_vertices
from ...coupling.deposition import Deposition
from ...coupling.ruler import Ruler
from ...healing.continuum import Tolerance
from ...healing.transport import Transport
from ...materials.neo_hookean import moduli_from_young
from .body import BreastModel
from .case import LumpectomyCase
from .visits import visit_cycles

KPA_PER_MPA = unit_factor("MPa", "kPa")
PRESSURES = ("kf_MPa", "t_rho_MPa", "t_rho_c_MPa")


class LumpectomyContinuum(NamedTuple):
    """Settings of the continuum model from a case of kind "lumpectomy" (:class:`...cases.continuum_laws.ContinuumSettings`)."""

    values: dict[str, float]
    mechanosensing: Any
    is_sheet: bool = False


def continuum_values(case: LumpectomyCase) -> LumpectomyContinuum:
    """Choose the values of the continuum model (docs/theory/wound.md) for this breast.

    The values are those of the reference cavity in a breast, with three changes. Fibre stiffness and cell traction are
    multiplied by the stiffness of this fat over that of the tissue for which the reference values were fitted. The matrix has
    the stiffness of the case's scar. The traction of healthy tissue is subtracted, as the shape before surgery is in
    equilibrium with it. Values that ``healing.parameters`` gives replace all of these.
    """
    mu_fat, _ = moduli_from_young(case.tissue.fat.E_kPa, case.tissue.fat.nu)
    mu, kappa = moduli_from_young(case.tissue.scar.E_kPa, case.tissue.scar.nu)
    softer = mu_fat / (2.0 * BREAST_CAVITY["k0_MPa"] * KPA_PER_MPA)
    scaled = {name: softer * BREAST_CAVITY[name] for name in PRESSURES}
    own = {"k0_MPa": 0.5 * mu / KPA_PER_MPA, "kv_MPa": (kappa - mu / 3.0) / KPA_PER_MPA}
    values = BREAST_CAVITY | scaled | own | case.healing.parameters.model_dump(exclude_none=True)
    healthy = {"T_0_MPa": values["t_rho_MPa"] / (values["K_t"] ** 2 + 1.0)}
    return LumpectomyContinuum(healthy | values, case.healing.mechanosensing)


def continuum_healing(
    case: LumpectomyCase,
    model: BreastModel,
    cavity: Cavity,
    ruler: Ruler,
    report: Callable[[str], None] | None = None,
) -> ContinuumHealing:
    """Build the continuum model on the body; ``report`` is called with the day reached.

    Raises
    ------
    InputError
        If the adhesion is not defined on an unstretched substrate, or a network cannot be read or lacks the named input or
        output.
    """
    settings = continuum_values(case)
    v = settings.values
    scarring, signal_state = scarring_of(settings, network_of(case.healing.mechanosensing))
    phi = np.where(cavity.elements[:, None], v["phi_wound"], np.ones_like(cavity.tissue.mu))
    transport, tolerance = Transport(cavity.intact.discretization.space, cavity.X), case.healing.time_tolerance
    return ContinuumHealing(
        cavity,
        ruler,
        model.gravity(case.coupling.healing_position),
        Deposition(case.healing.deposition == "loaded", case.healing.deposition_prestretch),
        scarring,
        mobility_of(settings),
        transport,
        FreshWound(v["rho_wound"], v["c_wound"], local_of(phi, v["kappa"], signal_state, scarring.n_axes)),
        Tolerance(tolerance, min(0.1 * tolerance, 1e-5)),
        is_coupled=case.coupling.mode == "two-way",
        last_visit=max(visit_cycles(case).values(), default=0),
        notes=front_resolution_warning(settings, transport, inner_vertices(transport, cavity.elements)),
        report=report,
    )
