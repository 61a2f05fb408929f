"""Materials computed outside JAX: wrong answers are found, errors come out as raised, gradients that do not exist are refused."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest
import test_laws as shared
from numpy_laws import ELASTIC, IN_JAX, KAPPA, MU, OUTSIDE, VISCOUS, neo_hookean, standard_solid
from quick import compiled

from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.materials.active import Contraction
from cicatrix.materials.compose import Sum
from cicatrix.materials.external import Answer, ExternalMaterial
from cicatrix.materials.growth import NaturalConfiguration
from cicatrix.mechanics.point import control, history
from cicatrix.mechanics.point_integration import instants
from cicatrix.numerics.host import own_exceptions

F = shared.F
respond = compiled(lambda law, F, state, dt: law.response(F, state, dt))


@pytest.mark.parametrize("name", OUTSIDE)
def test_the_same_numbers_as_in_jax(name):
    outside, inside = OUTSIDE[name], IN_JAX[name]
    found = respond(outside, F, respond(outside, shared.EARLIER, outside.initial_state((5,)), 1.0).state, 2.0)
    expected = respond(inside, F, respond(inside, shared.EARLIER, inside.initial_state((5,)), 1.0).state, 2.0)
    shared.close(found.P, expected.P, 1e-13)
    shared.close(found.A, expected.A, 1e-13)
    for one, other in zip(outside.moduli_at_rest((5,)), inside.moduli_at_rest((5,)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13)


def swollen(F, state, dt, mu, kappa):
    """The law above of tissue that is free of stress at F = 1.2 I."""
    energy, P, A, *_ = neo_hookean(F / 1.2, state, dt, mu, kappa)
    return Answer(1.2**3 * energy, 1.2**2 * P, 1.2 * A)


def test_moduli_at_rest_are_those_of_the_swollen_state():
    outside = ExternalMaterial(swollen, (MU, KAPPA), rest_volume=1.2**3)
    inside = NaturalConfiguration(IN_JAX["elastic"], 1.2 * np.eye(3))
    np.testing.assert_allclose(outside.volume_at_rest(), inside.volume_at_rest(), rtol=1e-15)
    np.testing.assert_allclose(outside.moduli_at_rest(), inside.moduli_at_rest(), rtol=1e-12)


def stiffer(F, state, dt, *parameters):
    """A tangent with one entry, and its mirror image, 0.1 % off."""
    answer = standard_solid(F, state, dt, *parameters)
    A = answer.A.copy()
    A[:, 0, 1, 0, 1] *= 1.001
    return answer._replace(A=A)


def heavier(F, state, dt, *parameters):
    """A stress that is 0.1 % too large, with its own tangent."""
    answer = neo_hookean(F, state, dt, *parameters)
    return answer._replace(P=1.001 * answer.P, A=1.001 * answer.A)


@pytest.mark.parametrize(
    ("law", "check"),
    [
        (ExternalMaterial(stiffer, VISCOUS.parameters, (0.0,)), shared.test_tangent_is_the_derivative_of_stress),
        (ExternalMaterial(heavier, (MU, KAPPA)), shared.test_stress_is_the_derivative_of_energy),
    ],
)
def test_wrong_answers_do_not_pass_the_list_of_laws(law, check):
    case = SimpleNamespace(step=1e-3)
    check(case, shared.Compiled(VISCOUS if law.initial_history else ELASTIC))
    with pytest.raises(AssertionError):
        check(case, shared.Compiled(law))


@pytest.mark.parametrize(
    ("outside", "inside"),
    [
        (Sum((ELASTIC, Contraction(0.3))), Sum((IN_JAX["elastic"], Contraction(0.3)))),
        (Sum((Contraction(0.3), VISCOUS)), Sum((Contraction(0.3), IN_JAX["viscous"]))),
        (NaturalConfiguration(ELASTIC, shared.GROWN), NaturalConfiguration(IN_JAX["elastic"], shared.GROWN)),
        (NaturalConfiguration(VISCOUS, shared.GROWN), NaturalConfiguration(IN_JAX["viscous"], shared.GROWN)),
    ],
)
def test_laws_made_of_it(outside, inside):
    found = respond(outside, F, outside.initial_state((5,)), 2.0)
    expected = respond(inside, F, inside.initial_state((5,)), 2.0)
    shared.close(found.P, expected.P, 1e-13)
    shared.close(found.A, expected.A, 1e-13)
    shared.close(outside.stress(F, found.state), inside.stress(F, expected.state), 1e-12)


led = compiled(lambda law, asked: history(law, control(y="stress", incompressible=False), asked))


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_material_point(name):
    """Stretched along x, free of stress along y and z: the history of the law in JAX."""
    asked = instants([0.0, 1.0, 3.0], np.array([[1.0, 0, 0], [1.3, 0, 0], [1.3, 0, 0]]), [0.0] * 3, 4)
    found, expected = (led(laws[name], asked) for laws in (OUTSIDE, IN_JAX))
    assert np.asarray(found.converged).all()
    for field in ("stretch", "stress", "energy", "dissipation"):
        np.testing.assert_allclose(getattr(found, field), getattr(expected, field), rtol=0, atol=1e-12)


def test_derivatives_of_the_energy_by_the_deformation():
    """Once is the stress, twice the tangent; no further."""
    np.testing.assert_allclose(jax.grad(ELASTIC.energy)(F[0]), ELASTIC.stress(F[0]), rtol=1e-14)
    np.testing.assert_allclose(jax.hessian(ELASTIC.energy)(F[0]), ELASTIC.response(F[0]).A, rtol=1e-12, atol=1e-12)


def test_points_under_vmap_are_asked_together():
    sizes = []

    def counted(F, state, dt, *parameters):
        sizes.append(len(F))
        return neo_hookean(F, state, dt, *parameters)

    law = ExternalMaterial(counted, (MU, KAPPA))
    P = jax.block_until_ready(jax.vmap(law.stress)(F))
    np.testing.assert_allclose(P, ELASTIC.stress(F), rtol=1e-14)
    assert sizes == [5]


@pytest.mark.parametrize(
    "by",
    [
        lambda mu: ExternalMaterial(neo_hookean, (mu, KAPPA)).energy(F).sum(),
        lambda mu: ExternalMaterial(neo_hookean, (mu, KAPPA)).stress(F).sum(),
        lambda mu: VISCOUS.stress(F, mu * np.ones((5, 1))).sum(),
        lambda mu: VISCOUS.advance(mu * F, np.zeros((5, 1)), 1.0).sum(),
    ],
)
def test_derivatives_that_it_does_not_have_are_refused(by):
    assert np.isfinite(by(2.0))
    with pytest.raises(InputError, match="ExternalMaterial has"):
        jax.grad(by)(2.0)


def test_its_history_has_no_derivative_by_the_deformation():
    """Nothing may pass for zero."""
    rate = jax.jvp(lambda F: VISCOUS.end_of_step(F, np.zeros((5, 1)), 1.0), (F,), (F,))[1]
    assert np.isfinite(rate[0]).all()
    assert np.isnan(rate[1]).all()


def test_other_numbers_compile_nothing():
    step = jax.jit(lambda law, F: law.response(F).P)
    soft, stiff = (step(ExternalMaterial(neo_hookean, (mu, KAPPA)), F) for mu in (1.0, 3.0))
    assert step._cache_size() == 1
    assert np.abs(np.asarray(stiff) - np.asarray(soft)).max() > 0.1


@pytest.mark.parametrize("error", [ConvergenceError("no state at point 3", ["tried twice"]), ValueError("a mistake")])
def test_what_it_raises_comes_out_as_it_is(error):
    def fails(F, state, dt):
        raise error

    with pytest.raises(type(error)) as found, own_exceptions():
        np.asarray(ExternalMaterial(fails).stress(F))
    assert found.value is error
    assert found.traceback[-1].name == "fails"


def test_a_wrong_shape_is_named():
    def flat(F, state, dt):
        return Answer(np.zeros(len(F)), F.reshape(-1, 9), np.zeros((*F.shape, 3, 3)))

    with pytest.raises(InputError, match=r"P of shape \(5, 3, 3\); got \(5, 9\)"), own_exceptions():
        np.asarray(ExternalMaterial(flat).stress(F))


def test_what_cannot_be_hashed_is_refused():
    with pytest.raises(InputError, match="hashable"):
        ExternalMaterial(neo_hookean, (MU, KAPPA), initial_history=[0.0])


def test_it_gets_arrays_of_its_own():
    def greedy(F, state, dt, *parameters):
        answer = neo_hookean(F, state, dt, *parameters)
        F[:] = np.nan
        return answer

    given = F.copy()
    P = np.asarray(compiled(lambda law, F: law.stress(F) + 0.0 * F)(ExternalMaterial(greedy, (MU, KAPPA)), given))
    np.testing.assert_allclose(P, ELASTIC.stress(F), rtol=1e-14)
    assert (given == F).all()
