"""Conserved sums, magnitudes and steady states of reaction kinetics, compared with numbers by hand."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from cicatrix.biology.balances import Balances, balances_of
from cicatrix.biology.culprits import fastest, not_finite
from cicatrix.biology.expressions import TIME
from cicatrix.biology.kinetics import Kinetics
from cicatrix.biology.scales import magnitudes
from cicatrix.biology.steady import SteadyState, SteadyStates, steady_states
from cicatrix.numerics.ode import Accuracy

pytestmark = pytest.mark.xdist_group("signalling networks")
EXPLICIT = Accuracy(1e-8, 1e-11, "explicit")


def n(value):
    return ("number", value)


def of(name):
    return ("name", name)


def times(*parts):
    return ("times", *(of(part) if isinstance(part, str) else part for part in parts))


def kinetics(species, constants, flows, rates):
    """Make a law; ``rates`` are expressions of species and the names of ``flows``."""
    values = np.array(list(constants.values()), float)
    return Kinetics(tuple(species), tuple(constants), values, tuple(flows.items()), tuple(rates))


def mass_action(species, constants, reactions, sizes=None):
    """Make a law from (reactants, products, constant) and the names of compartments by species."""
    flows = {f"r{i}": times(k, *left) for i, (left, _, k) in enumerate(reactions)}
    rates = []
    for one in species:
        parts = [
            times(n(float(right.count(one) - left.count(one))), f"r{i}")
            for i, (left, right, _) in enumerate(reactions)
            if one in left or one in right
        ]
        total = ("plus", *parts)
        rates.append(("divide", total, of(sizes[one])) if sizes else total)
    return kinetics(species, constants, flows, rates)


BINDING = mass_action(
    ["X", "Y", "I", "XI", "YI"],
    {"k1": 0.05, "k2": 0.2, "k3": 0.01, "k4": 0.3},
    [
        (["X", "I"], ["XI"], "k1"),
        (["XI"], ["X", "I"], "k2"),
        (["Y", "I"], ["YI"], "k3"),
        (["YI"], ["Y", "I"], "k4"),
    ],
)
BOUND_START = np.array([3.0, 20.0, 8.0, 0.0, 0.0])


def test_binding_keeps_three_sums():
    found = balances_of(BINDING, BINDING.values)
    np.testing.assert_array_equal(found.conserved, [[1, 0, 0, 1, 0], [0, 1, 0, 0, 1], [0, 0, 1, 1, 1]])
    assert len(found.growing) == 0


def test_binding_has_one_steady_state_with_the_totals_of_its_start():
    """Starts drawn at random are moved to these totals; by hand: with i the free I, i + 3 i/(i + 4) + 20 i/(i + 30) = 8."""
    rng = np.random.default_rng(1)
    starts = np.vstack([BOUND_START, rng.random((6, 5)) * [6, 40, 16, 6, 6]])
    found = steady_states(BINDING, BINDING.values, starts, 500.0, np.array([3.0, 20.0, 8.0, 3.0, 8.0]), EXPLICIT)
    (state,) = found.states
    i = brentq(lambda i: i + 3 * i / (i + 4) + 20 * i / (i + 30) - 8, 0, 8, xtol=1e-14)
    xi, yi = 3 * i / (i + 4), 20 * i / (i + 30)
    np.testing.assert_allclose(state.y, [3 - xi, 20 - yi, i, xi, yi], rtol=1e-9)
    assert (state.is_stable, state.n_starts, found.n_conserved, found.is_bistable) == (True, 7, 3, False)


def test_compartments_and_exact_numbers():
    """A in 0.1 l, B in 0.3 l: amounts are kept, so 0.1 A + 0.3 B, whose weights no rounding may blur."""
    law = mass_action(["A", "B"], {"k": 0.7, "c": 0.1, "d": 0.3}, [(["A"], ["B"], "k")], {"A": "c", "B": "d"})
    np.testing.assert_array_equal(balances_of(law, law.values).conserved, [[1.0, 3.0]])


def test_rate_rules_have_sums_too():
    """x' = -k x y / (1 + x), y' = 2 k y x / (x + 1): 2 x + y; the terms are equal though they are written differently."""
    law = kinetics(
        ["x", "y"],
        {"k": 3.0},
        {},
        [
            ("minus", ("divide", times("k", "x", "y"), ("plus", n(1.0), of("x")))),
            times(n(2.0), ("divide", times("y", "k", "x"), ("plus", of("x"), n(1.0)))),
        ],
    )
    np.testing.assert_array_equal(balances_of(law, law.values).conserved, [[2.0, 1.0]])


def test_what_only_decays_and_makes_something_keeps_a_sum_of_both():
    """X' = -k X, P' = 3 k X: 3 X + P, though the stoichiometric matrix of the two reactions has full rank."""
    law = kinetics(["X", "P"], {"k": 2.0}, {}, [times(n(-1.0), "k", "X"), times(n(3.0), "k", "X")])
    np.testing.assert_array_equal(balances_of(law, law.values).conserved, [[3.0, 1.0]])


ACCUMULATE = mass_action(["X", "P"], {"s": 1.0, "k": 1.0}, [([], ["X"], "s"), (["X"], ["P"], "k")])


def test_what_accumulates_has_no_steady_state():
    """X' = 1 - X, P' = X: (X + P)' = 1."""
    found = steady_states(ACCUMULATE, ACCUMULATE.values, np.array([[0.2, 0.0]]), 1000.0, np.ones(2), EXPLICIT)
    np.testing.assert_array_equal(found.balances.growing, [[1.0, 1.0]])
    assert found.balances.growth == pytest.approx(1.0)
    assert (found.states, list(found.reached), found.n_conserved, found.is_bistable) == ([], [-1], 0, False)
    stopped = balances_of(ACCUMULATE, np.array([0.0, 1.0]))  # without the source the sum is kept
    np.testing.assert_array_equal(stopped.conserved, [[1.0, 1.0]])


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e9])
def test_magnitudes_follow_the_amounts(unit):
    """S1 -> S2 -> S3 -> with S1 of 1 unit: by hand S2 comes to k1/k2 = 1/20 of it, S3 to k1/k3 = 1/5 of it."""
    law = mass_action(
        ["S1", "S2", "S3"],
        {"k1": 1.0, "k2": 20.0, "k3": 5.0},
        [(["S1"], ["S2"], "k1"), (["S2"], ["S3"], "k2"), (["S3"], [], "k3")],
    )
    scale = magnitudes(law, np.array([unit, 0.0, 0.0]), [law.values], 10.0)
    np.testing.assert_allclose(scale, unit * np.array([1.0, 0.05, 0.2]), rtol=1e-9)


