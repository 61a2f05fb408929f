"""Time courses, steady states and sensitivities of signalling networks, compared with closed forms, SciPy and differences."""

from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

from cicatrix.biology.courses import integrate
from cicatrix.biology.network import HillNetwork
from cicatrix.biology.rules import parse_rule
from cicatrix.biology.sensitivity import of_end, of_steady_state
from cicatrix.biology.steady import N_TIMES, latin_hypercube, steady_states
from cicatrix.biology.wiring import Wiring
from cicatrix.numerics.ode import Accuracy

pytestmark = pytest.mark.xdist_group("signalling networks")
EXPLICIT = Accuracy(1e-9, 1e-12, "explicit")


def network(rules, n, ec50, tau, weight=None):
    wiring = Wiring(tuple("ABC"[: len(tau)]), tuple(f"r{i}" for i in range(len(rules))), tuple(map(parse_rule, rules)))
    full = [np.full(len(rules), value) for value in (n, ec50)]
    weight = np.ones(len(rules)) if weight is None else np.array(weight)
    return HillNetwork(wiring, np.ones(len(tau)), np.array(tau), weight, *full)


def hill(x, n, ec50):
    half = ec50**n
    return (1 - half) * x**n / (half + (1 - 2 * half) * x**n)


def loop_rate(y, tau, n=2.0, ec50=0.5, inputs=0.3, w=(0.8, 0.9, 0.7)):
    """Return the rate of A <- input or C, B <- A, C <- B and not A, in NumPy."""
    a, b, c = np.maximum(y, 0.0)
    into_a = inputs + w[0] * hill(c, n, ec50) * (1 - inputs)
    into_c = hill(b, n, ec50) * (1 - w[2] * hill(a, n, ec50))
    return (np.array([into_a, w[1] * hill(a, n, ec50), into_c]) - y) / tau


TAU = np.array([360.0, 3600.0, 1800.0])
LOOP = network(["=> A", "C => A", "A => B", "B & !A => C"], 2.0, 0.5, TAU, [0.3, 0.8, 0.9, 0.7])
INPUTS = np.array([0.3])


def padded(times):
    return jnp.asarray(np.append(times, np.full(N_TIMES - len(times), times[-1])))


@pytest.mark.parametrize("method", [pytest.param("implicit", marks=pytest.mark.slow), "explicit"])
def test_course_is_that_of_scipy(method):
    start, times = np.array([0.9, 0.1, 0.5]), np.array([0.0, 500.0, 3600.0, 40_000.0])
    done = integrate(LOOP, jnp.asarray(INPUTS), jnp.asarray(start), padded(times), Accuracy(1e-9, 1e-12, method))
    assert bool(done.is_done)
    theirs = solve_ivp(lambda t, y: loop_rate(y, TAU), (0, times[-1]), start, "LSODA", times, rtol=1e-10, atol=1e-13)
    np.testing.assert_allclose(done.y[: len(times)], theirs.y.T, atol=3e-8)


@pytest.mark.slow
def test_an_input_alone_is_an_exponential():
    times = np.array([0.0, 100.0, 360.0, 2000.0])
    law = network(["=> A"], 1.4, 0.5, [360.0])
    y = integrate(law, jnp.array([0.7]), jnp.array([0.2]), padded(times), EXPLICIT).y[:4, 0]
    np.testing.assert_allclose(y, 0.7 + (0.2 - 0.7) * np.exp(-times / 360.0), atol=1e-9)


@pytest.mark.slow
def test_several_states_share_their_steps():
    starts = np.random.default_rng(1).random((4, 3))
    times = padded(np.array([0.0, 3000.0]))
    inputs = np.array([[0.1], [0.3], [0.5], [0.9]])
    together = integrate(LOOP, jnp.asarray(inputs), jnp.asarray(starts), times, EXPLICIT)
    assert together.y.shape == (N_TIMES, 4, 3)
    for k in range(4):
        alone = solve_ivp(
            lambda t, y, k=k: loop_rate(y, TAU, inputs=inputs[k, 0]), (0, 3000.0), starts[k], rtol=1e-10, atol=1e-13
        )
        np.testing.assert_allclose(together.y[-1, k], alone.y[:, -1], atol=1e-7)


def test_a_toggle_has_two_stable_states_and_a_saddle():
    """By bisection: x is NOT of NOT of x at the roots of x - (1 - act(1 - act(x)))."""
    law = network(["!B => A", "!A => B"], 4.0, 0.5, [360.0, 720.0])
    grid = np.linspace(0.0, 1.0, 1002)

    def gap(x):
        return x - (1 - hill(1 - hill(x, 4.0, 0.5), 4.0, 0.5))

    roots = [brentq(gap, a, b, xtol=1e-14) for a, b in pairwise(grid) if gap(a) * gap(b) < 0]
    exact = [0.0, *roots, 1.0]  # its ends are exact: act(0) = 0, act(1) = 1
    assert len(exact) == 3
    starts = np.vstack([[0.0, 1.0], [1.0, 0.0], latin_hypercube(np.zeros(2), np.ones(2), 10, np.random.default_rng(1))])
    found = steady_states(law, np.zeros(0), starts, 72_000.0, np.ones(2), EXPLICIT)
    assert [state.is_stable for state in found.states] == [True, True, False]
    np.testing.assert_allclose(sorted(state.y[0] for state in found.states), exact, atol=1e-9)
    for state in found.states:
        assert state.y[1] == pytest.approx(1 - hill(state.y[0], 4.0, 0.5), abs=1e-9)
    assert sum(state.n_starts for state in found.states) == len(starts) == np.sum(found.reached >= 0)
    assert found.states[2].n_starts == 0
    assert {tuple(np.round(found.states[k].y)) for k in found.reached[:2]} == {(0.0, 1.0), (1.0, 0.0)}
    # by hand: act'(0) = 0, so at the ends one of the two slopes is 0 and the eigenvalues are -1 / tau; -1 / 720 is the larger
    assert found.states[0].growth == pytest.approx(-1 / 720.0)


