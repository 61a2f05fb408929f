"""One point under prescribed stretches and stresses: closed forms, history, growth, derivatives by parameters."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from maxwell_fibre import MaxwellFibre

from cicatrix.core.errors import ConvergenceError
from cicatrix.core.law import param
from cicatrix.materials.active import Contraction
from cicatrix.materials.compose import Sum
from cicatrix.materials.growth import NaturalConfiguration
from cicatrix.materials.material import EnergyMaterial
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.mechanics import point_integration
from cicatrix.mechanics.point import control, history
from cicatrix.mechanics.point_integration import instants, integrate, integrate_all
from cicatrix.numerics.compiler import COMPILER
from cicatrix.numerics.small import solve
from cicatrix.numerics.tensors import det

pytestmark = pytest.mark.xdist_group("point")  # compiled once

MU = 2.0
TISSUE = NeoHookean(MU)
TAU = 10.0


class Swelling(EnergyMaterial):
    """Tissue that grows isotropically while it is stretched along x: F_g = g I, g' = (lambda_x / g - 1) / tau."""

    law: EnergyMaterial
    tau: float | Array = param("s", "tau", low=0.0, default=TAU)

    def energy(self, F, state=()):
        return state**3 * self.law.energy(F / state[..., None, None])

    def initial_state(self, shape):
        return jnp.ones(shape)

    def growth_tensor(self, state=()):
        return state[..., None, None] * jnp.eye(3)

    def volume_at_rest(self, state=()):
        return state**3

    def advance(self, F, state, dt):
        half = 0.5 * (state - dt / self.tau)  # g^2 - (g0 - dt/tau) g - dt/tau lambda = 0
        return half + jnp.sqrt(half**2 + dt / self.tau * F[..., 0, 0])


COMPILED = jax.jit(history, compiler_options=COMPILER)
SOLID = Sum((TISSUE, MaxwellFibre(5.0, TAU)))
GROWING = Swelling(TISSUE)


def ramp(*corners, n=10, shear=None, seconds=1.0):
    """Return linear loading from corner to corner, a second each."""
    return instants(seconds * np.arange(len(corners)), np.array(corners), shear or [0.0] * len(corners), n)


def integrated(law, by, asked):
    """Integrate over the path and return the points."""
    return integrate_all(law, by, asked).points


def test_small_systems_are_solved_whatever_the_pivots_and_units():
    A = np.random.default_rng(2).standard_normal((50, 4, 4)) * np.array([1e6, 1.0, 1e-6, 1.0])[:, None]
    A[:, 0, 0] = 0.0
    b = np.random.default_rng(3).standard_normal((50, 4))
    np.testing.assert_allclose(jax.jit(solve)(A, b), np.linalg.solve(A, b[..., None])[..., 0], rtol=1e-8)
    assert not np.isfinite(solve(np.zeros((2, 2)), np.ones(2))).any()


def test_uniaxial():
    """By hand: sigma = mu (l^2 - 1/l), lateral stretches l^-1/2."""
    points = integrated(TISSUE, control("stretch", "stress"), ramp([1.0, 0, 0], [2.0, 0, 0], [0.5, 0, 0]))
    l = points.stretch[:, 0]
    np.testing.assert_allclose(points.stress[:, 0, 0], MU * (l**2 - 1 / l), atol=1e-12)
    np.testing.assert_allclose(points.stretch[:, 1:], np.repeat(l[:, None] ** -0.5, 2, axis=1))
    np.testing.assert_allclose(points.stress[:, 1:, 1:], 0.0, atol=1e-12)
    np.testing.assert_allclose(points.energy, 0.5 * MU * (l**2 + 2 / l - 3), atol=1e-12)
    assert points.converged.all()


def test_equibiaxial():
    """By hand: sigma = mu (l^2 - l^-4)."""
    points = integrated(TISSUE, control(), ramp([1.0, 1.0, 0], [1.5, 1.5, 0]))
    l = points.stretch[:, 0]
    for axis in (0, 1):
        np.testing.assert_allclose(points.stress[:, axis, axis], MU * (l**2 - l**-4.0), atol=1e-12)


def test_simple_shear():
    """By hand: sigma_xy = mu gamma, sigma_x - sigma_y = mu gamma^2 (Rivlin)."""
    points = integrated(TISSUE, control(), ramp([1.0, 1.0, 0], [1.0, 1.0, 0], shear=[0.0, 0.8]))
    np.testing.assert_allclose(points.stress[:, 0, 1], MU * points.shear, atol=1e-12)
    np.testing.assert_allclose(points.stress[:, 0, 0] - points.stress[:, 1, 1], MU * points.shear**2, atol=1e-12)


