"""Tables of the continuum healing model: parameters and mechanosensing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import model_validator

from .adhesion import BondTable, CellTable, FibreTable, LinearTable
from .bounds import NotNegative, Number, Positive, bounds, fault
from .continuum_values import BREAST_CAVITY, CIRCULAR_WOUND
from .laws import one_of
from .signals import MoreoTable, NetworkSignalTable
from .table import Table

VALUES = {"circular-wound": CIRCULAR_WOUND, "breast-cavity": BREAST_CAVITY}


TimeTolerance = Annotated[Number, bounds(least=1e-8, most=1e-1)]


Share = Annotated[Number, bounds(above=0.0, most=1.0)]


class NoneTable(Table):
    """No mechanosensing: H = 0."""

    type: Literal["none"]


class LogisticTable(Table):
    """Signal from the elastic change of area or volume: :class:`..biology.signals.LogisticSignal`.

    Its parameters are ``theta_ref``, ``gamma`` and ``H_least`` of the table ``parameters``.
    """

    type: Literal["logistic"]


class AdhesionTable(Table):
    """Signal from the traction at adhesions, with their bonds computed at every point: :class:`..biology.sensing.Sensing`."""

    type: Literal["adhesion"]
    bond: BondTable
    # substrate that a bond pulls at, at the elastic stretch of the fibres; one of the tables below
    substrate: one_of({"linear": LinearTable, "exponential-fibre": FibreTable})  # pyright: ignore[reportInvalidTypeForm]
    cell: CellTable
    K_kPa: Positive = 1.0  # traction beyond the threshold at which the signal is one half
    threshold_kPa: NotNegative = 0.0  # traction up to which there is no signal


class NetworkSensingTable(AdhesionTable, NetworkSignalTable):
    """Signal from a signalling network that the traction at adhesions drives."""

    type: Literal["network"]  # pyright: ignore[reportIncompatibleVariableOverride]


AnySensing = one_of(
    {
        "none": NoneTable,
        "logistic": LogisticTable,
        "moreo": MoreoTable,
        "adhesion": AdhesionTable,
        "network": NetworkSensingTable,
    }
)


class ParametersTable(Table):
    """Parameters of the continuum model, named as in docs/theory/wound.md; the defaults are the values of the benchmark.

    Cell density is relative to that of healthy tissue (``rho_phys_per_mm3``), cytokine to a largest concentration
    (``c_max_g_per_mm3``) and collagen to that of healthy tissue, so all rates are per hour.
    """

    rho_phys_per_mm3: Positive | None = None  # cell density of healthy tissue
    c_max_g_per_mm3: Positive | None = None  # largest cytokine concentration
    D_rho_mm2_per_h: NotNegative | None = None  # diffusivity of cells
    D_rho_c_mm2_per_h: Number | None = None  # chemotaxis; if negative, cells move to where there is more cytokine
    D_rho_phi_mm2_per_h: Number | None = None  # haptotaxis; if negative, cells move to where there is more collagen
    D_c_mm2_per_h: NotNegative | None = None  # diffusivity of cytokine
    p_rho_per_h: NotNegative | None = None  # proliferation of cells without cytokine and signal
    p_rho_c_per_h: NotNegative | None = None  # largest additional proliferation by cytokine
    p_rho_H_per_h: NotNegative | None = None  # largest additional proliferation by the mechanical signal
    K_rho_c: Positive | None = None  # cytokine at which its effect on proliferation is one half
    K_rho_rho: Positive | None = None  # cell density at which proliferation stops
    d_rho_per_h: NotNegative | None = None  # death of cells
    x_rho_per_h: NotNegative | None = None  # exchange of cells with healthy tissue; 0 in both benchmarks
    p_c_rho_per_h: NotNegative | None = None  # production of cytokine by cells under cytokine
    p_c_H_per_h: NotNegative | None = None  # production of cytokine by cells under the mechanical signal
    K_c_c: Positive | None = None  # cytokine at which its production saturates
    d_c_per_h: NotNegative | None = None  # decay of cytokine
    x_c_per_h: NotNegative | None = None  # exchange of cytokine with the surroundings; 0 in both benchmarks
    p_phi_per_h: NotNegative | None = None  # production of collagen without cytokine and signal
    p_phi_c_per_h: NotNegative | None = None  # largest additional production of collagen by cytokine
    p_phi_H_per_h: NotNegative | None = None  # largest additional production of collagen by the mechanical signal
    K_phi_c: Positive | None = None  # cytokine at which its effect on collagen is one half
    K_phi_rho: Positive | None = None  # collagen at which its production saturates
    d_phi_per_h: NotNegative | None = None  # decay of collagen
    d_phi_rho_c_per_h: NotNegative | None = None  # decay of collagen by cells under cytokine
    theta_ref: Positive | None = None  # elastic ratio of area or volume at which the logistic signal is one half
    gamma: NotNegative | None = None  # steepness of the logistic signal
    H_least: Annotated[Number, bounds(least=0.0, most=1.0)] | None = None  # smaller logistic signals count as 0
    tau_P: Positive | None = None  # amount of new collagen over which permanent stretch follows the elastic stretch
    band_low: Annotated[Number, bounds(least=0.0, most=1.0)] | None = (
        None  # lower end of the elastic stretches without remodelling
    )
    band_high: Annotated[Number, bounds(least=1.0)] | None = (
        None  # upper end of the elastic stretches without remodelling
    )
    growth_density: Positive | None = None  # if given, tissue grows with collagen instead of stretching permanently
    tau_omega: Positive | None = None  # amount of new collagen over which fibres reorient; default: no reorientation
    tau_kappa: Positive | None = None  # amount of new collagen over which fibres align; given together with tau_omega
    gamma_kappa: NotNegative | None = None  # sharpness of the alignment of fibres
    k0_MPa: Positive | None = None  # stiffness of the matrix, half its shear modulus
    kf_MPa: NotNegative | None = None  # stiffness of the collagen fibres
    k2: Positive | None = None  # exponent of the stiffening of fibres
    kv_MPa: NotNegative | None = None  # bulk stiffness; for a body in three dimensions
    t_rho_MPa: NotNegative | None = None  # active traction of cells without cytokine
    t_rho_c_MPa: NotNegative | None = None  # largest additional active traction by cytokine
    K_t: Positive | None = None  # collagen at which traction is largest
    K_t_c: Positive | None = None  # cytokine at which its effect on traction is one half
    T_0_MPa: NotNegative | None = None  # traction subtracted; default: that of healthy tissue in a lumpectomy, else 0
    kappa: Annotated[Number, bounds(least=0.0, most=0.5)] | None = (
        None  # initial fibre dispersion: 0 is aligned; 1/2 in a sheet and 1/3 in a solid are isotropic
    )
    rho_wound: NotNegative | None = None  # initial cell density in the wound
    c_wound: NotNegative | None = None  # initial cytokine in the wound
    phi_wound: Share | None = None  # initial collagen in the wound

    @model_validator(mode="after")
    def _turns_and_gathers(self) -> ParametersTable:
        if (self.tau_omega is None) != (self.tau_kappa is None):
            missing = "tau_omega" if self.tau_omega is None else "tau_kappa"
            raise fault(missing, "is missing: give both tau_omega and tau_kappa, or neither")
        return self


def check_continuum(values: Mapping[str, float | None], sensing: object, is_sheet: bool) -> None:
    """Raise an error that names the key if a value is invalid in the continuum model; missing values are not checked."""
    most, kappa = 0.5 if is_sheet else 1.0 / 3.0, values.get("kappa")
    if kappa is not None and kappa > most + 1e-12:
        raise fault("parameters.kappa", f"must be at most {most:.6g} in {2 if is_sheet else 3} dimensions")
    if not is_sheet and values.get("kv_MPa") == 0.0:
        raise fault("parameters.kv_MPa", "must be above 0 in three dimensions")
    cell = getattr(sensing, "cell", None)
    if cell is not None and cell.clutch is not None:
        raise fault("mechanosensing.cell.clutch", "must be left out: give force_pN or feedback")
