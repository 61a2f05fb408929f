"""SBML files that are damaged, that break SBML's rules, or that are read in a way that is easily got wrong."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from sbml_models import TIME, assignment, cell, listed, math, parameter, reaction, rule, sbml, species
from shared_inputs import FAULTS

from cicatrix.biology.courses import end_state, integrate
from cicatrix.biology.sensitivity import of_end
from cicatrix.core.errors import InputError
from cicatrix.files.sbml import read_sbml
from cicatrix.numerics.ode import Accuracy

pytest.importorskip("libsbml", reason="needs python-libsbml")
NEST = "<apply><minus/>"
DECAY = (
    cell() + listed("Species", species("S", 1.0)) + listed("Reactions", reaction("r", ["S"], [], ("times", 2.0, "S")))
)


def growing(formula, *more):
    """Return a model with x' = formula."""
    return listed("Parameters", parameter("x", 1.0), *more) + listed("Rules", rule("rate", "x", formula))


def nested(depth):
    return growing("<apply><abs/>" * depth + "<cn>1</cn>" + "</apply>" * depth)


FUNCTIONS = "".join(
    f'<functionDefinition id="f{k}"><math xmlns="http://www.w3.org/1998/Math/MathML"><lambda><bvar><ci>a</ci></bvar><apply>'
    f"<plus/>{''.join([f'<apply><ci>f{k - 1}</ci><ci>a</ci></apply>' if k else '<ci>a</ci>'] * 10)}</apply></lambda></math>"
    "</functionDefinition>"
    for k in range(9)
)
REFUSED = {
    "an id twice": (cell() + listed("Species", species("S", 1.0), species("S", 2.0)), "must be unique"),
    "two rules": (
        listed("Parameters", parameter("x", 1.0))
        + listed("Rules", rule("rate", "x", 1.0), rule("assignment", "x", 1.0)),
        "must be unique",
    ),
    "a rule on a constant": (
        listed("Parameters", parameter("x", 1.0, "true")) + listed("Rules", rule("rate", "x", 1.0)),
        "must have a value of 'false' for 'constant'",
    ),
    "a rule and a reaction": (
        DECAY.replace("<listOfReactions>", listed("Rules", rule("rate", "S", 1.0)) + "<listOfReactions>"),
        "both reactions and rules",
    ),
    "no compartment": (listed("Species", species("S", 1.0)), "not valid SBML"),
    "another compartment": (DECAY.replace('compartment="c"', 'compartment="d"'), "compartment"),
    "a negative size": (
        DECAY.replace('size="1.0"', 'size="-1"'),
        'compartment "c" has the size -1; it must be above 0',
    ),
    "a size of 0": (
        DECAY.replace('size="1.0"', 'size="0"'),
        'species "S" is a concentration in compartment "c" of size 0',
    ),
    "a hexadecimal": (
        growing('<cn type="integer">0x1</cn>'),
        '<cn type="integer"> must hold a decimal number; got "0x1"',
    ),
    "a decimal comma": (growing("<cn>1,5</cn>"), '<cn type="real"> must hold a decimal number; got "1,5"'),
    "a hexadecimal value": (
        growing("x").replace('value="1.0"', 'value="0x1"'),
        'value of <parameter> must be a decimal number; got "0x1"',
    ),
    "nested 3000": (nested(3000), "elements are nested more than 200 deep"),
    "nested 50000": (nested(50_000), "elements are nested more than 200 deep"),
    "functions of functions": (
        listed("FunctionDefinitions", FUNCTIONS) + growing("<apply><ci>f8</ci><ci>x</ci></apply>"),
        "its functions expand to more than",
    ),
    "a rate that is none": (
        DECAY.replace(math(("times", 2.0, "S")), math(("divide", "S", ("minus", "S", 1.0)))),
        'reaction or rule "r" is inf at time 0',
    ),
    "no otherwise": (
        growing(f"<piecewise><piece><cn>1</cn><apply><gt/>{TIME}<cn>1</cn></apply></piece></piecewise>"),
        'the rate of "x" is nan at time 0',
    ),
    "a huge rate": (growing(("exp", 400.0)), 'the rate of "x" is 5.22147e+173 at time 0'),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_breaks_the_rules_is_refused_in_a_sentence(kind, tmp_path):
    inside, words = REFUSED[kind]
    path = tmp_path / "model.xml"
    path.write_text(sbml(inside))
    with pytest.raises(InputError, match=re.escape(words)) as error:
        read_sbml(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_entities_are_refused(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text('<!DOCTYPE sbml [<!ENTITY a "aaaa">]>' + sbml(DECAY))
    with pytest.raises(InputError, match="SBML has no DOCTYPE and no entities"):
        read_sbml(path)


def test_a_formula_nested_180_deep_is_read(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(sbml(nested(180)))
    law = read_sbml(path).law
    np.testing.assert_allclose(law.rate(np.ones(1)), [1.0])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "iso-8859-1", "windows-1252"])
def test_the_encoding_is_the_one_that_the_file_states(encoding, tmp_path):
    path = tmp_path / "model.xml"
    declared = "utf-8" if encoding == "utf-8-sig" else encoding
    text = f'<?xml version="1.0" encoding="{declared}"?>\n' + sbml(DECAY.replace('id="S"', 'id="S" name="Säure"'))
    path.write_bytes(text.encode(encoding))
    assert read_sbml(path).law.species == ("S",)


def test_a_species_named_time_is_not_the_time(tmp_path):
    """time' = -2 time, x' = t: both by their rates at one point."""
    path = tmp_path / "model.xml"
    rules = listed("Rules", rule("rate", "x", TIME))
    inside = DECAY.replace('"S"', '"time"').replace("<ci>S</ci>", "<ci>time</ci>")
    inside = inside.replace(
        "<listOfReactions>", listed("Parameters", parameter("x", 0.0)) + rules + "<listOfReactions>"
    )
    path.write_text(sbml(inside))
    law = read_sbml(path).law
    assert law.species == ("time", "x")
    np.testing.assert_allclose(law.rate(np.array([3.0, 0.0]), None, 5.0), [-6.0, 5.0])


UNIT = listed(
    "UnitDefinitions", '<unitDefinition id="{}"><listOfUnits><unit kind="second" {}/></listOfUnits></unitDefinition>'
)


@pytest.mark.parametrize(
    ("level", "units", "seconds"),
    [
        (3, UNIT.format("m", 'exponent="1" scale="0" multiplier="60"'), 60.0),
        (3, UNIT.format("m", 'exponent="1" scale="2" multiplier="36"'), 3600.0),
        (2, UNIT.format("time", 'multiplier="86400"'), 86400.0),
        (2, "", 1.0),
    ],
)
def test_the_unit_of_time_is_read(level, units, seconds, tmp_path):
    path = tmp_path / "model.xml"
    if level == 3:
        path.write_text(sbml(units + growing(1.0)).replace('timeUnits="second"', 'timeUnits="m"'))
    else:
        inside = units + growing(1.0)
        path.write_text(
            f'<sbml xmlns="http://www.sbml.org/sbml/level2/version4" level="2" version="4"><model id="m">{inside}</model></sbml>'
        )
    model = read_sbml(path)
    assert (model.law.seconds, model.notes) == (seconds, ())


def test_a_case_may_state_another_unit_and_is_told(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(sbml(growing(1.0)))
    model = read_sbml(path, "h")
    assert model.law.seconds == 3600.0
    assert model.notes == ("The file states a unit of time of 1 s; network.time_unit = h is taken instead.",)


SET = (
    cell()
    + listed("Species", species("X", 1.0))
    + listed("Parameters", parameter("k1", 1.0, "true"), parameter("k2", None, "true"))
    + listed("InitialAssignments", assignment("k2", ("times", 2.0, "k1")))
    + listed("Reactions", reaction("use", ["X"], [], ("times", "k2", "X", "c")))
)


def end(law, inputs, start):
    held = jnp.array(inputs)
    return float(
        integrate(law, held, law.begin(start, held), jnp.array([0.0, 1.0]), Accuracy(1e-9, 1e-12, "explicit")).y[-1, 0]
    )


def test_what_depends_on_a_value_that_is_set_follows_it(tmp_path):
    """By hand: X(1) = exp(-2 k1), so 0.1353 at k1 = 1 and 0.8187 at k1 = 0.1; in 4 litres the amount is the same."""
    path = tmp_path / "model.xml"
    path.write_text(sbml(SET))
    model = read_sbml(path, None, {"k1": ((0.0, 0.1),)})
    law, at = model.law, dict(zip(model.law.input_names, model.inputs))
    assert at == {"c": 1.0, "k1": 1.0}
    assert end(law, [1.0, 1.0], model.start) == pytest.approx(np.exp(-2.0), rel=1e-6)
    assert end(law, [1.0, 0.1], model.start) == pytest.approx(np.exp(-0.2), rel=1e-6)
    assert end(law, [4.0, 1.0], model.start) == pytest.approx(np.exp(-2.0) / 4.0, rel=1e-6)
    free = read_sbml(path, None, {"k2": ((0.0, 3.0),)})
    assert dict(zip(free.law.input_names, free.inputs)) == {"c": 1.0, "k1": 1.0, "k2": 2.0}


def test_an_initial_value_follows_what_is_set(tmp_path):
    """X(0) := 3 k1, in a compartment of 1 or 4 litres: 3 k1 / c, since the amount stays."""
    path = tmp_path / "model.xml"
    path.write_text(
        sbml(
            SET.replace(
                "</listOfInitialAssignments>", assignment("X", ("times", 3.0, "k1")) + "</listOfInitialAssignments>"
            )
        )
    )
    law = read_sbml(path).law
    np.testing.assert_allclose(law.begin(np.zeros(1), np.array([1.0, 2.0])), [6.0])
    np.testing.assert_allclose(law.begin(np.zeros(1), np.array([4.0, 2.0])), [1.5])


def test_a_compartment_that_changes_later_keeps_the_amounts(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(sbml(SET))
    law = read_sbml(path).law
    np.testing.assert_allclose(law.carried(np.array([0.5]), np.array([1.0, 1.0]), np.array([4.0, 1.0])), [0.125])
    inputs = np.array([[1.0, 0.0], [4.0, 0.0]])
    kept = end_state(law, inputs, np.ones(1), np.array([0.0, 1.0, 2.0]), Accuracy(method="explicit"))
    np.testing.assert_allclose(kept, [0.25], rtol=1e-6)


def test_species_of_rules_and_constants_that_follow_are_shown(tmp_path):
    path = tmp_path / "model.xml"
    kinds = listed("Species", species("X", 1.0), species("Y", 0.0, boundary="true"))
    inside = SET.replace(listed("Species", species("X", 1.0)), kinds)
    inside = inside.replace(
        "<listOfReactions>", listed("Rules", rule("assignment", "Y", ("times", 5.0, "X"))) + "<listOfReactions>"
    )
    path.write_text(sbml(inside))
    law = read_sbml(path).law
    assert (law.species, law.shown) == (("X",), ("Y", "k2"))
    np.testing.assert_allclose(law.observe(np.array([[1.0], [2.0]]), np.array([1.0, 7.0])), [[5.0, 14.0], [10.0, 14.0]])


def test_functions_that_are_rare(tmp_path):
    """By hand: 5! = 120, quotient(7, 2) = 3, rem(7, 2) = 1, sec(0) = 1, arccsc(1) = pi / 2, implies(false, true) is true."""
    path = tmp_path / "model.xml"
    parts = [
        ("factorial", 5.0),
        ("quotient", 7.0, 2.0),
        ("rem", 7.0, 2.0),
        ("sec", 0.0),
        ("arccsc", 1.0),
        ("max", 1.0, 4.0, 2.0),
        "<piecewise><piece><cn>8</cn><apply><implies/><false/><true/></apply></piece><otherwise><cn>0</cn></otherwise></piecewise>",
    ]
    path.write_text(sbml(growing(("plus", *parts))))
    np.testing.assert_allclose(
        read_sbml(path).law.rate(np.ones(1)), [120.0 + 3.0 + 1.0 + 1.0 + np.pi / 2.0 + 4.0 + 8.0]
    )


SBML = FAULTS / "sbml"


@pytest.mark.skipif(not SBML.is_dir(), reason="the folder of failing inputs is absent")
def test_minutes_that_a_file_states():
    assert read_sbml(SBML / "setia" / "m_min.xml").law.seconds == 60.0


def test_a_compartment_that_constants_determine_is_no_variable_one(tmp_path):
    """c := 2 k = 4 l: X = 1 mol / 4 l, and X' = -X."""
    path = tmp_path / "model.xml"
    size = listed("Parameters", parameter("k", 2.0, "true")) + listed(
        "Rules", rule("assignment", "c", ("times", 2.0, "k"))
    )
    inside = DECAY.replace('size="1.0" constant="true"', 'constant="false"').replace(
        "<listOfReactions>", size + "<listOfReactions>"
    )
    path.write_text(sbml(inside.replace(math(("times", 2.0, "S")), math(("times", "c", "S")))))
    model = read_sbml(path)
    np.testing.assert_allclose(model.start, [0.25])
    np.testing.assert_allclose(model.law.rate(model.start), [-0.25])
    np.testing.assert_allclose(model.law.begin(model.start, np.array([4.0])), [0.125])


def test_the_rate_depends_on_a_constant_by_way_of_another(tmp_path):
    """X' = -k2 X with k2 := 2 k1: dX'/dk1 = -2 X."""
    path = tmp_path / "model.xml"
    path.write_text(sbml(SET))
    law = read_sbml(path).law
    by = jax.jacfwd(lambda inputs: law.rate(jnp.array([0.5]), inputs))(jnp.array([1.0, 1.0]))
    np.testing.assert_allclose(by[0, 1], -1.0)


@pytest.mark.slow
def test_the_sensitivity_to_a_constant_carries_through(tmp_path):
    """X(1) = exp(-2 k1) / c: dX/dk1 = -2 exp(-2) = -0.2707 and, as the amount stays, dX/dc = -exp(-2)."""
    path = tmp_path / "model.xml"
    path.write_text(sbml(SET))
    model = read_sbml(path)
    at, inputs = np.array([0.0, 1.0]), np.array([[1.0, 1.0]])
    by = of_end(model.law, inputs, model.start, at, Accuracy(1e-7, 1e-9, "explicit", 32))["input"]
    assert model.law.input_names == ("c", "k1")
    np.testing.assert_allclose(by, [[-np.exp(-2.0), -2.0 * np.exp(-2.0)]], rtol=1e-5)


def test_constants_follow_in_a_chain_and_amounts_of_constant_species_stay(tmp_path):
    """a := 3, b := 2 a, k := b + 1: k = 7; with a = 1, k = 3. B, a boundary of 2 mol, is 2 / c where the case sets c."""
    path = tmp_path / "model.xml"
    chain = [assignment("a", 3.0), assignment("b", ("times", 2.0, "a")), assignment("k", ("plus", "b", 1.0))]
    inside = (
        cell()
        + listed("Species", species("X", 1.0), species("B", 2.0, boundary="true"))
        + listed("Parameters", *(parameter(one, None, "true") for one in "abk"))
        + listed("InitialAssignments", *chain)
        + listed("Reactions", reaction("r", ["X"], [], ("times", "k", "B", "c")))
    )
    path.write_text(sbml(inside))
    law = read_sbml(path).law
    assert law.input_names == ("c", "B", "a")
    np.testing.assert_allclose(law.rate(np.ones(1)), [-14.0])
    np.testing.assert_allclose(law.rate(np.ones(1), np.array([1.0, 2.0, 1.0])), [-6.0])
    followed = read_sbml(path, None, {"c": ((0.0, 4.0),)}).law
    assert followed.input_names == ("c", "a")
    np.testing.assert_allclose(followed.observe(np.ones((1, 1)), np.array([4.0, 3.0])), [[0.5, 6.0, 7.0]])


def test_a_sum_of_a_thousand_terms_is_read(tmp_path):
    (tmp_path / "m.xml").write_text(sbml(growing(("plus", *["x"] * 1000))))
    model = read_sbml(tmp_path / "m.xml")
    np.testing.assert_allclose(model.law.rate(model.start), [1000.0])


def test_a_text_formula_nested_too_deep_is_refused(tmp_path):
    formula = "p" + " - p" * 3000
    (tmp_path / "m.xml").write_text(
        '<sbml xmlns="http://www.sbml.org/sbml/level1" level="1" version="2"><model name="m"><listOfCompartments>'
        '<compartment name="c"/></listOfCompartments><listOfParameters><parameter name="p" value="1"/></listOfParameters>'
        f'<listOfRules><parameterRule name="p" type="rate" formula="{formula}"/></listOfRules></model></sbml>'
    )
    with pytest.raises(InputError, match="nested too deep to be evaluated; split it"):
        read_sbml(tmp_path / "m.xml")
