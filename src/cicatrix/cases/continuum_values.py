"""Parameter values of the two reference wounds, by the keys of case files; docs/theory/wound.md gives their sources."""

from __future__ import annotations

RHO_PHYS, C_MAX = "rho_phys_per_mm3", "c_max_g_per_mm3"

CIRCULAR_WOUND: dict[str, float] = {
    RHO_PHYS: 1e4,
    C_MAX: 1e-4,
    "D_rho_mm2_per_h": 0.0833,
    "D_rho_c_mm2_per_h": 0.0,
    "D_rho_phi_mm2_per_h": 0.0,
    "D_c_mm2_per_h": 0.01208,
    "p_rho_per_h": 0.017,
    "p_rho_c_per_h": 0.0085,
    "p_rho_H_per_h": 0.0085,
    "K_rho_c": 0.1,
    "K_rho_rho": 10.0,
    "d_rho_per_h": 0.9 * 0.017,
    "x_rho_per_h": 0.0,
    "p_c_rho_per_h": 0.0,
    "p_c_H_per_h": 0.0,
    "K_c_c": 1.0,
    "d_c_per_h": 0.01,
    "x_c_per_h": 0.0,
    "p_phi_per_h": 0.002,
    "p_phi_c_per_h": 0.002,
    "p_phi_H_per_h": 0.002,
    "K_phi_c": 1.0,
    "K_phi_rho": 1.06185567,
    "d_phi_per_h": 9.7e-4,
    "d_phi_rho_c_per_h": 0.5 * 9.7e-4,
    "theta_ref": 2.0,
    "gamma": 5.0,
    "H_least": 0.002,
    "tau_P": 0.485,
    "band_low": 1.0,
    "band_high": 1.0,
    "gamma_kappa": 5.0,
    "k0_MPa": 0.0511,
    "kf_MPa": 0.0,
    "k2": 0.048,
    "kv_MPa": 0.0,
    "t_rho_MPa": 0.005,
    "t_rho_c_MPa": 0.05,
    "K_t": 0.3,
    "K_t_c": 0.1,
    "kappa": 0.5,
    "rho_wound": 0.0,
    "c_wound": 1.0,
    "phi_wound": 0.01,
}
"""Values of the round wound in a sheet; a value that this wound does not use is 0, or the same as in :data:`BREAST_CAVITY`."""

CELL_TRACTION_MPA = 1.28571e-5 / 55.05  # traction per cell density [MPa mm^3]
CELLS = 55051.0  # cells of healthy tissue per mm^3
BREAST_CAVITY: dict[str, float] = CIRCULAR_WOUND | {
    RHO_PHYS: CELLS,
    "p_rho_per_h": 0.0496 / 55.05,
    "p_rho_c_per_h": 0.5 * 0.0496 / 55.05,
    "p_rho_H_per_h": 0.5 * 0.0496 / 55.05,
    "K_rho_rho": 550513.0 / CELLS,
    "d_rho_per_h": 0.9 * 0.0496 / 55.05,
    "p_phi_per_h": 3.74e-4 * (1.0 + 1.06185567),
    "p_phi_c_per_h": 3.74e-4 * (1.0 + 1.06185567),
    "p_phi_H_per_h": 3.74e-4 * (1.0 + 1.06185567),
    "d_phi_per_h": 3.74e-4,
    "d_phi_rho_c_per_h": 0.5 * 3.74e-4,
    "tau_P": 0.05,
    "band_low": 0.95,
    "band_high": 1.05,
    "k0_MPa": 6.55e-3,
    "kf_MPa": 0.015,
    "k2": 0.048,
    "kv_MPa": 0.325,
    "t_rho_MPa": CELL_TRACTION_MPA * CELLS,
    "t_rho_c_MPa": 3.28571 * CELL_TRACTION_MPA * CELLS,
    "K_t": 0.2,
    "K_t_c": 0.1,
    "kappa": 1.0 / 3.0,
    "rho_wound": 1000.0 / CELLS,
    "c_wound": 1.0,
    "phi_wound": 0.01,
}
"""Values of the cavity in a breast, in three dimensions.

The sources do not give the production of collagen; it follows from decay, so that healthy tissue keeps its collagen. Other
values that the sources do not give are those of the round wound.
"""
