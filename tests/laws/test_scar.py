"""Stress and local rates of healing tissue, compared with stresses by hand."""

import jax
import numpy as np
import pytest
from quick import compiled

from cicatrix.biology.sensing import Sensing
from cicatrix.biology.signals import LogisticSignal, NoMechanosensing
from cicatrix.biology.turnover import Turnover
from cicatrix.healing.scarring import Contracture, Local, Reorientation, Scarring, orthonormalised
from cicatrix.materials.scar import Scar

RNG = np.random.default_rng(3)


def structure(kappa, a, d):
    whole = np.diag([1.0, 1.0, 0.0]) if d == 2 else np.eye(3)
    return kappa * whole + (1 - d * kappa) * np.outer(a, a)


def sheet(F, phi=0.7, lam=(0.9, 1.05), kappa=0.3, tension=4.0):
    """Return the Cauchy stress of an incompressible sheet by hand, with the pressure for zero normal stress."""
    a, s = np.array([0.8, 0.6, 0.0]), np.array([-0.6, 0.8, 0.0])
    F_p = lam[0] * np.outer(a, a) + lam[1] * np.outer(s, s) + np.outer([0, 0, 1], [0, 0, 1])
    A_0 = structure(kappa, a, 2)
    k_0, k_f, k_2 = 50.0, 30.0, 0.8
    F = F.copy()
    F[2], F[:, 2] = 0.0, 0.0
    F[2, 2] = np.prod(lam) / np.linalg.det(F[:2, :2])
    F_e = F @ np.linalg.inv(F_p)
    E = max(np.trace(F_e @ A_0 @ F_e.T) - 1.0, 0.0)
    sigma = 2 * k_0 * F_e @ F_e.T + 2 * phi * k_f * E * np.exp(k_2 * E**2) * F_e @ A_0 @ F_e.T
    sigma = sigma - sigma[2, 2] * np.eye(3)
    A = F @ A_0 @ F.T
    sigma += 2 * tension * A / np.trace(A)
    return Scar(F_p, A_0, k_0, k_f, k_2, 0.0, phi, tension, is_sheet=True), sigma, F


@pytest.mark.parametrize("stretch", [1.3, 0.8])
def test_a_sheet_is_the_stress_by_hand(stretch):
    """With and without stretched fibres, with a permanent deformation; J_e = 1, so J = det F_p."""
    given = np.array([[stretch, 0.2, 0.0], [-0.1, 0.95, 0.0], [0.0, 0.0, 1.0]])
    law, sigma, F = sheet(given)
    P = np.asarray(compiled(Scar.stress)(law, given))
    found = (P[:2, :2] @ F[:2, :2].T) / np.linalg.det(F)
    np.testing.assert_allclose(found, sigma[:2, :2], rtol=1e-11)
    assert np.abs(P[2]).max() == 0.0 == np.abs(P[:, 2]).max()


def test_a_solid_is_the_stress_by_hand():
    a = np.array([0.48, 0.6, 0.64])
    F_p, phi, T = np.diag([0.95, 1.1, 1.02]), 0.4, 3.0
    A_0 = structure(0.2, a, 3)
    F = np.eye(3) + 0.2 * RNG.standard_normal((3, 3))
    law = Scar(F_p, A_0, 6.5, 15.0, 0.05, 325.0, phi, T)
    F_e = F @ np.linalg.inv(F_p)
    J_e, J = np.linalg.det(F_e), np.linalg.det(F)
    E = np.trace(F_e @ A_0 @ F_e.T) - 1.0
    passive = 2 * 6.5 * (F_e @ F_e.T - np.eye(3)) + 325.0 * (J_e - 1) * J_e * np.eye(3)
    if E > 0:
        passive += 2 * 15.0 * E * np.exp(0.05 * E**2) * F_e @ A_0 @ F_e.T
    A = F @ A_0 @ F.T
    sigma = phi * passive / J_e + 2 * T / J_e * A / np.trace(A)
    P = np.asarray(compiled(Scar.stress)(law, F))
    np.testing.assert_allclose(P @ F.T / J, sigma, rtol=1e-11, atol=1e-11)


def test_without_pull_it_rests_at_its_permanent_deformation():
    for is_sheet in (True, False):
        F_p = np.diag([0.9, 1.2, 1.0])
        A_0 = structure(1 / 3, np.eye(3)[0], 2 if is_sheet else 3)
        law = Scar(F_p, A_0, 6.5, 15.0, 0.05, 325.0, 1.0, 0.0, is_sheet)
        assert np.abs(np.asarray(compiled(Scar.stress)(law, F_p))).max() < 1e-12


