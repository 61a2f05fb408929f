"""Laws computed outside JAX in bodies: the positions, history and heat of the same laws in JAX, with the same solver."""

from dataclasses import replace
from itertools import pairwise

import jax
import numpy as np
import pytest
from numpy_laws import ELASTIC, IN_JAX, KAPPA, MU, OUTSIDE, VISCOUS, neo_hookean
from test_march import cube

from cicatrix.core.errors import ConvergenceError
from cicatrix.core.units import acceleration_mm_s2
from cicatrix.materials.external import ExternalMaterial
from cicatrix.materials.material import Material
from cicatrix.mechanics import body as bodies
from cicatrix.mechanics.body_integration import Load, initial_state, integrate
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.point import control
from cicatrix.mechanics.point_integration import instants, integrate_all
from cicatrix.mechanics.problem import Problem
from cicatrix.numerics.linear import LinearSolver
from cicatrix.numerics.newton import NewtonReport, newton

pytestmark = pytest.mark.xdist_group("external")  # compiled once

GRAVITY = acceleration_mm_s2(np.array([0.0, -9.81, 0.0]))
DENSITY = 1e-5  # kg/mm^3: density g L / mu = 0.5
LOADS = [Load(t, GRAVITY) for t in (0.0, 1.0, 4.0)]


def heavy(body):
    return replace(body, density=DENSITY * np.ones_like(body.density))


@pytest.fixture(scope="module", params=["tetrahedra", "triangles"])
def make(request, rectangle, body_on):
    """A body of 10 mm that hangs from its upper side, of a law."""
    if request.param == "tetrahedra":
        return lambda law: heavy(cube(law, lambda points: points[:, 1] > 9.9))
    return lambda law: heavy(body_on(rectangle(10.0, 10.0, 3, 3), law, lambda p: p[1] > 9.9))


@pytest.fixture(scope="module")
def solid():
    return lambda law: heavy(cube(law, lambda points: points[:, 1] > 9.9))


def as_far_as(found, expected, X):
    """Equal to 1e-9 of the largest displacement, which is not small."""
    moved = np.abs(expected - X).max()
    assert moved > 0.5
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * moved)


def test_loaded_and_unloaded(make):
    outside, inside = make(ELASTIC), make(IN_JAX["elastic"])
    X = inside.discretization.space.positions
    assert outside.discretization.supports(False).n_unknowns == inside.discretization.supports(False).n_unknowns
    (x, _), (expected, _) = (Equilibrium(1e-12).loaded(body, X, GRAVITY) for body in (outside, inside))
    as_far_as(x, expected, X)
    for measure in (outside.energy_density, inside.energy_density):
        np.testing.assert_allclose(measure(X, x), inside.energy_density(X, expected), rtol=1e-8, atol=1e-10)
    as_far_as(*(Equilibrium(1e-12).unloaded(body, X, GRAVITY)[0] for body in (outside, inside)), X)


def test_march(make):
    """Viscous tissue sags on: positions, history and heat."""
    outside, inside = make(VISCOUS), make(IN_JAX["viscous"])
    X = inside.discretization.space.positions
    both = (integrate(body, X, LOADS, initial_state(body, X), Equilibrium(1e-12)) for body in (outside, inside))
    for found, expected in zip(*both, strict=True):
        as_far_as(found.x, expected.x, X)
        _, history = expected.state
        np.testing.assert_allclose(found.state[..., 0], history, rtol=0, atol=1e-9)
        assert found.heat == pytest.approx(expected.heat, rel=1e-8, abs=1e-12)
    assert found.heat > 0.0


def test_it_goes_on_to_the_same_bits(make):
    body = make(VISCOUS)
    X = body.discretization.space.positions
    solver = Equilibrium(1e-9)
    *_, last = integrate(body, X, LOADS[:2], initial_state(body, X), solver)
    kept = solver.state_arrays()
    (straight,) = integrate(body, X, LOADS[2:], last, solver)
    other = Equilibrium(1e-9)
    other.restore(body.discretization, kept)
    (again,) = integrate(body, X, LOADS[2:], last, other)
    assert (again.x == straight.x).all()
    assert (again.state == straight.state).all()


def norms_of_newton(body):
    """Residual over weight in Newton's method with exact linear solves, from near the answer."""
    X = body.discretization.space.positions
    solver, norms = LinearSolver(), []
    problem = Problem(body, X, X, GRAVITY, GRAVITY)

    def residual(values):
        r = problem.free_part(body.residual(X, problem.positions(values), GRAVITY))
        norms.append(np.linalg.norm(r) / problem.weight)
        return r

    def step(values, r):
        x = problem.positions(values)
        matrix, _ = body.linearised(X, x, body.volume_ratio(X, x), in_plane=problem.in_plane)
        return solver.solve(matrix, -r, 1e-12)

    x, _ = Equilibrium(1e-4).loaded(body, X, GRAVITY)
    start = problem.unknowns(
        np.where(np.isin(np.arange(len(X)), body.discretization.fixed_nodes)[:, None], X, x + 0.02 * np.sin(X))
    )
    newton(residual, step, start, tolerance=1e-11 * problem.weight, report=NewtonReport(), max_iterations=20)
    return norms


