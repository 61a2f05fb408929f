"""SBML beyond rate laws: each feature against its closed form, and what is refused since no engine has it right."""

import numpy as np
import pytest
from sbml_models import (
    RATE_OF,
    assignment,
    cell,
    event,
    listed,
    parameter,
    reaction,
    reference,
    rule,
    sbml,
    species,
)

from cicatrix.core.errors import InputError
from cicatrix.files.sbml import read_sbml
from cicatrix.numerics.ode import Accuracy

pytest.importorskip("libsbml", reason="needs python-libsbml")
pytest.importorskip("roadrunner", reason="needs libroadrunner")

TIMES = np.linspace(0.0, 4.0, 9)
CLOCK = parameter("x", 0.0), rule("rate", "x", 1.0)


@pytest.fixture
def course(tmp_path):
    """Return the columns of a model that libroadrunner integrates, by name."""

    def follow(inside, changes=None, times=TIMES, **more):
        path = tmp_path / "model.xml"
        path.write_text(sbml(inside, **more))
        model = read_sbml(path, None, changes)
        assert "libroadrunner simulates this model" in model.notes[-1]
        return dict(zip(model.law.species, model.law.course(times, Accuracy()).T))

    return follow


def clocked(*events, values=(), rules=()):
    """Return a model in which x is the time, with parameters and events."""
    return listed("Parameters", CLOCK[0], *values) + listed("Rules", CLOCK[1], *rules) + listed("Events", *events)


def near(found, right):
    np.testing.assert_allclose(found, right, rtol=1e-6, atol=1e-9)


def test_an_event_resets_a_ramp(course):
    found = course(clocked(event(("geq", "x", 1.6), {"x": 0.0})))
    near(found["x"], [0.0, 0.5, 1.0, 1.5, 0.4, 0.9, 1.4, 0.3, 0.8])


@pytest.mark.parametrize(("at_trigger", "value"), [("true", 1.2), ("false", 2.4)])
def test_a_delayed_event_takes_the_values_of_its_instant(at_trigger, value, course):
    one = event(("geq", "x", 1.2), {"y": "x"}, delay=1.2, at_trigger=at_trigger)
    found = course(clocked(one, values=[parameter("y", 0.0)]))
    near(found["y"], [0.0] * 5 + [value] * 4)


@pytest.mark.parametrize(("persistent", "value"), [("true", 7.0), ("false", 0.0)])
def test_an_event_that_does_not_persist_is_called_off(persistent, value, course):
    pulse = ("and", ("gt", "x", 1.2), ("lt", "x", 1.7))
    found = course(clocked(event(pulse, {"y": 7.0}, delay=1.0, persistent=persistent), values=[parameter("y", 0.0)]))
    near(found["y"], [0.0] * 5 + [value] * 4)


def test_priorities_order_events_of_one_instant(course):
    """By hand: (1 + 1) 2 = 4 in the right order, 1 2 + 1 = 3 in the other."""
    late = event(("geq", "x", 1.2), {"a": ("times", "a", 2.0)}, priority=1.0, at_trigger="false")
    early = event(("geq", "x", 1.2), {"a": ("plus", "a", 1.0)}, priority=5.0, at_trigger="false")
    found = course(clocked(late, early, values=[parameter("a", 1.0)]))
    near(found["a"], [1.0] * 3 + [4.0] * 6)


@pytest.mark.parametrize(("first", "value"), [("false", 3.0), ("true", 0.0)])
def test_an_event_may_fire_at_the_first_instant(first, value, course):
    found = course(clocked(event(("geq", "x", 0.0), {"y": 3.0}, first=first), values=[parameter("y", 0.0)]))
    near(found["y"], [value] * 9)


def test_names_that_mean_something_elsewhere_are_names(course):
    """Parameters "time", "sin" and "pi" are no functions and no time; x counts their sum."""
    values = [parameter("time", 1.0), parameter("sin", 0.25), parameter("pi", 0.75)]
    grow = rule("rate", "y", ("plus", "<ci>time</ci>", "<ci>sin</ci>", "<ci>pi</ci>"))
    found = course(clocked(event(("gt", "x", 9.0), {"y": 0.0}), values=[*values, parameter("y", 0.0)], rules=[grow]))
    near(found["y"], 2.0 * TIMES)
    near(found["time"], 1.0)


