"""Tables of the continuum healing model: parameters and mechanosensing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import model_validator

from .adhesion import BondTable, CellTable, FibreTable, LinearTable
from .bounds import NotNegative, Number, Positive, fault, limits
from .continuum_values import BREAST_CAVITY, CIRCULAR_WOUND
from .laws import one_of
from .signals import MoreoTable, NetworkSignalTable
from .table import Table

VALUES = {"circular-wound": CIRCULAR_WOUND, "breast-cavity": BREAST_CAVITY}


TimeTolerance = Annotated[Number, limits(least=1e-8, most=1e-1)]


Share = Annotated[Number, limits(above=0.0, most=1.0)]


class NoneTable(Table):
    """Cells feel nothing, H = 0."""

    type: Literal["none"]


class LogisticTable(Table):
    """Elastic stretch of area or volume: :class:`..biology.signals.LogisticSignal`, theta_ref and gamma among the parameters."""

    type: Literal["logistic"]


class AdhesionTable(Table):
    """The traction at adhesions that are solved at every point, which saturates: :class:`..biology.sensing.Sensing`."""

    type: Literal["adhesion"]
    bond: BondTable
    substrate: one_of({"linear": LinearTable, "exponential-fibre": FibreTable})  # pyright: ignore[reportInvalidTypeForm]
    cell: CellTable
    K_kPa: Positive = 1.0
    threshold_kPa: NotNegative = 0.0


class NetworkTable(AdhesionTable, NetworkSignalTable):
    """A signalling network that this traction drives."""

    type: Literal["network"]  # pyright: ignore[reportIncompatibleVariableOverride]


AnySensing = one_of(
    {
        "none": NoneTable,
        "logistic": LogisticTable,
        "moreo": MoreoTable,
        "adhesion": AdhesionTable,
        "network": NetworkTable,
    }
)


class ParametersTable(Table):
    """Values by their names in docs/theory/wound.md; what is left out is the benchmark's.

    Cells count in those of healthy tissue (``rho_phys_per_mm3``), cytokine in a largest amount (``c_max_g_per_mm3``), collagen in
    that of healthy tissue, so all rates are per hour.
    """

    rho_phys_per_mm3: Positive | None = None
    c_max_g_per_mm3: Positive | None = None
    D_rho_mm2_per_h: NotNegative | None = None
    D_rho_c_mm2_per_h: Number | None = None  # below 0: cells go to where there is more cytokine
    D_rho_phi_mm2_per_h: Number | None = None  # below 0: to where there is more collagen
    D_c_mm2_per_h: NotNegative | None = None
    p_rho_per_h: NotNegative | None = None
    p_rho_c_per_h: NotNegative | None = None
    p_rho_H_per_h: NotNegative | None = None
    K_rho_c: Positive | None = None
    K_rho_rho: Positive | None = None
    d_rho_per_h: NotNegative | None = None
    x_rho_per_h: NotNegative | None = None  # exchange with healthy tissue, of the homogeneous example alone
    p_c_rho_per_h: NotNegative | None = None
    p_c_H_per_h: NotNegative | None = None
    K_c_c: Positive | None = None
    d_c_per_h: NotNegative | None = None
    x_c_per_h: NotNegative | None = None
    p_phi_per_h: NotNegative | None = None
    p_phi_c_per_h: NotNegative | None = None
    p_phi_H_per_h: NotNegative | None = None
    K_phi_c: Positive | None = None
    K_phi_rho: Positive | None = None
    d_phi_per_h: NotNegative | None = None
    d_phi_rho_c_per_h: NotNegative | None = None
    theta_ref: Positive | None = None
    gamma: NotNegative | None = None
    H_least: Annotated[Number, limits(least=0.0, most=1.0)] | None = None  # smaller signals count as 0
    tau_P: Positive | None = None
    band_low: Annotated[Number, limits(least=0.0, most=1.0)] | None = None  # no permanent stretch between these
    band_high: Annotated[Number, limits(least=1.0)] | None = None
    growth_density: Positive | None = None  # given: growth by collagen, R Eq. (27), instead of permanent stretch
    tau_omega: Positive | None = None  # given, with tau_kappa: fibres turn and gather
    tau_kappa: Positive | None = None
    gamma_kappa: NotNegative | None = None
    k0_MPa: Positive | None = None
    kf_MPa: NotNegative | None = None
    k2: Positive | None = None
    kv_MPa: NotNegative | None = None  # of a solid
    t_rho_MPa: NotNegative | None = None
    t_rho_c_MPa: NotNegative | None = None
    K_t: Positive | None = None
    K_t_c: Positive | None = None
    T_0_MPa: NotNegative | None = None  # traction that does not count; of a lumpectomy that of healthy tissue, else 0
    kappa: Annotated[Number, limits(least=0.0, most=0.5)] | None = (
        None  # dispersion of fibres: 1/2, 1/3 in all directions
    )
    rho_wound: NotNegative | None = None
    c_wound: NotNegative | None = None
    phi_wound: Share | None = None

    @model_validator(mode="after")
    def _turns_and_gathers(self) -> ParametersTable:
        if (self.tau_omega is None) != (self.tau_kappa is None):
            missing = "tau_omega" if self.tau_omega is None else "tau_kappa"
            raise fault(missing, "is missing: fibres turn and gather, or neither")
        return self


def check_fields(values: Mapping[str, float | None], sensing: object, is_sheet: bool) -> None:
    """Refuse what the model cannot be, with the sentence of a case file; values that are not there are not looked at."""
    most, kappa = 0.5 if is_sheet else 1.0 / 3.0, values.get("kappa")
    if kappa is not None and kappa > most + 1e-12:
        raise fault("parameters.kappa", f"must be at most {most:.6g} in {2 if is_sheet else 3} dimensions")
    if not is_sheet and values.get("kv_MPa") == 0.0:
        raise fault("parameters.kv_MPa", "must be above 0 in three dimensions")
    cell = getattr(sensing, "cell", None)
    if cell is not None and cell.clutch is not None:
        raise fault("mechanosensing.cell.clutch", "must be left out: give force_pN or feedback")
