"""Rates of cells, cytokine and collagen and their mechanical signals: numbers by hand, fixed points, many points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cicatrix.biology.moreo import Moreo
from cicatrix.biology.network import HillNetwork, Wiring
from cicatrix.biology.rules import parse_rule
from cicatrix.biology.signals import NetworkSignal, StrainSignal, TractionSignal
from cicatrix.biology.turnover import Densities, Turnover
from cicatrix.core.errors import InputError

H = 1.0 / 3600.0  # 1/h in 1/s


def test_rates_by_hand():
    law = Turnover(
        p_f=2.0, p_f_c=3.0, p_f_t=4.0, d_f=0.5, d_f_rho_c=0.25, K_f_c=1.0, K_f_rho=1.0,
        p_rho=1.0, p_rho_c=2.0, p_rho_t=3.0, d_rho=0.1, x_rho=0.2, K_rho_c=3.0, K_rho_rho=4.0,
        p_c=0.5, p_c_t=2.0, d_c=0.3, x_c=0.4, K_c_c=1.0, c_phys=2.0,
    )  # fmt: skip
    rates = law.rates(Densities(2.0, 1.0, 3.0), 0.5)
    assert rates.m_f == pytest.approx((2 + 1.5 + 2) * 2 / 4 - (0.5 + 0.5) * 3)
    assert rates.rho == pytest.approx((1 + 0.5 + 1.5) * 0.5 * 2 - 0.2 - 0.2)
    assert rates.c == pytest.approx((0.5 + 1.0) * 2 / 2 - 0.3 + 0.4)


def test_healthy_tissue_stays():
    assert np.allclose(Turnover().rates(Densities(1.0, 0.0, 1.0), 0.0), 0.0, atol=1e-18)


@pytest.mark.parametrize("d_rho", [0.1, 0.5])
def test_cells_alone_are_logistic(d_rho):
    """The steady state is rho* = K (1 - d / p)."""
    law = Turnover(d_rho=d_rho * 0.034 * H, x_rho=0.0, K_rho_rho=3.0)
    assert law.rates(Densities(3.0 * (1.0 - d_rho), 0.0, 1.0), 0.0).rho == pytest.approx(0.0, abs=1e-18)


def test_collagen_comes_to_the_root_of_its_balance():
    """d m (K + m) = p rho, so m = -K/2 + sqrt(K^2/4 + p rho / d)."""
    law, rho = Turnover(K_f_rho=2.0), 0.7
    m_f = -1.0 + np.sqrt(1.0 + 0.002 * rho / 0.00097)
    assert law.rates(Densities(rho, 0.0, m_f), 0.0).m_f == pytest.approx(0.0, abs=1e-18)


def test_a_million_points_at_once_and_their_slope():
    law = Turnover()
    rho, c, m_f, signal = np.random.default_rng(2).uniform(0.1, 2.0, (4, 1_000_000))
    rates = jax.jit(lambda has, signal: law.rates(has, signal))(Densities(rho, c, m_f), signal)
    one = law.rates(Densities(rho[7], c[7], m_f[7]), signal[7])
    np.testing.assert_allclose([column[7] for column in rates], one, rtol=1e-12, atol=1e-22)
    slope = jax.grad(lambda s: law.rates(Densities(0.5, 0.2, 1.5), s).m_f)(0.3)
    assert slope == pytest.approx(0.002 * H * 0.5 / (law.K_f_rho + 1.5))


def test_traction_counts_beyond_its_threshold():
    law = TractionSignal(2.0, 1.0)
    np.testing.assert_allclose(
        law.value(jnp.zeros((4, 0)), jnp.array([0.0, 1.0, 3.0, 1e9]), 0.0), [0, 0, 0.5, 1], rtol=1e-8
    )


def test_strain_is_felt_as_moreo_says():
    """At theta* the contractile part is p_max: 1 * 0.2 + 2, divided by itself plus K = 2.2."""
    law = StrainSignal(Moreo(1.0, 10.0, 2.0, 0.1, 0.4), 2.2)
    assert law.value(jnp.zeros(0), jnp.array(0.0), jnp.array(0.2)) == pytest.approx(0.5)
    assert law.value(jnp.zeros(0), jnp.array(0.0), jnp.array(-0.2)) == 0.0


def network(y_max=1.0):
    wiring = Wiring(("force", "YAP"), ("r1", "r2"), (parse_rule("=> force"), parse_rule("force => YAP")))
    both = np.ones(2)
    return HillNetwork(wiring, np.array([1.0, y_max]), 3600.0 * both, both, 1.4 * both, 0.5 * both)


def test_a_network_is_driven_by_the_traction():
    """force follows t / (K + t) = 0.5 within an hour; act(EC50) = 1/2 for YAP at rest, whose activity is the signal."""
    law = NetworkSignal(network(y_max=2.0), TractionSignal(3.0), "force", "YAP")
    at_rest = jnp.array([0.5, 1.0])
    np.testing.assert_allclose(law.rate(at_rest, jnp.array(3.0), 0.0), 0.0, atol=1e-18)
    np.testing.assert_allclose(law.rate(0.0 * at_rest, jnp.array(3.0), 0.0), [0.5 * H, 0.0], rtol=1e-12)
    assert law.value(at_rest, jnp.array(3.0), 0.0) == pytest.approx(0.5)


def test_names_that_a_network_does_not_have():
    with pytest.raises(InputError, match='input names the unknown input "YAP"; known: force'):
        NetworkSignal(network(), TractionSignal(), "YAP", "YAP")
    with pytest.raises(InputError, match='output names the unknown output "SMAD"; known: YAP, force'):
        NetworkSignal(network(), TractionSignal(), "force", "SMAD")