def test_rules_alone_are_a_course(course):
    inside = listed("Parameters", parameter("y")) + listed("Rules", rule("assignment", "y", ("sin", "time")))
    near(course(inside)["y"], np.sin(TIMES))


def test_a_species_that_only_a_rule_sets(course):
    kinds = listed("Species", species("S", 1.0, boundary="true"), species("B", 2.0, boundary="true"))
    found = course(cell(2.0) + kinds + listed("Rules", rule("assignment", "S", ("times", 2.0, "time"))))
    near(found["S"], 2.0 * TIMES)
    near(found["B"], 1.0)  # 2 mol in 2 l


def decay(more="", size=1.0, constant="true", rules=(), extra="", law=("times", "c", "X")):
    kinds = listed("Species", species("X", 2.0, more=more), species("Y", 0.0, boundary="true"))
    return (
        cell(size, constant)
        + kinds
        + extra
        + listed("Rules", *rules)
        + listed("Reactions", reaction("r", ["X"], [], law))
    )


def test_an_algebraic_rule_is_solved(course):
    """0 = 3 - X - 2 Y: Y = (3 - X) / 2."""
    zero = rule("algebraic", "", ("minus", ("minus", 3.0, "X"), ("times", 2.0, "Y")))
    found = course(decay(rules=[zero]))
    near(found["X"], 2.0 * np.exp(-TIMES))
    near(found["Y"], 0.5 * (3.0 - 2.0 * np.exp(-TIMES)))


def test_two_algebraic_rules_that_hang_together(course):
    """0 = Y - X / 2 and 0 = p + q - 1 with q := Y: p = 1 - X / 2; the second hides its unknown in a rule."""
    rules = [
        rule("algebraic", "", ("minus", "Y", ("divide", "X", 2.0))),
        rule("algebraic", "", ("plus", "p", "q", ("minus", 1.0))),
        rule("assignment", "q", "Y"),
    ]
    found = course(decay(rules=rules, extra=listed("Parameters", parameter("p"), parameter("q"))))
    near(found["p"], 1.0 - np.exp(-TIMES))


def test_amounts_stay_in_a_compartment_that_grows(course):
    """c = 1 + t: the amount X decays by exp(-t), the concentration is the amount by c; Y, which nothing changes, is 3 / c."""
    grow = rule("rate", "c", 1.0)
    empty, full = (f'id="Y" compartment="c" initialAmount="{amount}"' for amount in (0.0, 3))
    inside = decay(constant="false", rules=[grow]).replace(empty, full)
    found = course(inside)
    near(found["c"], 1.0 + TIMES)
    near(found["X"], 2.0 * np.exp(-TIMES) / (1.0 + TIMES))
    near(found["Y"], 3.0 / (1.0 + TIMES))


def test_an_event_sets_a_concentration_and_its_volume_at_once(course):
    change = listed("Events", event(("geq", "time", 1.2), {"c": 4.0, "X": 3.0}))
    found = course(decay(constant="false", law=0.0) + change)
    near(found["X"], [2.0] * 3 + [3.0] * 6)
    near(found["c"], [1.0] * 3 + [4.0] * 6)


def test_an_event_that_changes_a_volume_keeps_the_amount(course):
    change = listed("Events", event(("geq", "time", 1.2), {"c": 4.0}))
    near(course(decay(constant="false", law=0.0) + change)["X"], [2.0] * 3 + [0.5] * 6)


def test_conversion_factors_turn_extent_into_substance(course):
    """X' = -0.5 X c, with a factor of the species of 0.5."""
    found = course(decay(more=' conversionFactor="f"', extra=listed("Parameters", parameter("f", 0.5, "true"))))
    near(found["X"], 2.0 * np.exp(-0.5 * TIMES))