def is_quadratic(norms):
    """Once close, each residual is at most a constant times the square of the one before (theory)."""
    pairs = [(a, b) for a, b in pairwise(norms) if a < 0.1]
    return len(pairs) > 1 and all(b < 10 * a**2 + 1e-11 for a, b in pairs)


def softer(F, state, dt, *parameters):
    """The right stress with a tangent that is 1 % off."""
    answer = neo_hookean(F, state, dt, *parameters)
    return answer._replace(A=0.99 * answer.A)


def test_newton_is_quadratic_with_its_tangent_alone(make):
    assert is_quadratic(norms_of_newton(make(ELASTIC)))
    assert not is_quadratic(norms_of_newton(make(ExternalMaterial(softer, ELASTIC.parameters))))


@pytest.mark.parametrize("name", OUTSIDE)
def test_threads_and_pieces(solid, name, monkeypatch):
    """Pieces of the tangent on two threads, each with the parameters and history of its points: the bits of one thread."""
    monkeypatch.setattr(bodies, "PIECE", 5)
    body = solid(OUTSIDE[name])
    shape = body.density.shape
    mu = 2.0 + np.random.default_rng(1).uniform(0.0, 1.0, shape)
    body = replace(body, law=replace(body.law, parameters=(mu, *body.law.parameters[1:])))
    X = body.discretization.space.positions
    answers = []
    for threads in ("1", "2"):
        monkeypatch.setenv("CICATRIX_THREADS", threads)
        *_, last = integrate(body, X, LOADS, initial_state(body, X), Equilibrium(1e-9))
        answers.append(last.x)
    assert (answers[0] == answers[1]).all()
    assert np.abs(answers[0] - X).max() > 0.3


def test_new_numbers_compile_nothing(solid):
    body = solid(ELASTIC)
    X = body.discretization.space.positions
    Equilibrium().loaded(body, X, GRAVITY)
    before = bodies.compiled_variants()
    other = replace(body, law=ExternalMaterial(neo_hookean, (3.0, 30.0)))
    Equilibrium().loaded(other, X, GRAVITY)
    assert bodies.compiled_variants() == before


def breaking(F, state, dt, mu, kappa, limit):
    """The law above up to a stretch of the axes."""
    if (np.linalg.norm(F, axis=1) > limit[:, None]).any():
        raise ConvergenceError(f"stretched beyond {limit[0]}")
    return neo_hookean(F, state, dt, mu, kappa)


@pytest.mark.parametrize("threads", ["1", "2"])
def test_a_law_that_does_not_converge(solid, threads, monkeypatch):
    """The solver tries smaller steps; what it raises in the end is a ConvergenceError that has the law's own words in it."""
    monkeypatch.setenv("CICATRIX_THREADS", threads)
    body = solid(ExternalMaterial(breaking, (MU, KAPPA, 1.01)))
    with pytest.raises(ConvergenceError) as found:
        Equilibrium().loaded(body, body.discretization.space.positions, GRAVITY)
    assert any("stretched beyond 1.01" in line for line in [str(found.value), *found.value.history])


def test_a_mistake_in_a_law_comes_out_as_it_is(solid):
    def mistaken(F, state, dt):
        raise KeyError("props")

    body = solid(ExternalMaterial(mistaken))
    with pytest.raises(KeyError, match="props"):
        Equilibrium().loaded(body, body.discretization.space.positions, GRAVITY)


def test_a_skin_of_it(rectangle, body_on):
    """A skin's law is differentiated twice by JAX."""
    body = heavy(body_on(rectangle(10.0, 10.0, 3, 3), IN_JAX["elastic"], lambda p: p[1] > 9.9, thickness=0.5))
    X = body.discretization.space.positions
    found, expected = (
        Equilibrium(1e-12).loaded(replace(body, skin=law), X, GRAVITY)[0] for law in (ELASTIC, IN_JAX["elastic"])
    )
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected - X).max())


class Bare:
    """A material that has the methods of ``Material`` and no others."""

    def __init__(self, inner):
        self.inner = inner


for name in [name for name in vars(Material) if not name.startswith("_")]:
    setattr(Bare, name, lambda self, *arguments, name=name: getattr(self.inner, name)(*arguments))
jax.tree_util.register_pytree_node(Bare, lambda bare: ((bare.inner,), None), lambda _, parts: Bare(*parts))


def test_mechanics_asks_for_nothing_else(solid):
    """In bodies, in time, at points: a material with the methods of the protocol alone does."""
    law = Bare(IN_JAX["viscous"])
    assert isinstance(law, Material)
    body = solid(law)
    X = body.discretization.space.positions
    found, expected = (
        list(integrate(body, X, LOADS[:2], initial_state(body, X), Equilibrium(1e-9)))[-1].x
        for body in (body, solid(IN_JAX["viscous"]))
    )
    assert (found == expected).all()
    still = solid(Bare(IN_JAX["elastic"]))
    assert (still.energy_density(X, found) == solid(IN_JAX["elastic"]).energy_density(X, found)).all()
    Equilibrium(1e-6).unloaded(still, X, GRAVITY)
    asked = instants([0.0, 1.0], np.array([[1.0, 0, 0], [1.2, 0, 0]]), [0.0] * 2, 2)
    by = control(y="stress", incompressible=False)
    integrate_all(law, by, asked)
