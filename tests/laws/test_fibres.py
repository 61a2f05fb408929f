"""Fibre distributions in direction and waviness, compared with closed forms and quadrature by another library."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from quick import compiled
from scipy.integrate import quad
from scipy.special import i0, i1
from scipy.stats import beta as beta_density

from cicatrix.core.errors import InputError
from cicatrix.materials.active import ActiveFibres
from cicatrix.materials.compose import Sum
from cicatrix.materials.fibres import FibreDistribution, FibreViscosity, exact_to, quadrature_error
from cicatrix.materials.material import EnergyMaterial
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.materials.orientation import Bingham, Fisher, Single, VonMises
from cicatrix.materials.waviness import Beta, Triangular, Uniform

pytestmark = pytest.mark.xdist_group("fibres")  # compiled once

EQUIBIAXIAL = np.diag([1.3, 1.3, 1.3**-2])


def second_moment(orientation):
    V, weight = orientation.directions()
    return np.einsum("n,ni,nj->ij", weight, np.broadcast_to(V, (weight.shape[-1], 3)), V)


@pytest.mark.parametrize("concentration", [0.0, 0.7, 2.0, 20.0])
def test_von_mises_moment(concentration):
    """The mean of cos 2 theta is I1(c) / I0(c), the definition of the modified Bessel functions."""
    order = i1(concentration) / i0(concentration)
    expected = np.diag([0.5 * (1 + order), 0.5 * (1 - order), 0.0])
    np.testing.assert_allclose(second_moment(VonMises(concentration)), expected, atol=1e-12)


def test_von_mises_turns_with_its_mean():
    turn = np.array([[np.cos(0.4), -np.sin(0.4), 0], [np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    expected = turn @ second_moment(VonMises(2.0)) @ turn.T
    np.testing.assert_allclose(second_moment(VonMises(2.0, 0.4)), expected, atol=1e-14)


@pytest.mark.parametrize("concentration", [0.5, 3.0, 15.0])
def test_fisher_moment(concentration):
    """Integral of x^2 c cosh(c x) / (2 sinh c) over -1 .. 1 by parts: 1 - 2 coth(c) / c + 2 / c^2."""
    axis = np.array([1.0, 2.0, -1.0])
    along = 1 - 2 / np.tanh(concentration) / concentration + 2 / concentration**2
    a = axis / np.linalg.norm(axis)
    expected = 0.5 * (1 - along) * np.eye(3) + 0.5 * (3 * along - 1) * np.outer(a, a)
    np.testing.assert_allclose(second_moment(Fisher(concentration, (1.0, 2.0, -1.0))), expected, atol=1e-9)


def test_bingham_moment():
    """Two equal concentrations are symmetric about the third axis: one integral over x = cos, by QUADPACK."""
    whole = quad(lambda x: np.exp(4.0 * (1 - x * x)), 0, 1)[0]
    third = quad(lambda x: x * x * np.exp(4.0 * (1 - x * x)), 0, 1)[0] / whole
    expected = np.diag([0.5 * (1 - third), 0.5 * (1 - third), third])
    np.testing.assert_allclose(second_moment(Bingham(4.0, 4.0)), expected, atol=1e-10)
    np.testing.assert_allclose(second_moment(Bingham(0.0, 0.0)), np.eye(3) / 3, atol=1e-12)


DENSITIES = {
    "uniform": (Uniform(1.05, 1.4), lambda w: 1 / 0.35),
    "triangular": (Triangular(1.05, 1.4), lambda w: (0.175 - abs(w - 1.225)) / 0.175**2),
    "beta": (Beta(1.05, 1.4, 1.5, 2.7), lambda w: beta_density.pdf((w - 1.05) / 0.35, 1.5, 2.7) / 0.35),
    "one-sided beta": (Beta(1.05, 1.4, 1.0, 3.0), lambda w: beta_density.pdf((w - 1.05) / 0.35, 1.0, 3.0) / 0.35),
}


@pytest.mark.parametrize("name", DENSITIES)
@pytest.mark.parametrize("stretch", [0.9, 1.05, 1.07, 1.2, 1.225, 1.3, 1.39, 1.4, 2.0])
def test_recruitment(name, stretch):
    """Moments below, inside and above the support agree with QUADPACK."""
    waviness, density = DENSITIES[name]
    end = min(max(stretch, 1.05), 1.4)
    for found, k in zip(waviness.recruited(np.array([stretch])), (0, 1, -2), strict=True):
        pieces = ((1.05, min(end, 1.225)), (1.225, max(end, 1.225)))
        parts = [quad(lambda w, k: density(w) * w**k, *ends, args=(k,))[0] for ends in pieces]
        assert float(found[0]) == pytest.approx(sum(parts), abs=1e-8)


@pytest.mark.parametrize("name", DENSITIES)
def test_points_of_waviness(name):
    """Gauss points integrate w^-2 exactly."""
    waviness, density = DENSITIES[name]
    at, weight = waviness.points(8)
    expected = sum(quad(lambda w: density(w) / w**2, *ends)[0] for ends in ((1.05, 1.225), (1.225, 1.4)))
    assert float((weight / at**2).sum()) == pytest.approx(expected, rel=1e-8)
    assert float(weight.sum()) == pytest.approx(1.0, rel=1e-12)


def stress(law, F):
    return np.asarray(law.stress(F, law.initial_state(F.shape[:-2])))


def test_equibiaxial_stretch():
    """All fibres of the plane have F V = l V: P = mu_f (l - l^-2) times the second moment of their directions."""
    law, order = FibreDistribution(2.0, VonMises(1.5)), i1(1.5) / i0(1.5)
    pull = 2.0 * (1.3 - 1.3**-2)
    np.testing.assert_allclose(
        stress(law, EQUIBIAXIAL), pull * np.diag([0.5 * (1 + order), 0.5 * (1 - order), 0]), atol=1e-12
    )


def test_waviness_beyond_its_support_is_neo_hookean_like():
    """If all are straight: dPsi/dl = mu_f (l E[w^-2] - E[w] / l^2); uniform on 1 to 1.4: E[w^-2] = 1/1.4, E[w] = 1.2."""
    law = FibreDistribution(2.0, Single(0.0), Uniform(1.0, 1.4))
    assert stress(law, np.diag([1.6, 1.0, 1.0]))[0, 0] == pytest.approx(2.0 * (1.6 / 1.4 - 1.2 / 1.6**2), rel=1e-13)


def test_slack_fibres_bear_nothing():
    law = FibreDistribution(2.0, VonMises(1.0), Uniform(1.2, 1.4), FibreViscosity(1.0, 5.0))
    assert (stress(law, np.diag([1.15, 1.1, 0.8])) == 0).all()
    assert (stress(FibreDistribution(2.0, Single(0.0)), np.diag([0.8, 1.0, 1.0])) == 0).all()


STRAIGHT = FibreDistribution(2.0, Single(0.0), None, FibreViscosity(0.5, 10.0))
step = compiled(lambda law, F, state, dt: law.response(F, state, dt))
lost = compiled(lambda law, F, before, after, dt: law.dissipated(F, before, after, dt))


def relaxed(law, F, times):
    """Return tension along x after each time at constant F, from the initial state in n steps, and the dissipated energy."""
    state, pulls, heat = law.initial_state(()), [], 0.0
    for dt in np.diff(times, prepend=0.0):
        answer = step(law, F, state, dt)
        heat += float(lost(law, F, state, answer.state, dt))
        state = answer.state
        pulls.append(float(answer.P[0, 0]))
    return np.array(pulls), heat


def test_moduli_and_relaxation_of_small_strain():
    """Instantaneous 3 mu_f (1 + beta), long-time 3 mu_f, and each backward Euler step of the branch divides by 1 + dt / t_r."""
    F = np.diag([1.0 + 1e-6, 1.0, 1.0])
    times = np.array([0.0, 2.5, 5.0, 7.5, 1e6])
    n = np.array([0, 1, 2, 3])
    expected = 3e-6 * 2.0 * np.append(1 + 0.5 * (1 + 0.25) ** -n, 1.0)
    np.testing.assert_allclose(relaxed(STRAIGHT, F, times)[0], expected, rtol=1e-5)


def test_relaxation_is_first_order_in_the_step():
    """Compare with exp(-t / t_r) at t = t_r for small strain."""
    F = np.diag([1.0 + 1e-6, 1.0, 1.0])
    exact = 6e-6 * (1 + 0.5 * np.exp(-1.0))
    errors = [abs(relaxed(STRAIGHT, F, np.linspace(0, 10, n + 1))[0][-1] - exact) for n in (8, 16, 32)]
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.1)


def test_all_that_the_branch_stored_becomes_heat():
    """Held at 1.3, the dissipation tends to beta mu_f / 2 (1.3^2 + 2/1.3 - 3) from below, to first order in the step."""
    stored = 0.5 * 2.0 / 2 * (1.3**2 + 2 / 1.3 - 3)
    errors = [
        relaxed(STRAIGHT, np.diag([1.3, 1.0, 1.0]), np.linspace(0, 150, n + 1))[1] / stored - 1 for n in (150, 300)
    ]
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)
    assert abs(errors[1]) < 0.05


def test_any_step_is_stable():
    F = np.diag([1.5, 1.0, 1.0])
    pull, _ = relaxed(STRAIGHT, F, np.array([1e12]))
    assert pull[0] == pytest.approx(2.0 * (1.5 - 1.5**-2), rel=1e-9)


def test_quadrature_error_can_be_asked_for():
    law = FibreDistribution(2.0, VonMises(8.0, n_angles=4), Uniform(1.0, 1.4))
    F = np.diag([1.3, 1.1, 0.7])
    fine = exact_to(law, 1e-6, F)
    assert quadrature_error(law, F) > 1e-3
    assert quadrature_error(fine, F) <= 1e-6
    assert fine.orientation.n_angles <= 1024
    with pytest.raises(InputError, match=r"VonMises.n_angles \(n\) must lie in \[2, 4096\]"):
        exact_to(FibreDistribution(2.0, VonMises(8.0, n_angles=1024), Uniform(1.0, 1.4)), 1e-300, F)


def test_quadrature_error_is_that_of_waviness_too():
    """With one direction only waviness is integrated: compare with the elastic closed form, which the branch equals at once."""
    F = np.stack([np.diag([x, x**-0.5, x**-0.5]) for x in (1.1, 1.2, 1.35)])
    elastic = FibreDistribution(2.0, Single(0.0), Uniform(1.0, 1.4))
    exact = np.asarray(elastic.stress(F))
    coarse = replace(elastic, viscous=FibreViscosity(1.0, 1.0, 3))
    branch = np.asarray(coarse.stress(F, coarse.initial_state((3,)))) - exact
    true = np.abs(branch - exact).max() / (2.0 * np.abs(exact).max())
    assert true > 1e-3
    assert quadrature_error(coarse, F) == pytest.approx(true, rel=0.3)
    assert quadrature_error(exact_to(coarse, 1e-4, F), F) <= 1e-4


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Uniform(0.9, 1.4), r"Uniform.low \(lambda_1\) must lie in \[1, inf\]; got 0.9\.$"),
        (lambda: Triangular(1.4, 1.2), r"Triangular.high must be above low; got low = 1.4, high = 1.2"),
        (lambda: Beta(1.0, 1.4, 0.5, 1.0), r"Beta.p \(p\) must lie in \[1, 50\]"),
        (lambda: VonMises(-1.0), r"VonMises.concentration \(c\) must lie in"),
        (lambda: Fisher(1.0, (0.0, 0.0, 0.0)), r"Fisher.axis must be three numbers that are not all 0"),
    ],
)
def test_bad_parameters_are_named(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()


@pytest.mark.parametrize(
    "law",
    [
        FibreDistribution(2.0, VonMises(2.0, 0.3), Uniform(1.0, 1.4)),
        FibreDistribution(2.0, Fisher(3.0, n_heights=3)),
        FibreDistribution(np.array([2.0, 1.0, 3.0]), VonMises(np.array([0.0, 1.0, 5.0]), np.array([0.1, 0.2, 0.3]), 8)),
        Sum((NeoHookean(1.0, 5.0), FibreDistribution(2.0, VonMises(2.0), Beta(1.0, 1.4)))),
        ActiveFibres(0.4, VonMises(2.0)),
    ],
    ids=["uniform waviness", "in space", "one number per point", "in a sum", "active"],
)
def test_response_by_moments_is_the_derived_one(law):
    """Compare both for elastic fibres in the initial state, some of them slack."""
    F = np.eye(3) + 0.3 * np.random.default_rng(5).uniform(-1, 1, (3, 3, 3))

    @compiled
    def both(law):
        state = law.initial_state((3,))
        return law.response(F, state, 1.0), EnergyMaterial.response(law, F, state, 1.0)

    by_moments, derived = both(law)
    for found, expected in zip(jax.tree.leaves(by_moments), jax.tree.leaves(derived), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