def test_plane_strain():
    """By hand: incompressible and y held, sigma_x = mu (l^2 - l^-2); compressible, F = diag(l, 1, 1), J = l, I1 = l^2 + 2."""
    l = np.linspace(1.0, 1.4, 11)
    points = integrated(TISSUE, control(), ramp([1.0, 1.0, 0], [1.4, 1.0, 0]))
    np.testing.assert_allclose(points.stress[:, 0, 0], MU * (l**2 - l**-2), atol=1e-12)
    kappa = 7.0
    strain = control(z="stretch", incompressible=False)
    points = integrated(NeoHookean(MU, kappa), strain, ramp([1.0, 1.0, 1.0], [1.4, 1.0, 1.0]))
    by_hand = MU * l ** (-5 / 3) * (l**2 - (l**2 + 2) / 3) + kappa * (l - 1)
    np.testing.assert_allclose(points.stress[:, 0, 0], by_hand, atol=1e-12)


def test_plane_stress_of_compressible_tissue_tends_to_that_of_incompressible():
    """By hand: J - 1 = sigma / 3 kappa to first order, so the difference falls as 1 / kappa; less than 10 mu sigma / kappa."""
    exact = MU * (1.5**2 - 1 / 1.5)
    errors = []
    for kappa in (1e3, 1e4, 1e5):
        free = control("stretch", "stress", incompressible=False)
        last = integrated(NeoHookean(MU, kappa), free, ramp([1.0, 0, 0], [1.5, 0, 0]))
        assert last.converged.all()
        np.testing.assert_allclose(last.stress[-1, 2, 2], 0.0, atol=1e-9)
        errors.append(abs(last.stress[-1, 0, 0] - exact))
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 10.0, rtol=0.01)
    assert errors[-1] < 10 * MU * exact / 1e5


def test_stress_control_inverts_stretch_control():
    by_stretch = integrated(TISSUE, control(), ramp([1.0, 1.0, 0], [1.5, 0.9, 0], [0.8, 1.3, 0]))
    stress = jnp.diagonal(by_stretch.stress, axis1=1, axis2=2)
    asked = ramp([1.0, 1.0, 0], [1.5, 0.9, 0], [0.8, 1.3, 0])._replace(value=stress)
    by_stress = integrated(TISSUE, control("stress", "stress"), asked)
    np.testing.assert_allclose(by_stress.stretch, by_stretch.stretch, rtol=1e-10)


def test_contraction_shortens_free_tissue_and_pulls_on_held():
    """Fixed: sigma_x = T l^2 - T l_z^2 = 0 at F = I. Free along x, y fixed, by hand: (mu + T)(l^2 - l^-2) = 0, so l = 1."""
    active = Sum((TISSUE, Contraction(0.5)))
    held = integrated(active, control(), ramp([1.0, 1.0, 0], [1.2, 1.0, 0]))
    np.testing.assert_allclose(held.stress[-1, 0, 0], (MU + 0.5) * (1.44 - 1 / 1.44))
    np.testing.assert_allclose(held.stress[0], 0.0, atol=1e-12)


def test_natural_configuration_is_where_the_point_rests():
    """After growth by 1.2, 0.9, 1.1 and without stress, these are the stretches."""
    grown = np.diag([1.2, 0.9, 1.1])
    law = NaturalConfiguration(TISSUE, grown)
    point = integrated(law, control("stress", "stress"), ramp([0.0, 0, 0], [0.1, 0, 0], n=2))
    np.testing.assert_allclose(point.stretch[0], [1.2, 0.9, 1.1], rtol=1e-9)
    np.testing.assert_allclose(np.prod(point.stretch, axis=1), det(grown))


def relaxed(n, seconds=20.0):
    asked = instants([0.0, seconds], np.array([[1.3, 0, 0]] * 2), [0.0, 0.0], n)
    return asked, COMPILED(SOLID, control("stretch", "stress"), asked)


def exact_relaxation(l, t):
    """By hand, the Cauchy stress of the fibre is E ln(l) exp(-t / tau) at a constant stretch from t = 0 on."""
    return MU * (l**2 - 1 / l) + 5.0 * np.log(l) * np.exp(-t / TAU)


def test_relaxation_converges_with_first_order():
    errors = []
    for n in (100, 200):
        asked, points = relaxed(n)
        errors.append(np.abs(points.stress[:, 0, 0] - exact_relaxation(1.3, asked.time)).max())
    assert points.converged.all()
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 2.0, rtol=0.05)


