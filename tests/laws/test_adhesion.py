"""Adhesion of a cell, Eqs (20)-(26) of the review: rates, energies, substrates, feedback."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cicatrix.biology.adhesion import Adhesion, relax_bound_fraction, steady_state
from cicatrix.biology.bond import Bell, CatchBond
from cicatrix.biology.contraction import ConstantForce, Feedback
from cicatrix.biology.substrate import Column, ExponentialFibre, LinearSubstrate, TabulatedCurve
from cicatrix.biology.viscoelastic_substrate import StandardLinearSolid
from cicatrix.core.errors import InputError
from cicatrix.numerics.roots import rising_root

pulled = jax.jit(lambda substrate, contraction, stretch, time: substrate.pulled(contraction, stretch, time))
BELL = Bell(0.01, 0.012)
COLLAGEN = Column(ExponentialFibre(0.004 * 17.599164683e6, 20.818113705), 0.017, 0.1)
CAO = Feedback(f0=100.0, beta=0.5, k_a=2e4, k_N=4e3)
STRETCH = np.array([1.0, 1.02, 1.05, 1.1])


def on_spring(k, force=7.0, energy="work", bond=BELL):
    return Adhesion(bond, LinearSubstrate(k), ConstantForce(force), 400.0, energy)


def test_unloaded_bonds():
    """The bound fraction is 0.01 / 0.022 = 5/11, also on a rigid substrate."""
    assert float(steady_state(on_spring(1e4, force=0.0), 1.0).steady) == pytest.approx(5 / 11, rel=1e-14)
    assert float(steady_state(on_spring(1e15), 1.0).steady) == pytest.approx(5 / 11, rel=1e-10)


@pytest.mark.parametrize(("energy", "share"), [("work", 1.0), ("stored", 0.5)])
def test_spring(energy, share):
    """By hand: f^2/k as worked and f^2/2k as stored, k_off = 0.012 exp(dE / kT), t_a = f phi rho_i, 1 pN/um^2 = 1 Pa."""
    at = steady_state(on_spring(2e3, energy=energy), np.array([0.9, 1.2]))
    dE = share * 49.0 / 2e3
    k_off = 0.012 * np.exp(dE / 4.28317e-3)
    np.testing.assert_allclose(at.energy, dE, rtol=1e-14)
    np.testing.assert_allclose(at.k_off, k_off, rtol=1e-13)
    np.testing.assert_allclose(at.steady, 0.01 / (0.01 + k_off), rtol=1e-13)
    np.testing.assert_allclose(at.traction, 7.0 * 400.0 * 1e-3 * 0.01 / (0.01 + k_off), rtol=1e-13)


def test_a_step_has_the_odes_fixed_point_as_it_shrinks():
    """By hand, P_on / (P_on + P_off) differs from the fixed point of the ODE by phi (1 - phi) (k_off - k_on) dt / 2."""
    law = on_spring(2e4)
    at = steady_state(law, 1.0)
    for dt in (1e-1, 1e-3):
        on, off = law.step_probabilities(dt, at.k_off)
        assert float(on) == pytest.approx(1 - np.exp(-0.01 * dt), rel=1e-9)
        shift = 0.5 * dt * float(at.steady * (1 - at.steady) * (at.k_off - 0.01))
        assert float(on / (on + off) - at.steady) == pytest.approx(shift, rel=1e-3)


def test_time_course():
    """Rate and solution of Eq. (24) agree, for a long and a short time."""
    law = on_spring(2e3)
    at = steady_state(law, 1.0)
    assert float(relax_bound_fraction(0.9, 0.01, at.k_off, 1e9)) == pytest.approx(float(at.steady), rel=1e-14)
    slope = jax.grad(lambda t: relax_bound_fraction(0.9, 0.01, at.k_off, t))(0.0)
    assert float(slope) == pytest.approx(float(law.rate(0.9, 1.0)), rel=1e-14)
    assert float(law.rate(at.steady, 1.0)) == pytest.approx(0.0, abs=1e-17)
    half = relax_bound_fraction(relax_bound_fraction(0.1, 0.01, at.k_off, 3.0), 0.01, at.k_off, 4.0)
    assert float(half) == pytest.approx(float(relax_bound_fraction(0.1, 0.01, at.k_off, 7.0)), rel=1e-14)


def test_fibre_is_pulled_by_the_force():
    """A_0 [P(pulled stretch) - P(stretch)] = f, and both energies agree with their definitions."""
    pull = pulled(COLLAGEN, ConstantForce(200.0), STRETCH, 0.0)
    to = STRETCH + np.asarray(pull.displacement) / 0.1
    curve = COLLAGEN.curve
    np.testing.assert_allclose(0.017 * (curve.stress(to) - curve.stress(STRETCH)), 200.0, rtol=1e-9)
    np.testing.assert_allclose(pull.work, 200.0 * np.asarray(pull.displacement), rtol=1e-14)
    stored = 0.0017 * (curve.energy(to) - curve.energy(STRETCH) - curve.stress(STRETCH) * (to - STRETCH))
    np.testing.assert_allclose(pull.stored, stored, rtol=1e-7)
    np.testing.assert_allclose(curve.stress(STRETCH), jax.vmap(jax.grad(curve.energy))(STRETCH), rtol=1e-12)
    assert (np.asarray(pull.stored) < 0.5 * np.asarray(pull.work)).all()  # the curve stiffens
    k1, k2 = 0.004 * 17.599164683e6, 20.818113705
    assert float(pull.stiffness[0]) == pytest.approx(0.017 * 2 * k1 * k2 / 0.1, rel=1e-13)  # P'(1) = 2 k1 k2


def test_a_weak_pull_at_a_fibre_is_that_at_a_spring():
    k = COLLAGEN.stiffness(STRETCH)
    fibre = pulled(COLLAGEN, ConstantForce(1e-3), STRETCH, 0.0)
    spring = LinearSubstrate(k).pulled(ConstantForce(1e-3), STRETCH, 0.0)
    np.testing.assert_allclose(fibre.work, spring.work, rtol=1e-5)
    np.testing.assert_allclose(fibre.stored, spring.stored, rtol=1e-5)


def test_prestress_is_no_energy_of_a_bond():
    """As printed, the work of the prestress would be 500 kT at a stretch of 1.1; that of the increment falls with stiffness."""
    pull = pulled(COLLAGEN, ConstantForce(7.0), STRETCH, 0.0)
    to = STRETCH[-1] + pull.displacement[-1] / 0.1
    printed = 0.0017 * float(COLLAGEN.curve.energy(to) - COLLAGEN.curve.energy(STRETCH[-1]))
    assert printed > 10 * float(pull.stored[-1])
    assert (np.diff(pull.stored) < 0).all()


def test_yielding_and_stiff_curves_are_followed():
    """By hand: x^3 = 8 from a distant initial guess; a saturating stress is found; NaN if the force is never reached."""

    @jax.jit
    def roots():
        cubic = rising_root(lambda x: x**3 - 8.0, jnp.array(0.0), jnp.array(50.0))
        saturating = rising_root(lambda x: jnp.tanh(x) - jnp.array([0.5, 0.999, 1.5]), jnp.zeros(3), jnp.full(3, 0.1))
        steep = rising_root(lambda x: jnp.expm1(500.0 * x) - jnp.array([1e-3, 1e9]), jnp.zeros(2), jnp.full(2, 3.0))
        return cubic, saturating, steep

    cubic, found, steep = roots()
    assert float(cubic) == pytest.approx(2.0, rel=1e-14)
    np.testing.assert_allclose(found[:2], np.arctanh([0.5, 0.999]), rtol=1e-12)
    assert np.isnan(found[2])
    np.testing.assert_allclose(steep, np.log1p([1e-3, 1e9]) / 500.0, rtol=1e-12)


def test_root_has_three_derivatives():
    """By hand, for x = y^(1/3) at 8: 1/12, -1/144, 5/3456."""

    def root(y):
        return rising_root(lambda x: x**3 - y, jnp.array(0.0), jnp.array(1.0))

    def all_of(y):
        return root(y), jax.grad(root)(y), jax.grad(jax.grad(root))(y), jax.grad(jax.grad(jax.grad(root)))(y)

    np.testing.assert_allclose(jax.jit(all_of)(8.0), [2.0, 1 / 12, -1 / 144, 5 / 3456], rtol=1e-11)


def test_tabulated_curve():
    """Cubic interpolation reproduces a cubic and its slope to round-off, and is linear outside the table."""

    def cubic(x):
        return 3.0 * x + 5.0 * (x - 1.0) ** 3

    nodes = np.linspace(0.9, 1.4, 6)
    curve = TabulatedCurve(cubic(nodes), 3.0 + 15.0 * (nodes - 1.0) ** 2, 0.9, 1.4)
    x = np.linspace(0.9, 1.4, 41)
    stress = jax.jit(lambda x: curve.stress(x))
    np.testing.assert_allclose(stress(x), cubic(x), rtol=1e-13)
    slope = jax.jit(jax.vmap(jax.grad(lambda x: curve.stress(x))))
    np.testing.assert_allclose(slope(x), 3.0 + 15.0 * (x - 1.0) ** 2, rtol=1e-12)
    np.testing.assert_allclose(slope(np.array([0.5, 2.0])), [3.15, 5.4], rtol=1e-12)
    assert float(stress(1.6)) == pytest.approx(cubic(1.4) + 0.2 * 5.4)
    with pytest.raises(InputError, match="as many slopes as stresses"):
        TabulatedCurve(nodes, nodes[1:], 1.0, 2.0)


def test_feedback_limits():
    """Limits of Eq. (25): f0 / (1 - beta + k_a / k_N) = 100 / 5.5 on rigid, f0 k_eff / k_a = k_eff / 200 on soft substrates."""
    assert float(CAO.force(1e20)) == pytest.approx(100 / 5.5, rel=1e-12)
    assert float(CAO.force(1e-6)) == pytest.approx(5e-9, rel=1e-9)
    assert float(CAO.force(2e4)) == pytest.approx(100 / 6.5, rel=1e-14)  # k_a / k_eff = 1
    assert float(CAO.force(0.0)) == 0.0
    weak = Feedback(100.0, 0.0, 1e-9, 1e9)  # without mechanosensing: f0
    assert float(weak.force(5.0)) == pytest.approx(100.0, rel=1e-9)


def test_feedback_out_of_its_validity():
    """The denominator 1 - 2 + 0.5 + 100 / k is positive below k = 200."""
    far = Feedback(100.0, 2.0, 100.0, 200.0)
    far.check(np.array([50.0, 199.0]))
    with pytest.raises(
        InputError, match=r"must be positive; got -0.25 at k_eff = 400 pN/um \(beta 2, k_a 100, k_N 200"
    ):
        far.check(np.array([50.0, 400.0]))
    force = far.force(np.array([100.0, 400.0]))
    assert float(force[0]) == pytest.approx(200.0)  # 100 / (-1 + 1 + 0.5)
    assert np.isnan(force[1])


def test_bond_fraction_is_stationary_where_feedback_balances_stiffness():
    """f^2 / k is largest at k = k_a / (1 - beta + k_a / k_N), where f is half of its limit and rises with the root of k."""
    balance = 2e4 / 5.5

    def at(k):
        return Adhesion(BELL, LinearSubstrate(k), CAO, 400.0).steady_state(1.0)

    assert float(jax.jit(jax.grad(lambda k: at(k).steady))(balance)) == pytest.approx(0.0, abs=1e-15)
    assert float(at(balance).force) == pytest.approx(100 / 11, rel=1e-14)
    rise = jax.jit(jax.grad(lambda x: jnp.log(at(balance * jnp.exp(x)).traction)))(0.0)
    assert float(rise) == pytest.approx(0.5, rel=1e-12)


def test_solid_that_relaxes():
    """Creep under a constant force in closed form; work is f u."""
    solid, f = StandardLinearSolid(8058.0, 8482.0, 93638.0), 7.0
    t = np.array([0.0, 1.0, 10.0, 30.0, 1e4])
    pull = pulled(solid, ConstantForce(f), 1.0, t)
    tau = 93638.0 * (1 / 8058.0 + 1 / 8482.0)
    np.testing.assert_allclose(pull.displacement, f / 8058 * (1 - 8482 / 16540 * np.exp(-t / tau)), rtol=1e-12)
    np.testing.assert_allclose(pull.force, f, rtol=1e-12)
    np.testing.assert_allclose(pull.work, f * np.asarray(pull.displacement), rtol=1e-12)
    np.testing.assert_allclose(np.asarray(pull.stored)[[0, -1]], [49 / 2 / 16540, 49 / 2 / 8058], rtol=1e-12)


def test_maxwell_fluid_creeps_for_ever():
    pull = pulled(StandardLinearSolid(0.0, 100.0, 1000.0), ConstantForce(5.0), 1.0, np.array([0.0, 20.0]))
    np.testing.assert_allclose(pull.displacement, [0.05, 0.05 + 5.0 / 1000.0 * 20.0], rtol=1e-13)  # f/K + f t/eta
    np.testing.assert_allclose(pull.stored, 0.125, rtol=1e-12)  # of the spring alone


def test_feedback_on_a_solid_that_relaxes():
    """It starts and ends as on springs of the two stiffnesses, satisfies the dashpot, and the force uses k_eff = f / u."""
    solid = StandardLinearSolid(2e3, 6e3, 4e4)
    ends = pulled(solid, CAO, 1.0, np.array([0.0, 1e6]))
    np.testing.assert_allclose(ends.force, CAO.force(np.array([8e3, 2e3])), rtol=1e-10)
    np.testing.assert_allclose(ends.stiffness, [8e3, 2e3], rtol=1e-10)

    def dashpot(t):  # u_v = u - (f - K_l u) / K_a
        pull = pulled(solid, CAO, 1.0, t)
        return pull.displacement - (pull.force - 2e3 * pull.displacement) / 6e3

    now = pulled(solid, CAO, 1.0, 5.0)
    assert float(now.force) == pytest.approx(float(CAO.force(now.stiffness)), rel=1e-12)
    assert float(jax.jit(jax.grad(dashpot))(5.0)) == pytest.approx(
        float(now.force - 2e3 * now.displacement) / 4e4, rel=1e-10
    )


def test_catch_bond():
    """By hand: 2 e^-1 + 0.1 e^(1/2) at 5 pN; longest lifetime where 2/5 e^(-f/5) = 0.1/10 e^(f/10): f = ln 40 / 0.3."""
    bond = CatchBond(0.5, 2.0, 0.1, 5.0, 10.0)
    assert float(bond.k_off(5.0, 0.0)) == pytest.approx(2 * np.exp(-1) + 0.1 * np.exp(0.5))
    assert float(bond.strongest()) == pytest.approx(np.log(40) / 0.3)
    assert float(jax.grad(bond.k_off)(bond.strongest(), 0.0)) == pytest.approx(0.0, abs=1e-15)
    assert float(CatchBond(0.5, 0.0, 0.1, 5.0, 10.0).strongest()) == 0.0
    loose, held = (steady_state(on_spring(1e3, force=f, bond=bond), 1.0).steady for f in (0.0, 12.0))
    assert held > 2 * loose


STORED = pytest.param("fibre", "stored", marks=pytest.mark.slow)


@pytest.mark.parametrize(("substrate", "energy"), [("spring", "work"), ("fibre", "work"), ("solid", "stored"), STORED])
def test_derivatives_by_everything(substrate, energy, slope):
    made = {"spring": LinearSubstrate(5e3), "fibre": COLLAGEN, "solid": StandardLinearSolid(2e3, 6e3, 4e4)}[substrate]
    law = Adhesion(BELL, made, CAO, 400.0, energy)
    leaves, form = jax.tree.flatten((law, 1.03, 4.0))

    def traction(scales):
        law, stretch, time = jax.tree.unflatten(form, [leaf * s for leaf, s in zip(leaves, scales)])
        return law.steady_state(stretch, time).traction

    compiled, ones = jax.jit(traction), np.ones(len(leaves))
    gradient = jax.jit(jax.grad(traction))(ones)
    measured = [
        slope(lambda h, i=i: float(compiled(ones + h * np.eye(len(leaves))[i])), 1e-4) for i in range(len(ones))
    ]
    np.testing.assert_allclose(gradient, measured, rtol=1e-6, atol=1e-9)
    assert np.count_nonzero(np.abs(gradient) > 1e-6) >= 9 - (substrate == "spring")


def test_parameters_may_be_fields():
    """Parameters may have one value per point; the points do not affect each other."""
    law = Adhesion(Bell(np.array([0.01, 0.02]), 0.012), COLLAGEN, CAO, np.array([300.0, 500.0]))
    both = steady_state(law, np.array([1.02, 1.05]))
    for i, (k_on, stretch, density) in enumerate([(0.01, 1.02, 300.0), (0.02, 1.05, 500.0)]):
        alone = steady_state(Adhesion(Bell(k_on, 0.012), COLLAGEN, CAO, density), stretch)
        np.testing.assert_allclose([field[i] for field in both], [float(field) for field in alone], rtol=1e-12)


def test_what_is_refused():
    with pytest.raises(InputError, match=r"Bell.k_off0 \(k_off0\) must lie in \[1e-12, inf\] 1/s; got 0"):
        Bell(0.01, 0.0)
    with pytest.raises(InputError, match='must be "work" or "stored"; got "both"'):
        Adhesion(BELL, COLLAGEN, CAO, 400.0, "both")
    with pytest.raises(InputError, match=r"Column.area"):
        Column(COLLAGEN.curve, 0.0, 0.1)