def test_rate_of_a_concentration_in_a_growing_compartment(course):
    """X = 2 exp(-t) / (1 + t), so X' = -X - X / (1 + t)."""
    rules = [rule("rate", "c", 1.0), rule("assignment", "p", (RATE_OF, "X"))]
    found = course(decay(constant="false", rules=rules, extra=listed("Parameters", parameter("p"))))
    near(found["p"], -found["X"] - found["X"] / (1.0 + TIMES))


STOICHIOMETRIES = {
    "a rule": (listed("Rules", rule("assignment", "n", "time")), TIMES**2 / 2.0),
    "a rate": (listed("Rules", rule("rate", "n", 1.0)), TIMES + TIMES**2 / 2.0),
    "a start": (listed("InitialAssignments", assignment("n", 3.0)), 3.0 * TIMES),
    "an event": (listed("Events", event(("geq", "time", 2.0), {"n": 5.0})), TIMES + 4.0 * np.maximum(TIMES - 2.0, 0.0)),
}


@pytest.mark.parametrize("kind", STOICHIOMETRIES)
def test_stoichiometries_are_computed(kind, course):
    inside, right = STOICHIOMETRIES[kind]
    made = reference("S", 1.0, 'id="n" constant="false"')
    reactions = listed("Reactions", reaction("r", [], [made], 1.0))
    rest = inside if "Events" in inside else ""
    before = "" if rest else inside
    near(course(cell() + listed("Species", species("S", 0.0)) + before + reactions + rest)["S"], right)


def test_truth_and_numbers_replace_each_other(course):
    """Level 3 Version 2: true counts as 1 in a sum, and 2 as true in a condition."""
    rules = [rule("assignment", "y", ("plus", ("geq", "x", 2.0), 1.0))]
    change = event(("and", "k", ("geq", "x", 1.2)), {"z": 1.0})
    values = [parameter("y"), parameter("z", 0.0), parameter("k", 2.0, "true")]
    found = course(clocked(change, values=values, rules=rules))
    near(found["y"], 1.0 + (TIMES >= 2.0))
    near(found["z"], [0.0] * 3 + [1.0] * 6)


def test_what_a_case_sets_changes_in_time_and_carries_through(course):
    """k = 0, from 2 s on 1; double := 2 k; X' = -double X."""
    extra = listed(
        "Parameters", parameter("k", 1.0, "true"), parameter("double", None, "true"), parameter("f", 1.0, "true")
    )
    inside = decay(more=' conversionFactor="f"', extra=extra, law=("times", "c", "double", "X"))
    double = listed("InitialAssignments", assignment("double", ("times", 2.0, "k")))
    inside = inside.replace("<listOfReactions>", double + "<listOfReactions>")
    found = course(inside, {"k": ((0.0, 0.0), (2.0, 1.0))})
    near(found["X"], 2.0 * np.exp(-2.0 * np.maximum(TIMES - 2.0, 0.0)))


def test_amounts_stay_where_a_case_sets_a_compartment(course):
    extra = listed("Parameters", parameter("f", 1.0, "true"))
    found = course(decay(more=' conversionFactor="f"', extra=extra, law=0.0), {"c": ((0.0, 4.0), (1.2, 8.0))})
    near(found["X"], [0.5] * 3 + [0.25] * 6)


def test_formulas_that_are_empty_have_no_effect(course):
    empty = "<event useValuesFromTriggerTime='true'><trigger initialValue='true' persistent='true'/></event>"
    inside = clocked(event(("geq", "x", 2.0), {"x": 0.0}), empty)
    near(course(inside)["x"], [0.0, 0.5, 1.0, 1.5, 0.0, 0.5, 1.0, 1.5, 0.0])


