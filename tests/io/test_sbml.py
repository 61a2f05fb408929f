"""SBML: models with closed-form solutions, results of the SBML test suite, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cicatrix.bench.networks import HOUR, Sets, network, numpy_rate, sbml_text
from cicatrix.core.errors import InputError
from cicatrix.files.sbml import MISSING, read_sbml

HERE = Path(__file__).parent / "sbml"
try:
    import libsbml
except ImportError:
    pytestmark = pytest.mark.skip(reason=MISSING)

MATH = 'xmlns="http://www.w3.org/1998/Math/MathML"'
TOP = '<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1"><model id="m">'


def course(model, end, n=11):
    """Return states (n, n_species) at even times, integrated by SciPy with our rates."""
    times = np.linspace(0.0, end, n)
    rate = lambda t, y: np.asarray(model.law.rate(y, None, t))  # noqa: E731
    return times, solve_ivp(rate, (0.0, end), model.start, "LSODA", times, rtol=1e-9, atol=1e-13).y.T


def test_a_model_of_ours_is_its_closed_form():
    """A <-> B: A = 1 + 2 exp(-0.75 t) by hand, with k_on = 2 / 4, k = 0.25, A + B = 6 mol / 2 l."""
    model = read_sbml(HERE / "reversible.xml")
    assert model.law.species == ("A", "B", "N", "clock")
    assert dict(zip(model.law.input_names, model.inputs)) == {"cell": 2.0, "double": 2.0, "back_k": 0.25}
    free = read_sbml(HERE / "reversible.xml", None, {"k_on": ()})
    assert dict(zip(free.law.input_names, free.inputs))["k_on"] == 0.5  # it is an input of its own where a case sets it
    assert not model.law.is_time_dependent
    t, y = course(model, 4.0)
    a = 1.0 + 2.0 * np.exp(-0.75 * t)
    made = 2.0 * 2.0 * 0.5 * (t + 2.0 / 0.75 * (1.0 - np.exp(-0.75 * t)))  # twice the integral of 2 l * k_on * A
    np.testing.assert_allclose(y, np.column_stack([a, 3.0 - a, 1.0 + made, 2.0 * t]), atol=1e-6)


def test_time_is_counted_in_the_unit_that_is_said():
    second, hour = read_sbml(HERE / "reversible.xml"), read_sbml(HERE / "reversible.xml", "h")
    np.testing.assert_allclose(hour.law.rate(hour.start) * 3600.0, second.law.rate(second.start))


def test_batches_of_constants():
    law = read_sbml(HERE / "reversible.xml").law
    y, k = np.random.default_rng(1).random((5, 4)), np.tile(law.values, (5, 1)) * np.arange(1, 6)[:, None]
    together = np.asarray(law.rate(y, k))
    for i in range(5):
        np.testing.assert_allclose(together[i], law.rate(y[i], k[i]))


def mass_action(reactions, start, constants, changing, compartment=1.0):
    """Write a model of mass action: reactions are (reactants, products, constant)."""

    def side(name, species):
        links = "".join(f'<speciesReference species="{one}" stoichiometry="1" constant="true"/>' for one in species)
        return f"<listOf{name}>{links}</listOf{name}>" if links else ""

    kinds = "".join(
        f'<species id="{name}" compartment="c" initialAmount="{value}" hasOnlySubstanceUnits="false" '
        f'boundaryCondition="{str(name not in changing).lower()}" constant="false"/>'
        for name, value in start.items()
    )
    values = "".join(f'<parameter id="{name}" value="{value}" constant="true"/>' for name, value in constants.items())
    laws = "".join(
        f'<reaction id="r{i}" reversible="false" fast="false">{side("Reactants", left)}{side("Products", right)}'
        f"<kineticLaw><math {MATH}><apply><times/>{''.join(f'<ci>{one}</ci>' for one in ('c', k, *left))}</apply></math>"
        "</kineticLaw></reaction>"
        for i, (left, right, k) in enumerate(reactions)
    )
    return (
        f'{TOP}<listOfCompartments><compartment id="c" spatialDimensions="3" size="{compartment}" constant="true"/>'
        f"</listOfCompartments><listOfSpecies>{kinds}</listOfSpecies><listOfParameters>{values}</listOfParameters>"
        f"<listOfReactions>{laws}</listOfReactions></model></sbml>"
    )


def test_semantic_case_15(tmp_path):
    """S1 + S2 <-> S3 + S4; constants, start and results (to their 15 digits, some rows) of sbml-test-suite, semantic 00015."""
    path = tmp_path / "case.xml"
    both = [(("S1", "S2"), ("S3", "S4"), "k1"), (("S3", "S4"), ("S1", "S2"), "k2")]
    start = {"S1": 0.001, "S2": 0.001, "S3": 0.002, "S4": 0.001}
    path.write_text(mass_action(both, start, {"k1": 750, "k2": 250}, set(start)))
    _, y = course(read_sbml(path), 2.5, 6)
    s1 = [0.001, 0.0009245074632981542, 0.0008991576080333725, 0.0008905136976823736, 0.000887550875076103]
    np.testing.assert_allclose(y[:, 0], [*s1, 0.0008865335160035233], rtol=1e-6)
    np.testing.assert_allclose(y[:, 2], 0.003 - y[:, 0], rtol=1e-9)


def test_semantic_case_8(tmp_path):
    """S2 is a boundary: S1 = (1.5 + 1.5 exp(-k1 t)) / 2 ...; start of sbml-test-suite, semantic 00008, closed form by hand."""
    path = tmp_path / "case.xml"
    pair = [(("S1",), ("S2",), "k1"), (("S2",), ("S1",), "k2")]
    path.write_text(mass_action(pair, {"S1": 0.15, "S2": 0.15}, {"k1": 0.5, "k2": 0.25}, {"S1"}))
    model = read_sbml(path)
    assert model.law.species == ("S1",)
    assert "S2" in model.law.input_names
    t, y = course(model, 10.0)
    np.testing.assert_allclose(y[:, 0], 0.075 * (1.0 + np.exp(-0.5 * t)), rtol=1e-6)
    assert y[-1, 0] / 0.15 == pytest.approx(7.55053e-16 / 1.5e-15, rel=1e-3)  # their last row, scaled by its start


def test_a_network_of_hill_functions_written_as_sbml_is_itself(tmp_path):
    """The benchmark's network as SBML, as the NumPy function for SciPy and as our law has the same rate."""
    law = network()
    path = tmp_path / "network.xml"
    path.write_text(sbml_text(law, libsbml))
    model, y = read_sbml(path), np.random.default_rng(1).random(len(law.species))
    ours = np.asarray(law.rate(y)) * HOUR
    theirs = dict(
        zip(model.law.species, np.asarray(model.law.rate(y[[law.species.index(s) for s in model.law.species]])))
    )
    np.testing.assert_allclose([theirs[name] * HOUR for name in law.species], ours, atol=1e-9)
    rate = numpy_rate(law, Sets(law.tau, law.weight, law.ec50))
    np.testing.assert_allclose(rate(0.0, y) * HOUR, ours, atol=1e-9)