def test_work_is_stored_or_dissipated_in_the_limit():
    """At constant stretch no work is done: the loss of energy equals the dissipation, to first order in dt."""
    misses = []
    for n in (100, 200):
        _, points = relaxed(n)
        misses.append(float(points.energy[0] - points.energy[-1] - points.dissipation[-1]))
        assert (np.diff(points.dissipation) >= 0.0).all()
    assert abs(misses[1]) < 0.02 * points.dissipation[-1]
    assert misses[0] / misses[1] == pytest.approx(2.0, rel=0.05)


def test_creep_of_small_strain():
    """By hand, standard linear solid of E_0 = 3 mu: eps = s / E_0 (1 - E / (E_0 + E) exp(-t / t_c)), t_c / tau = 1 + E / E_0."""
    s, E0, E = 1e-4, 3 * MU, 5.0
    asked = instants([0.0, 20.0], np.array([[s, 0, 0]] * 2), [0.0, 0.0], 40)
    result = integrate_all(SOLID, control("stress", "stress"), asked, tolerance=1e-5)
    exact = s / E0 * (1 - E / (E0 + E) * np.exp(-asked.time / (TAU * (E0 + E) / E0)))
    np.testing.assert_allclose(result.points.stretch[:, 0] - 1.0, exact, rtol=5e-3)


def test_steps_adapt_to_the_tolerance():
    asked = instants([0.0, 20.0], np.array([[1.3, 0, 0]] * 2), [0.0, 0.0], 10)
    sizes = []
    for tolerance in (1e-2, 1e-3):
        result = integrate_all(SOLID, control("stretch", "stress"), asked, tolerance)
        exact = exact_relaxation(1.3, asked.time)
        np.testing.assert_allclose(result.points.time, asked.time)
        assert np.abs(result.points.stress[:, 0, 0] - exact).max() < tolerance * exact.max()
        sizes.append(len(result.path.time))
    assert 5 < sizes[1] / sizes[0] < 20  # first order: ten times the steps for a tenth of the error
    np.testing.assert_array_equal(result.path.time[result.rows], asked.time)


def test_a_walk_goes_on_from_any_mark_to_the_bit():
    asked = ramp([1.0, 0, 0], [1.3, 0, 0], n=4, seconds=20.0)
    marks = list(integrate(SOLID, control("stretch", "stress"), asked, 1e-2))
    rest = list(integrate(SOLID, control("stretch", "stress"), asked, 1e-2, marks[2]))
    assert [mark.size for mark in rest] == [mark.size for mark in marks[3:]]
    np.testing.assert_array_equal(rest[-1].point.stress, marks[-1].point.stress)


def test_tissue_without_history_goes_in_whole_steps():
    result = integrate_all(TISSUE, control("stretch", "stress"), ramp([1.0, 0, 0], [3.0, 0, 0], n=3))
    assert len(result.path.time) == 4


def test_growth_keeps_the_elastic_volume():
    """By hand, F = F_e g; steady where lambda_x = g, with J = g^3; with both stretches at 1.3 it comes to rest there."""
    asked = instants([0.0, 200.0], np.array([[1.3, 1.3, 0]] * 2), [0.0, 0.0], 20)
    points = integrate_all(GROWING, control(), asked, 1e-3).points
    g = points.growth[:, 0, 0]
    np.testing.assert_allclose(np.prod(points.stretch, axis=1), g**3)
    assert (np.diff(g) > 0.0).all()
    np.testing.assert_allclose(points.stretch[-1], 1.3, rtol=1e-6)
    np.testing.assert_allclose(points.stress[-1], 0.0, atol=1e-5)
    # by hand, separable: tau g' = 1.3 / g - 1 gives t / tau = 1 - g - 1.3 ln((1.3 - g) / 0.3)
    early = g < 1.29
    off = asked.time[early] / TAU - (1 - g[early] - 1.3 * np.log((1.3 - g[early]) / 0.3))
    np.testing.assert_allclose(off * (1.3 / g[early] - 1), 0.0, atol=1e-3)  # as a difference of g


QUANTITIES = {
    "stress": lambda points: points.stress[-1, 0, 0],
    "thickness": lambda points: points.stretch[-1, 2],
    "heat": lambda points: points.dissipation[-1],
    "energy": lambda points: points.energy.mean(),
    "growth": lambda points: points.growth[-1, 1, 1],
}
ROADS = {
    "stretch": (control("stretch", "stress"), ramp([1.0, 0, 0], [1.4, 0.3, 0], n=20, seconds=20.0)),
    "stress": (control("stress", "stress"), ramp([0.0, 0, 0], [1.5, 0.5, 0], n=20, seconds=20.0)),
}


