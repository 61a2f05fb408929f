"""Stochastic bonds: compiled kernel and NumPy version, threads, and the mean of samples."""

import numpy as np
import pytest

from cicatrix.biology.adhesion import relax_bound_fraction
from cicatrix.biology.sampling import exact, monte_carlo
from cicatrix.core import native, switching
from cicatrix.core.random import ONE, Phase, site_word

KEY = np.array([5, 6], np.uint32)


def random_case(groups=3, n=1003, steps=5):
    rng = np.random.default_rng(0)
    state = (rng.random((groups, n)) < 0.4).astype(np.uint8)
    up, down = (rng.integers(0, ONE + 1, (steps, groups)).astype(np.uint64) for _ in range(2))
    up[:, 0], down[1, 1], up[2, 2] = 0, ONE, ONE  # never, always
    return state, up, down


@pytest.mark.skipif(not native.is_native, reason="the compiled kernels are not there")
@pytest.mark.parametrize("n", [1, 4, 127, 128, 129, 1003])
def test_kernel_is_its_reference(n):
    state, up, down = random_case(n=n)
    reference = switching.switch_states(state, up, down, KEY, 2**32 - 3, 6)  # the step number exceeds 32 bits
    np.testing.assert_array_equal(native.switch_states(state, up, down, KEY, 2**32 - 3, 6), reference)


@pytest.mark.skipif(not native.is_native, reason="the compiled kernels are not there")
def test_threads_and_portions_give_the_same_bits():
    state, up, down = random_case(n=50_003)
    whole = native.switch_states(state, up, down, KEY, 10, 6, 1)
    for threads in (2, 3):
        np.testing.assert_array_equal(native.switch_states(state, up, down, KEY, 10, 6, threads), whole)
    half = native.switch_states(state, up[:2], down[:2], KEY, 10, 6, 2)
    np.testing.assert_array_equal(native.switch_states(half, up[2:], down[2:], KEY, 12, 6, 2), whole)
    assert whole[0].mean() < state[0].mean()  # no bond closes there


def test_every_bond_has_its_own_word():
    """Compare with the generator's own function for sites: one step of one group of open bonds."""
    up = np.full((1, 1), 2**30, np.uint64)
    new = switching.switch_states(np.zeros((1, 10), np.uint8), up, up, KEY, 7, int(Phase.BOND))
    word = site_word(5 | 6 << 32, np.arange(10), 7, Phase.BOND)
    np.testing.assert_array_equal(new[0], word < 2**30)


def test_shapes_must_go_together():
    state, up, down = random_case()
    for kernel in (switching.switch_states, native.switch_states):
        with pytest.raises(ValueError, match="states"):
            kernel(state, up[:, :2].copy(), down, KEY, 0, 6)


K_ON, K_OFF = 0.05, np.array([0.02, 0.4])
N = 40_000


def test_steps_come_to_their_fixed_point():
    """P_on / (P_on + P_off) within four standard deviations; steps are so long that the ODE differs by 20 of these."""
    dt, steps = 2.0, 200
    on, off = -np.expm1(-dt * K_ON), -np.expm1(-dt * K_OFF)
    bound = monte_carlo(np.zeros((2, N), np.uint8), np.full((steps, 2), on), np.tile(off, (steps, 1)), 3, 0)
    fixed, mean = on / (on + off), K_ON / (K_ON + K_OFF)
    sigma = np.sqrt(fixed * (1 - fixed) / N)
    assert (np.abs(bound.mean(axis=1) - fixed) < 4 * sigma).all()
    assert abs(fixed[1] - mean[1]) > 20 * sigma[1]


def test_steps_and_exact_times_follow_the_ode():
    """Compare at 3 s and 20 s, starting from half of the bonds closed, with short steps."""
    start = np.tile((np.arange(N) % 2).astype(np.uint8), (2, 1))
    dt = 0.002
    chances = [np.broadcast_to(-np.expm1(-dt * k), (1500, 2)) for k in (np.full(2, K_ON), K_OFF)]
    stepped = monte_carlo(start, *chances, 11, 0)
    early = exact(start, (0.0, 3.0), np.full(2, K_ON), K_OFF, None, 12, 1)
    late = exact(early, (3.0, 20.0), np.full(2, K_ON), K_OFF, None, 12, 2)
    for t, sampled in ((3.0, stepped), (3.0, early), (20.0, late)):
        mean = np.asarray(relax_bound_fraction(0.5, K_ON, K_OFF, t))
        assert (np.abs(sampled.mean(axis=1) - mean) < 4 * np.sqrt(mean * (1 - mean) / N)).all()


def test_rates_that_change_are_met():
    """With k_off = a t and no closing, by hand exp(-a t^2 / 2) stay bound."""
    a, end = 0.1, 4.0
    bound = np.ones((1, N), np.uint8)
    left = exact(bound, (0.0, end), np.array([1e-12]), np.array([a * end]), lambda t, cell: a * t, 4, 1)
    mean = np.exp(-0.5 * a * end**2)
    assert abs(left.mean() - mean) < 4 * np.sqrt(mean * (1 - mean) / N)


def test_exact_times_heed_seed_and_interval():
    bound = np.ones((1, 1000), np.uint8)
    rates = np.array([0.5]), np.array([0.5])
    same = [exact(bound, (0.0, 1.0), *rates, None, 1, 1) for _ in range(2)]
    np.testing.assert_array_equal(*same)
    assert (exact(bound, (0.0, 1.0), *rates, None, 2, 1) != same[0]).any()
    assert (exact(bound, (0.0, 1.0), *rates, None, 1, 2) != same[0]).any()