RULE = (
    '<listOfParameters><parameter id="x" value="1" constant="false"/></listOfParameters><listOfRules>{}</listOfRules>'
)
SPECIES = (
    '<listOfCompartments><compartment id="c" spatialDimensions="3" size="1" constant="true"/></listOfCompartments>'
    '<listOfSpecies><species id="S" compartment="c" initialAmount="1" hasOnlySubstanceUnits="true" boundaryCondition="false" '
    'constant="false"/></listOfSpecies><listOfParameters><parameter id="k" value="1" constant="true"/></listOfParameters>'
    '<listOfReactions><reaction id="r" reversible="false" fast="false"><listOfReactants><speciesReference species="S" '
    'stoichiometry="1" constant="true"/></listOfReactants>{}</reaction></listOfReactions>'
)
REFUSED = {
    "delay": (
        RULE.format(
            f'<rateRule variable="x"><math {MATH}><apply><csymbol encoding="text" '
            'definitionURL="http://www.sbml.org/sbml/symbols/delay">delay</csymbol><ci>x</ci><cn>1</cn></apply></math></rateRule>'
        ),
        "uses delays (values of the past), which neither cicatrix nor libroadrunner can integrate",
    ),
    "unknown": (
        SPECIES.format(f"<kineticLaw><math {MATH}><apply><times/><ci>K</ci><ci>S</ci></apply></math></kineticLaw>"),
        'reaction "r" names the unknown id "K"; did you mean "k"?',
    ),
    "unknown in a rule": (
        RULE.format(f'<rateRule variable="x"><math {MATH}><ci>speed</ci></math></rateRule>'),
        'the rule of "x" names the unknown id "speed"; known: x',
    ),
    "without a law": (SPECIES.format(""), 'reaction "r" has no kinetic law'),
    "nothing": ("", "nothing changes in this model: it has no reaction, no rule and no event that changes a quantity"),
    "no initial value": (
        '<listOfParameters><parameter id="x" constant="false"/></listOfParameters><listOfRules>'
        f'<rateRule variable="x"><math {MATH}><cn>1</cn></math></rateRule></listOfRules>',
        '"x" has no initial value',
    ),
    "not valid": ('<listOfParameters><parameter id="x"/></listOfParameters>', "not valid SBML"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_supported_is_named(name, tmp_path):
    inside, sentence = REFUSED[name]
    path = tmp_path / "model.xml"
    path.write_text(f"{TOP}{inside}</model></sbml>")
    with pytest.raises(InputError, match=re.escape(sentence)) as error:
        read_sbml(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (" \n", "is empty"),
        ("species,reaction\n", "is not an SBML file: there is no <sbml> in it"),
        ("<html></html>", "is not an SBML file: there is no <sbml> in it"),
        ("<sbml", "not valid SBML"),
    ],
)
def test_no_sbml_is_refused(text, words, tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_sbml(path)


def test_a_folder_is_refused(tmp_path):
    with pytest.raises(InputError, match=f"^{re.escape(str(tmp_path))} is a folder; a file is needed$"):
        read_sbml(tmp_path)


def test_a_formula_of_everything(tmp_path):
    """Time, pieces, powers, roots and logarithms: x' by hand at two times."""
    formula = (
        '<piecewise><piece><apply><power/><ci>x</ci><cn>3</cn></apply><apply><lt/><csymbol encoding="text" '
        'definitionURL="http://www.sbml.org/sbml/symbols/time">t</csymbol><cn>1</cn></apply></piece><otherwise><apply><plus/>'
        "<apply><root/><degree><cn>3</cn></degree><cn>8</cn></apply><apply><log/><logbase><cn>2</cn></logbase><cn>32</cn>"
        "</apply><apply><minus/><pi/></apply></apply></otherwise></piecewise>"
    )
    inside = RULE.format(f'<rateRule variable="x"><math {MATH}>{formula}</math></rateRule>').replace(
        'value="1"', 'value="2"'
    )
    path = tmp_path / "model.xml"
    path.write_text(f"{TOP}{inside}</model></sbml>")
    law = read_sbml(path).law
    assert law.is_time_dependent
    np.testing.assert_allclose(law.rate(np.array([2.0]), None, 0.5), [8.0])
    np.testing.assert_allclose(law.rate(np.array([2.0]), None, 1.5), [2.0 + 5.0 - np.pi])


def test_a_stoichiometry_of_level_1_is_a_fraction(tmp_path):
    text = """<sbml xmlns="http://www.sbml.org/sbml/level1" level="1" version="2"><model name="m"><listOfCompartments>
    <compartment name="c" volume="1"/></listOfCompartments><listOfSpecies><species name="A" compartment="c" initialAmount="4"/>
    <species name="B" compartment="c" initialAmount="0"/></listOfSpecies><listOfReactions><reaction name="J"><listOfReactants>
    <speciesReference species="A"/></listOfReactants><listOfProducts>
    <speciesReference species="B" stoichiometry="3" denominator="2"/></listOfProducts><kineticLaw formula="0.2 * A"/></reaction>
    </listOfReactions></model></sbml>"""
    (tmp_path / "m.xml").write_text(text)
    model = read_sbml(tmp_path / "m.xml")
    # by hand: 0.2 * 4 = 0.8 of A are lost, 3/2 of them appear as B
    np.testing.assert_allclose(model.law.rate(model.start), [-0.8, 1.2])


@pytest.mark.parametrize(
    ("units", "seconds", "said"),
    [
        ('<unit kind="dimensionless" exponent="1" scale="0" multiplier="60"/>{second}', 60.0, False),
        ("{second}{second}", 1.0, True),
        ('<unit kind="mole" exponent="1" scale="0" multiplier="60"/>', 1.0, True),
    ],
)
def test_a_unit_of_time_may_have_parts(units, seconds, said, tmp_path):
    units = units.format(second='<unit kind="second" exponent="1" scale="0" multiplier="1"/>')
    text = f"""<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1"><model id="m" timeUnits="t">
    <listOfUnitDefinitions><unitDefinition id="t"><listOfUnits>{units}</listOfUnits></unitDefinition></listOfUnitDefinitions>
    <listOfParameters><parameter id="x" value="1" constant="false"/></listOfParameters><listOfRules><rateRule variable="x">
    <math xmlns="http://www.w3.org/1998/Math/MathML"><cn>1</cn></math></rateRule></listOfRules></model></sbml>"""
    (tmp_path / "m.xml").write_text(text)
    model = read_sbml(tmp_path / "m.xml")
    assert model.law.seconds == seconds
    assert [note for note in model.notes if '"t", which is no time' in note] == list(model.notes[: int(said)])
