"""Maxwell branches of isotropic laws, compared with small-strain theory and with another integrator."""

import numpy as np
import pytest
from quick import compiled
from scipy.integrate import solve_ivp

from cicatrix.core.errors import InputError
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.materials.ogden import Ogden
from cicatrix.materials.viscoelastic import Viscoelastic

pytestmark = pytest.mark.xdist_group("viscoelastic")  # compiled once

step = compiled(lambda law, F, state, dt: law.response(F, state, dt))
lost = compiled(lambda law, F, before, after, dt: law.dissipated(F, before, after, dt))
PRONY = Viscoelastic(NeoHookean(2.0, 50.0), (0.5, 0.25), (1.0, 10.0))


def integrated(law, shapes, dt):
    """Return the Cauchy stress after the last of equal steps, and the state."""
    state = law.initial_state(())
    for F in shapes:
        answer = step(law, F, state, dt)
        state = answer.state
    F = shapes[-1]
    return np.asarray(answer.P) @ F.T / np.linalg.det(F), state


def test_small_shear_relaxes_by_the_prony_series():
    """sigma_xy / gamma = mu (1 + sum beta_i / (1 + dt / t_i)^n): backward Euler of each branch, by hand."""
    F = np.eye(3) + 1e-6 * np.outer([1, 0, 0], [0, 1, 0])
    for n in (1, 4):
        sigma, _ = integrated(PRONY, [F] * n, 0.5)
        expected = 2.0 * (1 + 0.5 / 1.5**n + 0.25 / 1.05**n)
        assert sigma[0, 1] / 1e-6 == pytest.approx(expected, rel=1e-5)


def test_long_steps_leave_the_law_alone():
    F = np.array([[1.4, 0.3, 0.0], [0.0, 0.8, 0.1], [0.0, 0.0, 0.9]])
    sigma, state = integrated(PRONY, [F], 1e12)
    P = np.asarray(PRONY.law.stress(F))
    np.testing.assert_allclose(sigma, P @ F.T / np.linalg.det(F), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(np.asarray(state)), 1.0, rtol=1e-12)


@pytest.mark.slow
def test_large_stretch_against_another_integrator():
    """Stretched to 2 at constant volume in 3 s, t_r = 1 s: logarithmic strains along fixed axes, by LSODA to 1e-10."""
    law, alpha = Ogden(2.0, 5.0, 50.0), 5.0
    rate = np.log(2.0) / 3.0 * np.array([1.0, -0.5, -0.5])

    def tension(e):
        powers = np.exp(alpha * e)  # dev of 2 mu / alpha l^alpha, e without trace
        return 2 * 2.0 / alpha * (powers - powers.mean())

    def change(t, e):
        return rate - tension(e) / (2 * 2.0 * 1.0)

    e = solve_ivp(change, (0, 3), np.zeros(3), method="LSODA", rtol=1e-10, atol=1e-12).y[:, -1]
    total = 3 * rate
    exact = tension(total) + tension(e)
    errors = []
    for n in (20, 40, 80):
        shapes = [np.diag(np.exp(total * k / n)) for k in range(1, n + 1)]
        sigma, _ = integrated(Viscoelastic(law, (1.0,), (1.0,)), shapes, 3 / n)
        errors.append(np.abs(np.diag(sigma) - sigma.trace() / 3 - exact).max())
    assert errors[2] < 0.02 * np.abs(exact).max()
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.1)


def test_heat_is_what_the_branches_stored():
    """Held in shear, mu/2 gamma^2 (beta_1 + beta_2) of the neo-Hookean springs is dissipated, to first order in the step."""
    F, state, heat = np.eye(3) + 0.5 * np.outer([1, 0, 0], [0, 1, 0]), PRONY.initial_state(()), 0.0
    state = step(PRONY, F, state, 0.0).state
    for dt in np.geomspace(0.005, 2.0, 120):
        after = step(PRONY, F, state, dt).state
        heat += float(lost(PRONY, F, state, after, dt))
        state = after
    assert heat == pytest.approx(0.5 * 2.0 * 0.25 * 0.75, rel=0.05)


def test_branches_need_their_times():
    with pytest.raises(InputError, match="must have one time per branch: 2; got 1"):
        Viscoelastic(NeoHookean(1.0), (0.5, 0.5), (1.0,))
    with pytest.raises(InputError, match=r"Viscoelastic.beta \(beta\) must lie in \[0, inf\]"):
        Viscoelastic(NeoHookean(1.0), (0.5, -0.5), (1.0, 1.0))


def test_branches_beside_what_does_not_resist_do_nothing():
    state = Viscoelastic(NeoHookean(0.0), (0.5,), (1.0,)).initial_state(())
    answer = step(Viscoelastic(NeoHookean(0.0), (0.5,), (1.0,)), np.diag([1.2, 1.0, 1.0]), state, 1.0)
    np.testing.assert_array_equal(answer.P, np.zeros((3, 3)))
    assert np.isfinite(np.asarray(answer.state)).all()