DELAY = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/delay">delay</csymbol>'
REFUSED = {
    "delays": (clocked(rules=[rule("assignment", "y", (DELAY, "x", 1.0))], values=[parameter("y")]), "uses delays"),
    "not linear": (
        decay(rules=[rule("algebraic", "", ("minus", ("power", "Y", 2.0), "X"))]),
        'an algebraic rule is not linear in "Y"',
    ),
    "not determined": (
        decay(
            rules=[rule("algebraic", "", ("minus", ("plus", "p", "Y"), "X"))],
            extra=listed("Parameters", parameter("p", 1.0)),
        ),
        "do not say which quantity",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_no_engine_has_right_is_refused(kind, tmp_path):
    inside, words = REFUSED[kind]
    path = tmp_path / "model.xml"
    path.write_text(sbml(inside))
    with pytest.raises(InputError, match=words):
        read_sbml(path)


def test_a_fast_reaction_is_refused(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(sbml(decay().replace('reversible="false"', 'reversible="false" fast="true"'), version=1))
    with pytest.raises(InputError, match='reaction "r" is fast, at equilibrium at all times'):
        read_sbml(path)


def test_a_rate_rule_of_a_concentration_in_a_volume_that_grows_and_jumps(course):
    """X' = 1 whatever the volume 1 + t does, but as it doubles at 1.2 s, the amount stays: X halves."""
    kinds = listed("Species", species("X", density=0.0, boundary="true"))
    rules = listed("Rules", rule("rate", "X", 1.0), rule("rate", "c", 1.0))
    jump = listed("Events", event(("geq", "time", 1.2), {"c": ("times", 2.0, "c")}))
    near(course(cell(1.0, "false") + kinds + rules + jump)["X"], np.where(TIMES < 1.2, TIMES, TIMES - 0.6))


def test_an_event_sets_a_concentration_with_a_rate_rule(course):
    """Semantic case 01511, its pulse and delay: X = 0.4 t, at 0.55 s set to 0.2, so 0.22 at 0.6 s; c = 0.5 + 0.2 t."""
    kinds = listed("Species", species("X", density=0.0, boundary="true"))
    rules = listed("Rules", rule("rate", "X", 0.4), rule("rate", "c", 0.2))
    pulse = ("and", ("gt", "X", 0.18), ("lt", "X", 0.2))
    late = listed("Events", event(pulse, {"X": 0.2}, delay=0.1))
    found = course(cell(0.5, "false") + kinds + rules + late, times=np.linspace(0.0, 1.0, 11))
    near(found["X"][[5, 6, 10]], [0.2, 0.22, 0.38])


def test_semantic_case_1044(course):
    """S1 + S2 <-> S3 with 0 = kf - 0.75; start, constants and results (two rows) of sbml-test-suite, semantic 01044."""
    kinds = listed("Species", species("S1", 0.01), species("S2", 0.02), species("S3", 0.01))
    constants = listed("Parameters", parameter("kf"), parameter("kr", 0.25, "true"))
    zero = listed("Rules", rule("algebraic", "", ("plus", "kf", "<cn>-0.75</cn>")))
    rate = ("minus", ("times", "c", ("plus", ("times", "kf", "S1", "S2"), ("times", "<cn>-1</cn>", "kr", "S3"))))
    found = course(
        cell() + kinds + constants + zero + listed("Reactions", reaction("r", ["S3"], ["S1", "S2"], rate)),
        times=np.array([0.0, 0.5, 25.0]),
    )
    near(found["S1"], [0.01, 0.01109831734297234, 0.01842142728181884])
    near(found["S3"], [0.01, 0.008901682657027653, 0.001578572718181171])


def test_semantic_case_930(course):
    """Of two events of one instant, the one of lower priority is executed last; results of sbml-test-suite, semantic 00930."""
    kinds = listed("Species", species("S1", 0.0), species("S2", 0.0))
    one = event(("geq", "time", 1.0), {"S1": 4.0, "S2": 5.0}, priority=1.0)
    two = event(("geq", "time", 1.0), {"S1": 1.0, "S2": 2.0}, priority=0.0)
    found = course(cell() + kinds + listed("Events", one, two), times=np.array([0.0, 0.96, 1.0, 2.0]))
    near(found["S1"], [0.0, 0.0, 1.0, 1.0])
    near(found["S2"], [0.0, 0.0, 2.0, 2.0])


def test_semantic_case_1106(course):
    """X' = Xref, Xref := p1, and p1 = 2 from X = 2 on, at 1 s; model of sbml-test-suite, semantic 01106, closed form by hand."""
    made = reference("X", None, 'id="Xref" constant="false"')
    inside = (
        cell()
        + listed("Species", species("X", density=1.0))
        + listed("Parameters", parameter("p1", 1.0), parameter("k1", 1.0, "true"))
        + listed("Rules", rule("assignment", "Xref", "p1"))
        + listed("Reactions", reaction("J0", [], [made], "k1"))
        + listed("Events", event(("geq", "X", 2.0), {"p1": 2.0}))
    )
    found = course(inside)
    near(found["X"], np.where(TIMES < 1.0, 1.0 + TIMES, 2.0 * TIMES))
    near(found["Xref"][TIMES != 1.0], np.where(TIMES < 1.0, 1.0, 2.0)[TIMES != 1.0])


def test_semantic_case_993(course):
    """X' = Xref, Xref := p1, 0 = X - p1: X = exp(t); model of sbml-test-suite, semantic 00993, closed form by hand."""
    made = reference("X", 1.0, 'id="Xref" constant="false"')
    inside = (
        cell()
        + listed("Species", species("X", density=1.0))
        + listed("Parameters", parameter("p1"), parameter("k1", 1.0, "true"))
        + listed("Rules", rule("algebraic", "", ("minus", "X", "p1")), rule("assignment", "Xref", "p1"))
        + listed("Reactions", reaction("J0", [], [made], "k1"))
    )
    near(course(inside)["X"], np.exp(TIMES))


def test_semantic_case_1208(course):
    """c = 0.5 + 0.2 t and S1' = -0.2 S1 / c: S1 = 3 / c; model of sbml-test-suite, semantic 01208, closed form by hand."""
    kinds = listed("Species", species("S1", 3.0, boundary="true"))
    rules = [
        rule("rate", "S1", ("divide", ("times", "<cn>-0.2</cn>", "S1"), "c")),
        rule("rate", "c", 0.2),
        rule("assignment", "x", "S1"),
    ]
    found = course(cell(0.5, "false") + kinds + listed("Parameters", parameter("x")) + listed("Rules", *rules))
    near(found["x"], 3.0 / (0.5 + 0.2 * TIMES))


JUMP = listed("Events", event(("geq", "time", 1.2), {"c": ("times", 4.0, "c")}))
VOLUMES = {
    "jumps": (cell(1.0, "false"), "", JUMP, np.where(TIMES < 1.2, 1.0, 4.0)),
    "grows and jumps": (
        cell(1.0, "false"),
        listed("Rules", rule("rate", "c", 1.0)),
        JUMP,
        np.where(TIMES < 1.2, 1.0 + TIMES, 8.8 + TIMES - 1.2),
    ),
    "follows a parameter that jumps": (
        cell(1.0, "false"),
        listed("Parameters", parameter("k", 1.0)) + listed("Rules", rule("assignment", "c", ("times", 2.0, "k"))),
        listed("Events", event(("geq", "time", 1.2), {"k": 4.0})),
        np.where(TIMES < 1.2, 2.0, 8.0),
    ),
    "starts by an assignment": (
        cell(1.0, "false"),
        listed("InitialAssignments", assignment("c", 5.0)),
        JUMP,
        np.where(TIMES < 1.2, 5.0, 20.0),
    ),
}


@pytest.mark.parametrize("kind", VOLUMES)
def test_the_amount_of_a_reaction_is_the_same_in_any_volume(kind, course):
    """r = c X, so the amount decays as 2 exp(-t), whatever the volume does."""
    place, more, events, volume = VOLUMES[kind]
    kinds = listed("Species", species("X", 2.0))
    use = listed("Reactions", reaction("r", ["X"], [], ("times", "c", "X")))
    found = course(place + kinds + more + use + events)
    near(found["X"], 2.0 * np.exp(-TIMES) / volume)
    near(found["c"], volume)