def scarring(turning=None, is_sheet=True, signal=None):
    values = {"p_f": 2e-3, "p_f_c": 1e-3, "p_f_t": 4e-3, "d_f": 1e-3, "d_f_rho_c": 5e-4}
    turnover = Turnover(**values, K_f_c=0.7, K_f_rho=1.1, x_rho=0.0, x_c=0.0)
    sensing = Sensing(signal or LogisticSignal(1.1, 5.0, 0.0))
    stress = {
        "k_0": 50.0,
        "k_f": 0.0,
        "k_2": 1.0,
        "k_v": 300.0,
        "t_rho": 5.0,
        "t_rho_c": 50.0,
        "K_t": 0.3,
        "K_t_c": 0.1,
    }
    return Scarring(turnover, sensing, Contracture(0.5), turning, **stress, is_sheet=is_sheet)


def local(d, a=(1.0, 0.0, 0.0), phi=0.3, kappa=None):
    a = np.array(a)
    s = np.cross([0.0, 0.0, 1.0], a)
    axes = np.stack([a, s / np.linalg.norm(s), [0, 0, 1.0]])
    return Local(np.array(phi), np.ones(d), np.array(1 / d if kappa is None else kappa), axes, np.zeros(0))


def advanced(law, F, rho, c, start, dt):
    return jax.tree.map(np.asarray, compiled(Scarring.step)(law, F, rho, c, start, start, dt))


def test_a_local_step_is_implicit_euler_of_the_rates_by_hand():
    law, F, rho, c, dt = scarring(), np.array([[1.3, 0.1, 0], [0, 1.1, 0], [0, 0, 1.0]]), 0.8, 0.4, 30.0
    start = local(2)
    end = advanced(law, F, rho, c, start, dt)
    theta = np.linalg.det(F[:2, :2]) / np.prod(end.stretch)
    H = 1 / (1 + np.exp(-5.0 * (theta - 1.1)))
    made = (2e-3 + 1e-3 * c / (0.7 + c) + 4e-3 * H) * rho / (1.1 + end.phi)
    assert end.phi == pytest.approx(start.phi + dt * (made - (1e-3 + 5e-4 * rho * c) * end.phi), rel=1e-12)
    elastic = np.linalg.norm(F[:, :2], axis=0) / end.stretch
    np.testing.assert_allclose(end.stretch, 1 + dt * made / 0.5 * (elastic - 1), rtol=1e-12)


def test_within_the_band_nothing_yields():
    law = scarring()
    law = Scarring(
        **{**{k: getattr(law, k) for k in law.__dataclass_fields__}, "yielding": Contracture(0.05, 0.95, 1.05)}
    )
    still = advanced(law, np.diag([1.04, 0.96, 1.0]), 1.0, 0.0, local(2), 100.0)
    assert (still.stretch == 1.0).all()
    beyond = advanced(law, np.diag([1.3, 0.96, 1.0]), 1.0, 0.0, local(2), 1.0)
    assert beyond.stretch[0] > 1.0
    assert beyond.stretch[1] == 1.0


@pytest.mark.parametrize("is_sheet", [True, False])
def test_fibres_turn_to_the_largest_stretch_at_the_rate_said(is_sheet):
    """One small step: rate 2 pi phi+ lambda_max sin(angle) / tau_omega, orthonormal axes, and the rate of dispersion."""
    d = 2 if is_sheet else 3
    law = scarring(Reorientation(10.0, 1.0), is_sheet, NoMechanosensing())
    F = np.diag([1.3, 1.0, 1.0 if is_sheet else 0.9])
    angle, dt = 0.7, 1e-3
    start = local(d, (np.cos(angle), np.sin(angle), 0.0), kappa=0.1)
    end = advanced(law, F, 1.0, 0.0, start, dt)
    made = 2e-3 / (1.1 + end.phi)
    turned = np.arctan2(end.axes[0, 1], end.axes[0, 0])
    assert (angle - turned) / dt == pytest.approx(2 * np.pi * made / 10.0 * 1.3 * np.sin(angle), rel=1e-4)
    np.testing.assert_allclose(end.axes @ end.axes.T, np.eye(3), atol=1e-12)
    gathered = made / 1.0 * ((1.0 / 1.3) ** 5 / d - 0.1)
    assert (end.dispersion - 0.1) / dt == pytest.approx(gathered, rel=1e-4)


def test_equal_stretches_turn_nothing():
    law = scarring(Reorientation(1.0, 1.0), True, NoMechanosensing())
    start = local(2, (0.6, 0.8, 0.0))
    end = advanced(law, np.diag([1.2, 1.2, 1.0]), 1.0, 0.0, start, 50.0)
    np.testing.assert_array_equal(end.axes, start.axes)


def test_a_mixture_of_states_has_orthonormal_axes():
    has = local(3, (0.6, 0.8, 0.0))
    mixed = orthonormalised(has._replace(axes=has.axes + 0.1 * RNG.standard_normal((3, 3))))
    np.testing.assert_allclose(mixed.axes @ np.swapaxes(mixed.axes, -1, -2), np.eye(3), atol=1e-12)