def test_conserved_sums_limit_magnitudes_and_a_species_that_nothing_makes_has_the_least():
    scale = magnitudes(BINDING, BOUND_START, [BINDING.values], 1e6)
    assert scale[3] == pytest.approx(3.0)  # of X, although production / loss would give 6
    assert scale[4] <= 8.0  # of I
    alone = mass_action(["A", "B"], {"k": 1.0}, [(["A"], [], "k"), (["B"], [], "k")])
    np.testing.assert_allclose(magnitudes(alone, np.array([1e-9, 0.0]), [alone.values], 1.0), 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1e-12, 1e6])
def test_a_toggle_is_bistable_in_any_unit(unit):
    """x' = 6 u^5/(u^4 + y^4) - 2 x and its mirror: by hand 3 u/(1 + y^4/u^4), with x = y = u 1.1640... between the two."""
    a, b, u4 = times(n(6.0), n(unit)), of("x"), n(unit**4)

    def made(by):
        return ("divide", ("times", a, u4), ("plus", u4, ("power", of(by), n(4.0))))

    law = kinetics(
        ["x", "y"], {}, {}, [("minus", made("y"), times(n(2.0), b)), ("minus", made("x"), times(n(2.0), "y"))]
    )
    starts = unit * np.array([[3.0, 0.0], [0.0, 3.0], [1.0, 1.1]])
    found = steady_states(
        law, law.values, starts, 500.0, np.full(2, 3.0 * unit), EXPLICIT._replace(absolute=1e-11 * unit)
    )
    assert [state.is_stable for state in found.states] == [True, True, False]
    middle = brentq(lambda x: 3 / (1 + x**4) - x, 0, 3, xtol=1e-14)
    np.testing.assert_allclose(found.states[2].y, unit * middle, rtol=1e-9)
    assert (found.is_bistable, found.n_conserved) == (True, 0)