def test_one_steady_state_is_that_of_fsolve():
    starts = np.vstack([np.zeros(3), np.ones(3), [0.2, 0.9, 0.4]])
    found = steady_states(LOOP, INPUTS, starts, 360_000.0, np.ones(3), EXPLICIT)
    (state,) = found.stable
    theirs = fsolve(lambda y: loop_rate(y, TAU) * TAU, state.y + 0.01, xtol=1e-13)
    np.testing.assert_allclose(state.y, theirs, atol=1e-10)
    assert (state.n_starts, found.n_conserved) == (3, 0)
    numeric = np.array([(loop_rate(theirs + h, TAU) - loop_rate(theirs - h, TAU)) / 2e-6 for h in 1e-6 * np.eye(3)]).T
    assert state.growth == pytest.approx(np.linalg.eigvals(numeric).real.max(), rel=1e-5)


def test_what_does_not_come_to_rest_is_told():
    """A negative loop of three species with steep switches oscillates for ever; its one steady state is unstable."""
    law = network(["!C => A", "A => B", "B => C"], 8.0, 0.5, [3600.0] * 3)
    starts = np.array([[0.0, 0.0, 0.0], [0.9, 0.1, 0.4]])
    found = steady_states(law, np.zeros(0), starts, 360_000.0, np.ones(3), EXPLICIT)
    assert list(found.reached) == [-1, -1]
    assert [(state.is_stable, state.n_starts) for state in found.states] == [(False, 0)]


def test_sensitivities_of_a_steady_state_are_differences(slope):
    def steady(**changed):
        return fsolve(lambda y: loop_rate(y, TAU, **changed) * TAU, [0.4, 0.4, 0.3], xtol=1e-13)

    by = of_steady_state(LOOP, INPUTS, steady())
    np.testing.assert_allclose(by["input"][:, 0], slope(lambda h: steady(inputs=0.3 + h), 1e-3), rtol=1e-6)
    weight = slope(lambda h: steady(w=(0.8, 0.9 + h, 0.7)), 1e-3)
    np.testing.assert_allclose(by["weight"][:, 2], weight, rtol=1e-6)
    np.testing.assert_allclose(by["ec50"].sum(axis=1), slope(lambda h: steady(ec50=0.5 + h), 1e-3), rtol=1e-5)
    np.testing.assert_allclose(by["n"].sum(axis=1), slope(lambda h: steady(n=2.0 + h), 1e-3), rtol=1e-5)
    np.testing.assert_array_equal(by["weight"][:, 0], 0.0)  # the input replaces it
    np.testing.assert_allclose(by["tau"], 0.0, atol=1e-15)  # time constants do not change a steady state


@pytest.mark.slow
@pytest.mark.parametrize("method", ["implicit", "explicit"])
def test_sensitivities_of_a_course_are_differences(method, slope):
    """The input changes twice."""
    start, at, held = np.array([0.1, 0.2, 0.6]), np.array([0.0, 900.0, 2500.0]), np.array([[0.3], [0.8]])
    by = of_end(LOOP, held, start, at, Accuracy(1e-9, 1e-11, method))

    def end(added=0.0, **changed):
        y = start
        for k in range(2):
            inputs = held[k, 0] + added
            rate = lambda t, y, inputs=inputs: loop_rate(y, TAU, inputs=inputs, **changed)  # noqa: E731
            y = solve_ivp(rate, (at[k], at[k + 1]), y, "LSODA", rtol=1e-11, atol=1e-13).y[:, -1]
        return y

    np.testing.assert_allclose(by["input"][:, 0], slope(lambda h: end(added=h), 1e-3), rtol=1e-4)
    np.testing.assert_allclose(by["ec50"].sum(axis=1), slope(lambda h: end(ec50=0.5 + h), 1e-3), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(by["n"].sum(axis=1), slope(lambda h: end(n=2.0 + h), 1e-3), rtol=1e-4, atol=1e-6)


def test_each_n_th_of_every_range_is_drawn_once():
    drawn = latin_hypercube(np.array([0.0, 2.0]), np.array([1.0, 4.0]), 7, np.random.default_rng(1))
    strata = np.floor((drawn - [0.0, 2.0]) / [1.0, 2.0] * 7).astype(int)
    np.testing.assert_array_equal(np.sort(strata, axis=0), np.tile(np.arange(7), (2, 1)).T)
