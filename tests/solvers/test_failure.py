"""Why no equilibrium is found: the load at which a column buckles, and the sentences that say what to change."""

import numpy as np
import pytest

from cicatrix.core.errors import ConvergenceError
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.failure import NoEquilibriumError, buckling_share, explanation, load_words
from cicatrix.mechanics.problem import Problem

LENGTH, WIDTH, DENSITY, YOUNG = 100.0, 6.0, 1e-6, 50.0


def column(rectangle, body_on, E=YOUNG, nu=0.0):
    """Return a column in plane strain that stands on its fixed end x = 0."""
    mesh = rectangle(LENGTH, WIDTH, 40, 2)
    return body_on(mesh, NeoHookean(*moduli_from_young(E, nu)), lambda p: p[0] < 1e-9, density=DENSITY)


def problem_of(body, gravity):
    X = body.discretization.space.positions
    return Problem(body, X, X, np.array([-gravity, 0.0, 0.0]), np.array([-gravity, 0.0, 0.0]))


@pytest.mark.parametrize("times", [1.0, 20.0])
def test_a_column_buckles_under_its_own_weight(rectangle, body_on, times):
    """Greenhill (1881): rho g A L^3 = 7.8373 E I; here A = width and I = width^3 / 12 per depth, E I without Poisson effect."""
    critical = 7.8373 * YOUNG * WIDTH**2 / 12.0 / (DENSITY * LENGTH**3)
    problem = problem_of(column(rectangle, body_on), times * critical)
    assert buckling_share(problem, problem.X, 0.0) == pytest.approx(1.0 / times, rel=0.02)


def test_what_does_not_buckle_is_not_said_to(rectangle, body_on):
    critical = 7.8373 * YOUNG * WIDTH**2 / 12.0 / (DENSITY * LENGTH**3)
    standing, hanging = (problem_of(column(rectangle, body_on), s * critical) for s in (0.5, -5.0))
    assert buckling_share(standing, standing.X, 0.0) is None
    assert buckling_share(hanging, hanging.X, 0.0) is None


def failure(body, gravity):
    with pytest.raises(NoEquilibriumError) as caught:
        Equilibrium().loaded(body, body.discretization.space.positions, np.array([gravity, 0.0, 0.0]))
    return caught.value


def test_a_column_that_collapses_says_at_which_load_and_keeps_its_last_stable_shape(rectangle, body_on):
    """A hundred times its critical weight folds the column onto itself: there is no stable shape without contact."""
    body = column(rectangle, body_on, E=YOUNG / 100.0)
    critical = 7.8373 * YOUNG * WIDTH**2 / 12.0 / (DENSITY * LENGTH**3)
    error = failure(body, -critical)
    assert "buckles under about 1 % of the load" in str(error)
    assert error.history
    assert 0.0 < error.share < 0.0101
    x, X = error.positions, body.discretization.space.positions
    found, _ = Equilibrium().loaded(body, X, np.array([-error.share * critical, 0.0, 0.0]))
    np.testing.assert_allclose(x, found, atol=1e-4)
    assert np.abs(x - X).max() > 1e-3


def test_a_ratio_too_close_to_one_half_is_named(rectangle, body_on):
    body = column(rectangle, body_on, E=0.5, nu=0.49999)
    assert str(failure(body, -1e4)) == "Poisson's ratio of 0.49999 is too close to 0.5. Give at most 0.499."


def test_an_unloaded_shape_that_does_not_exist_is_told_with_the_share_of_the_load(rectangle, body_on):
    """A column of soft tissue imaged upright: under so much weight nothing sags into a straight column."""
    body = column(rectangle, body_on, E=0.05)
    with pytest.raises(ConvergenceError, match=r"Beyond .* % of the load no unloaded shape was found") as caught:
        Equilibrium().unloaded(body, body.discretization.space.positions, np.array([-1e5, 0.0, 0.0]))
    assert "Give stiffer tissue" in str(caught.value)


@pytest.mark.parametrize("times", [0.99, 1.01])
def test_an_upright_column_beyond_its_critical_weight_is_no_solution(rectangle, body_on, times):
    """Stability is judged at the shape found: its tangent has no negative eigenvalue, or no shape is returned."""
    critical = 7.8373 * YOUNG * WIDTH**2 / 12.0 / (DENSITY * LENGTH**3)
    body = column(rectangle, body_on)
    X = body.discretization.space.positions
    try:
        x, _ = Equilibrium().loaded(body, X, np.array([-times * critical, 0.0, 0.0]))
    except NoEquilibriumError as error:
        assert times > 1.0
        x = error.positions
    matrix, _ = body.linearised(X, x, body.volume_ratio(X, x), in_plane=True)
    assert np.linalg.eigvalsh(matrix.toarray())[0] > 0.0


def test_what_is_stretched_does_not_buckle(rectangle, body_on):
    """Nor is a displacement called a load."""
    mesh = rectangle(LENGTH, WIDTH, 10, 1)
    body = body_on(mesh, NeoHookean(*moduli_from_young(YOUNG, 0.3)), lambda p: (p[0] < 1e-9) | (p[0] > LENGTH - 1e-9))
    X = body.discretization.space.positions
    problem = problem_of(body, 0.0)
    assert load_words(problem) == "prescribed displacement"
    stretched = X * [1.5, 1.0, 1.0]
    cause, remedy = explanation(problem, stretched, 0.1, None, ["found an unstable equilibrium"])
    assert cause == (
        "The body, which is stretched, loses its stability beyond 10 % of the prescribed displacement, "
        "and no stable shape was found."
    )
    assert remedy == "Stiffen the tissue, or reduce the prescribed displacement."
    squeezed, _ = explanation(problem, X * [0.8, 1.0, 1.0], 0.1, None, ["found an unstable equilibrium"])
    assert squeezed.startswith("The body buckles beyond 10 % of the prescribed displacement")


def test_what_smaller_steps_reach_is_the_solution(rectangle, body_on, monkeypatch):
    """Where the search for the last stable shape comes to the whole load, that shape is the answer, as without any failure."""
    body = column(rectangle, body_on, nu=0.45)
    X, gravity = body.discretization.space.positions, np.array([1000.0, 0.0, 0.0])
    expected, _ = Equilibrium().loaded(body, X, gravity)
    solve, reached = Equilibrium._newton, [0.0]

    def newton(self, problem, report):
        if problem.gravity[0] > reached[0] + 100.0:
            raise ConvergenceError("too large a step", ["too large a step"])
        x = solve(self, problem, report)
        reached[0] = problem.gravity[0]
        return x

    def minimise(self, problem, report):
        raise ConvergenceError("no minimum", ["no minimum"])

    monkeypatch.setattr(Equilibrium, "_newton", newton)
    monkeypatch.setattr(Equilibrium, "_minimise", minimise)
    found, report = Equilibrium().loaded(body, X, gravity)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert "from the last shape under a part of the load, in smaller steps" in report.history


def test_a_load_below_round_off_asks_for_a_larger_tolerance(rectangle, body_on):
    """The residual of stiff tissue under next to no load cannot fall below its round-off; the shape itself is no trouble."""
    body = column(rectangle, body_on, E=1e5, nu=0.45)
    words = str(failure(body, 1e3))
    assert words.startswith("The body is so stiff for its load that rounding keeps the residual at ")
    larger = float(words.split("of at least ")[1].rstrip("."))
    X = body.discretization.space.positions
    Equilibrium(larger).loaded(body, X, np.array([1e3, 0.0, 0.0]))