VERDICTS = {
    "all settled in one": ([0, 0, 0], 1, False),
    "all settled in two": ([0, 1, 0], 2, True),
    "one of many unsettled, one state": ([0, -1, 0], 1, None),
    "one of many unsettled, two states": ([0, -1, 1], 2, True),
    "its own start unsettled": ([-1, 0, 1], 2, None),
    "the end of its course unsettled": ([0, 1, -1], 2, None),
    "none settled": ([-1, -1, -1], 0, None),
}


@pytest.mark.parametrize("name", VERDICTS)
def test_verdicts(name):
    reached, n_stable, verdict = VERDICTS[name]
    states = [SteadyState(np.array([float(k)]), -1.0, 1) for k in range(n_stable)]
    nothing = Balances(np.zeros((0, 1)), np.zeros((0, 1)), np.zeros(0))
    found = SteadyStates(states, np.array(reached), np.zeros(3, bool), nothing)
    assert found.is_bistable is verdict


@pytest.mark.slow
def test_no_verdict_while_starts_are_unsettled():
    """X' = -X^3 still falls after any time, like 1 / sqrt(2 t)."""
    law = kinetics(["X"], {}, {}, [times(n(-1.0), "X", "X", "X")])
    found = steady_states(law, law.values, np.array([[1.0], [0.5]]), 100.0, np.ones(1), EXPLICIT)
    assert list(found.reached) == [-1, -1]
    assert found.n_unsettled == 2
    assert found.is_bistable is None
    assert all(state.growth == 0.0 and not state.is_stable for state in found.states)  # X = 0: the eigenvalue is 0


def test_a_start_without_a_derivative_is_skipped():
    """X' = sqrt(X) (1 - X): the derivative at X = 0 is infinite, and below 0 there is no number."""
    law = kinetics(["X"], {}, {}, [times(("root", n(2.0), of("X")), ("minus", n(1.0), of("X")))])
    starts = np.array([[0.5], [-1.0], [2.0]])
    found = steady_states(law, law.values, starts, 100.0, np.ones(1), EXPLICIT)
    assert list(found.is_skipped) == [False, True, False]
    assert found.stable[0].y == pytest.approx([1.0])
    assert (found.reached[0], found.reached[2], found.n_unsettled) == (0, 0, 0)
    at_zero = Accuracy(1e-6, 1e-9, "implicit")
    assert list(steady_states(law, law.values, np.array([[0.0]]), 100.0, np.ones(1), at_zero).is_skipped) == [True]


def test_the_formula_to_blame_is_named():
    gap = ("piecewise", n(1.0), ("lt", (TIME,), n(2.0)))
    law = kinetics(["X"], {"k": 1.0}, {"flow": gap, "twice": times(n(2.0), "flow")}, [of("twice")])
    assert not_finite(law, law.values, np.ones(1), 1.0) is None
    told = 'the formula of "flow" is not a number, since none of the conditions of its piecewise holds and it has no otherwise'
    assert not_finite(law, law.values, np.ones(1), 3.0) == told
    over = kinetics(["X"], {"k": 0.0}, {}, [("divide", of("X"), of("k"))])
    assert not_finite(over, over.values, np.ones(1), 0.0) == 'the rate of change of "X" is infinite'
    fast = kinetics(["X", "Y"], {}, {"slow": n(1.0), "quick": n(-1e200)}, [of("slow"), of("quick")])
    words, pace = fastest(fast, fast.values, np.ones(2), 0.0, np.array([1.0, 10.0]))
    assert '"Y" changes fastest there' in words
    assert '"quick", -1e+200' in words
    assert pace == pytest.approx(1e199)


def test_time_is_no_term_that_cancels():
    law = kinetics(["X", "P"], {}, {}, [times(n(-1.0), (TIME,), "X"), times((TIME,), "X")])
    np.testing.assert_array_equal(balances_of(law, law.values).conserved, [[1.0, 1.0]])
    assert float(law.under().rate(jnp.array([2.0, 0.0]), 3.0)[1]) == 6.0
