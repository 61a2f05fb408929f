"""Clusters of bonds that share their load: lifetimes in closed form and from samples."""

import jax
import numpy as np
import pytest

from cicatrix.biology.cluster import ForceSharing, critical_load, mean_lifetime, sample_lifetimes, shared


@pytest.mark.parametrize("size", [1, 2, 10, 100])
def test_no_force_no_rebinding(size):
    """Bonds open one after the other, so the lifetime is a harmonic number."""
    assert float(ForceSharing(0.0).lifetime(size, 0.0)) == pytest.approx(
        sum(1 / i for i in range(1, size + 1)), rel=1e-13
    )


def test_force_without_rebinding():
    """The lifetime is sum exp(-f / i) / i, for a batch of forces."""
    f, i = np.array([0.5, 3.0, 20.0]), np.arange(1, 8)
    np.testing.assert_allclose(ForceSharing(0.0).lifetime(7, f), (np.exp(-f[:, None] / i) / i).sum(axis=1), rtol=1e-13)


@pytest.mark.parametrize("gamma", [0.1, 1.0, 3.0])
def test_rebinding_without_force(gamma):
    """Erdmann & Schwarz 2004: (H_N + sum binom(N, n) gamma^n / n) / (1 + gamma); for two bonds by hand 3/2 + gamma / 2."""
    from math import comb

    size = 6
    closed = sum(comb(size, n) * gamma**n / n for n in range(1, size + 1)) + sum(1 / n for n in range(1, size + 1))
    assert float(ForceSharing(gamma).lifetime(size, 0.0)) == pytest.approx(closed / (1 + gamma), rel=1e-12)
    assert float(ForceSharing(gamma).lifetime(2, 0.0)) == pytest.approx(1.5 + gamma / 2, rel=1e-13)


def test_two_bonds_by_hand():
    """T = 1/r_2 + (1 + g_1 / r_2) / r_1 with r_1 = e^f, r_2 = 2 e^(f/2), g_1 = gamma."""
    f, gamma = 1.3, 0.8
    r1, r2 = np.exp(f), 2 * np.exp(f / 2)
    assert float(ForceSharing(gamma).lifetime(2, f)) == pytest.approx(1 / r2 + (1 + gamma / r2) / r1, rel=1e-13)


@pytest.mark.parametrize(("gamma", "force"), [(0.0, 0.0), (0.0, 4.0), (1.0, 2.0)])
def test_sampled_lifetimes(gamma, force):
    """The mean of 20 000 samples is within 4 standard errors."""
    law, i = ForceSharing(gamma), np.arange(1.0, 6.0)
    opening, closing = np.asarray(law.opening(i, force)), np.asarray(law.closing(i, 5))
    times = sample_lifetimes(opening, closing, 20_000, 5)
    assert abs(times.mean() - float(mean_lifetime(opening, closing))) < 4 * times.std() / np.sqrt(len(times))


def test_clusters_that_live_on_are_told():
    i = np.arange(1.0, 6.0)
    assert np.isnan(sample_lifetimes(i, 1e6 * (5 - i), 3, 1, most=50)).all()


def test_critical_force():
    """At the critical force i e^(f/i) touches gamma (N - i); it is found on a fine grid of i."""
    size, gamma = 100, 1.0
    critical = float(ForceSharing(gamma).critical_force(size))
    assert critical == pytest.approx(100 * 0.278464542761, rel=1e-10)  # w e^w = 1/e
    i = np.linspace(1.0, size, 400_001)
    assert (gamma * (size - i) - i * np.exp(0.999 * critical / i)).max() > 0
    assert (gamma * (size - i) - i * np.exp(1.001 * critical / i)).max() < 0
    assert float(ForceSharing(0.0).critical_force(size)) == 0.0


def test_derivative_by_force(slope):
    law = ForceSharing(0.7)
    lifetime = jax.jit(lambda f: law.lifetime(8, f))
    assert float(jax.grad(lifetime)(2.0)) == pytest.approx(slope(lambda h: float(lifetime(2.0 + h)), 1e-3), rel=1e-8)


def test_shared_is_the_cluster_of_bell_bonds():
    """Bell bonds with f_b = 4 pN: k_off0 exp(F / f_b), times in units of 1 / k_off0 and forces in units of f_b."""
    found = jax.jit(lambda f: shared(6, f, lambda force: 0.02 * np.e ** (force / 4.0), 0.03, True))(
        np.array([1.0, 3.0])
    )
    law = ForceSharing(1.5)
    np.testing.assert_allclose(found, law.lifetime(6, np.array([6.0, 18.0]) / 4.0) / 0.02, rtol=1e-12)
    alone = shared(6, np.array(0.0), lambda force: 0.02 + 0.0 * force, 0.03, False)
    assert float(alone) == pytest.approx(2.45 / 0.02, rel=1e-12)  # H_6 = 2.45


@pytest.mark.parametrize("gamma", [0.1, 1.0, 30.0])
def test_critical_load_is_that_of_shared_force(gamma):
    """For k_off = e^f and k_on = gamma, the numerical critical load equals the closed form."""
    (found,) = critical_load(7, jax.numpy.exp, np.array([gamma]))
    assert found == pytest.approx(float(ForceSharing(gamma).critical_force(7)), rel=1e-9)