@pytest.mark.parametrize("road", ["stretch", pytest.param("stress", marks=pytest.mark.slow)])
def test_gradient_through_twenty_steps_is_that_by_differences(road):
    """Maxwell branch in growing tissue; the error of central differences is step^2 plus round-off / step."""
    law = Sum((Swelling(NeoHookean(MU), 30.0), MaxwellFibre(5.0, 8.0)))
    by, asked = ROADS[road]
    numbers, form = jax.tree.flatten(law)
    assert len(numbers) == 5

    @jax.jit
    def told(numbers):
        points = history(jax.tree.unflatten(form, numbers), by, asked)
        return jnp.stack([quantity(points) for quantity in QUANTITIES.values()])

    slopes = jax.jit(jax.jacrev(told), compiler_options=COMPILER)(numbers)
    for i, number in enumerate(numbers):
        step = 1e-4 * max(number, 1.0)
        ends = [told([*numbers[:i], number + by, *numbers[i + 1 :]]) for by in (-step, step)]
        np.testing.assert_allclose(slopes[i], (ends[1] - ends[0]) / (2 * step), rtol=1e-5, atol=1e-8)


def test_gradient_along_the_path_of_a_walk():
    """By hand, the relaxed uniaxial stress is linear in mu with the factor l^2 - 1/l."""
    by = control("stretch", "stress")
    asked = ramp([1.0, 0, 0], [1.4, 0, 0], n=3, seconds=5.0)
    result = integrate_all(SOLID, by, asked, 1e-2)

    @jax.jit
    def last(law):
        points = history(law, by, result.path)
        return points.stress[result.rows[-1], 0, 0]

    value, slopes = jax.value_and_grad(last)(SOLID)
    np.testing.assert_allclose(value, result.points.stress[-1, 0, 0])
    np.testing.assert_allclose(slopes.parts[0].mu, 1.4**2 - 1 / 1.4)


def test_many_points_at_once():
    mu = jnp.array([1.0, 2.0, 3.0])
    asked = ramp([1.0, 0, 0], [1.5, 0, 0], n=2)
    points = jax.jit(jax.vmap(lambda mu: history(NeoHookean(mu), control("stretch", "stress"), asked)))(mu)
    np.testing.assert_allclose(points.stress[:, -1, 0, 0], mu * (1.5**2 - 1 / 1.5))


def test_a_step_is_compiled_once_per_kind_of_law():
    point_integration._tried.clear_cache()
    for mu, words in ((1.0, ("stretch", "stress")), (3.0, ("stress", "stress"))):
        integrate_all(NeoHookean(mu), control(*words), ramp([1.0, 0, 0], [1.1, 0, 0], n=2))
    assert point_integration._tried._cache_size() == 1


class Yielding(EnergyMaterial):
    """Tissue whose stress has a maximum as a function of stretch: Psi = mu/2 (1 - exp(-(I1 - 3)))."""

    mu: float | Array = param("kPa", "mu", low=0.0, default=1.0)

    def energy(self, F, state=()):
        return 0.5 * self.mu * (1.0 - jnp.exp(-(jnp.sum(F * F, axis=(-2, -1)) - 3.0)))


def test_more_stress_than_the_law_bears_is_told():
    """By hand, its uniaxial stress is exp(3 - l^2 - 2/l) (l^2 - 1/l) kPa; the prescribed stress increases by 1 kPa/h."""
    l = np.linspace(1.0, 2.0, 100001)
    most = (np.exp(3 - l**2 - 2 / l) * (l**2 - 1 / l)).max()
    asked = ramp([0.0, 0, 0], [1.0, 0, 0], n=10, seconds=3600.0)
    with pytest.raises(ConvergenceError) as told:
        integrate_all(Yielding(), control("stress", "stress"), asked)
    words = str(told.value)
    time, stress = re.match(r"No state of the law was found at (\S+) h with sigma_x = (\S+) kPa", words).groups()
    assert float(time) == pytest.approx(most, abs=1e-4)
    assert float(stress) == pytest.approx(most, abs=1e-3)
    reached = float(re.search(r"last reached, at ([\d.]+) h", words)[1])
    assert float(time) - 1e-3 < reached <= float(time)
    assert "\n" not in words
