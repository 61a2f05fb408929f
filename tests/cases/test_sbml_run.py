"""Cases of kind "signalling" with SBML: which engine ran, what a case sets, and what is left out."""

import json
import re

import numpy as np
import pytest

import cicatrix
from cicatrix.biology import roadrunner as engine
from cicatrix.biology.switches import depends_on_constants
from cicatrix.cli.main import main
from cicatrix.files.history import read_history
from cicatrix.kinds.registry import check_case, load_case

pytest.importorskip("libsbml", reason="needs python-libsbml")
pytest.importorskip("roadrunner", reason="needs libroadrunner")

MATH = 'xmlns="http://www.w3.org/1998/Math/MathML"'
TOP = '<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1"><model id="m" timeUnits="second">'
DOSES = f"""{TOP}<listOfCompartments><compartment id="c" spatialDimensions="3" size="1" constant="true"/></listOfCompartments>
<listOfSpecies><species id="X" compartment="c" initialAmount="1" hasOnlySubstanceUnits="false" boundaryCondition="false"
constant="false"/></listOfSpecies><listOfParameters><parameter id="k" value="1" constant="true"/></listOfParameters>
<listOfReactions><reaction id="r" reversible="false" fast="false"><listOfReactants><speciesReference species="X"
stoichiometry="1" constant="true"/></listOfReactants><kineticLaw><math {MATH}><apply><times/><ci>k</ci><ci>X</ci><ci>c</ci>
</apply></math></kineticLaw></reaction></listOfReactions><listOfEvents><event useValuesFromTriggerTime="true"><trigger
initialValue="true" persistent="true"><math {MATH}><apply><leq/><ci>X</ci><cn>0.5</cn></apply></math></trigger>
<listOfEventAssignments><eventAssignment variable="X"><math {MATH}><cn>1</cn></math></eventAssignment>
</listOfEventAssignments></event></listOfEvents></model></sbml>"""
HALVED = np.log(2.0)


@pytest.fixture
def case_file(tmp_path):
    def write(model, table=""):
        (tmp_path / "model.xml").write_text(model)
        time = "[time]\nduration_h = 3.0\nstep_h = 0.25\n"
        (tmp_path / "case.toml").write_text(
            f'kind = "signalling"\n{table}[network]\nsbml = "model.xml"\ntime_unit = "h"\n{time}'
        )
        return tmp_path / "case.toml"

    return write


def test_a_network_with_events_runs_by_libroadrunner(case_file, tmp_path):
    """X decays from 1 and is filled up whenever it is at a half: X = exp(-(t mod ln 2))."""
    results = cicatrix.simulate(load_case(case_file(DOSES)), tmp_path / "run")
    np.testing.assert_allclose(results.history["X"], np.exp(-(results.history["time_h"] % HALVED)), rtol=1e-6)
    assert results.outcome["engine"].value == "libroadrunner"
    assert results.outcome["end"].value == {"X": results.history["X"][-1]}
    assert "n_stable_states" not in results.outcome
    assert any(
        "since it has events; steady states and sensitivities are not computed" in one
        for one in results.manifest["notes"]
    )
    assert (tmp_path / "run" / "figures" / "courses.png").is_file()
    assert not list((tmp_path / "run" / "tables").glob("*"))
    assert check_case(tmp_path / "case.toml") == []


def test_an_input_of_a_delegated_network_changes(case_file, tmp_path):
    """From 0.5 h on k = 0: X stays at exp(-0.5)."""
    path = case_file(DOSES, "[set]\nk = { time_h = [0.5], value = [0.0] }\n")
    history = cicatrix.simulate(load_case(path)).history
    np.testing.assert_allclose(history["X"], np.exp(-np.minimum(history["time_h"], 0.5)), rtol=1e-6)
    np.testing.assert_array_equal(history["input_k"], np.where(history["time_h"] < 0.5, 1.0, 0.0))


def test_two_runs_of_a_delegated_network_are_equal_to_the_byte(case_file, tmp_path):
    path = case_file(DOSES)
    for name in ("one", "two"):
        assert main(["run", str(path), "--out", str(tmp_path / name)]) == 0
    one, two = ((tmp_path / name / "history.csv").read_bytes() for name in ("one", "two"))
    assert one == two
    assert main(["run", str(path), "--out", str(tmp_path / "one"), "--resume"]) == 0
    assert (tmp_path / "one" / "history.csv").read_bytes() == one


def test_without_libroadrunner_a_sentence_says_what_to_install(case_file, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(engine, "find_spec", lambda name: None)
    assert main(["run", str(case_file(DOSES)), "--out", str(tmp_path / "run")]) == 2
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("cicatrix: ")]
    assert len(told) == 1
    assert "pip install 'cicatrix[sbml]'" in told[0]


def test_what_a_delegated_network_cannot_is_said(case_file):
    path = case_file(DOSES, '[steady]\nover = "k"\nvalues = [1.0, 2.0]\n')
    results = cicatrix.simulate(load_case(path))
    assert any(re.search("steady states and sensitivities are not computed", one) for one in results.manifest["notes"])


def test_a_compartment_that_a_case_changes_keeps_the_amounts(case_file, tmp_path):
    """In 1 l, from 1 h on in 4 l: X = exp(-t), then exp(-t) / 4, at 1 h already; the rate law has the engine of our own."""
    model = re.sub("<listOfEvents>.*</listOfEvents>", "", DOSES, flags=re.DOTALL)
    solver = '[solver]\nmethod = "explicit"\nrelative_tolerance = 1e-9\nabsolute_tolerance = 1e-12\n'
    path = case_file(model, solver + '[set]\nc = { time_h = [1.0], value = [4.0] }\n[sensitivity]\nat = "none"\n')
    assert main(["run", str(path), "--out", str(tmp_path / "run")]) == 0
    history = read_history(tmp_path / "run" / "history.csv")
    right = np.exp(-history["time_h"]) / np.where(history["time_h"] < 1.0, 1.0, 4.0)
    np.testing.assert_allclose(history["X"], right, rtol=1e-6)
    assert json.loads((tmp_path / "run" / "outcome.json").read_text())["engine"]["value"] == "cicatrix"


def test_a_delegated_network_that_has_no_course_is_told(case_file, tmp_path, capfd):
    """By hand: x' = x^2 from 1 has no value at 1 h."""
    grow = f'<rateRule variable="k"><math {MATH}><apply><times/><ci>k</ci><ci>k</ci></apply></math></rateRule>'
    model = DOSES.replace('value="1" constant="true"', 'value="1" constant="false"')
    model = model.replace("<listOfReactions>", f"<listOfRules>{grow}</listOfRules><listOfReactions>")
    path = case_file(model, "[solver]\nmax_steps = 2000\n")
    assert main(["run", str(path), "--out", str(tmp_path / "run")]) == 3
    told = capfd.readouterr().err.splitlines()
    assert sum(line.startswith("cicatrix: libroadrunner could not follow the model to its end (") for line in told) == 1
    assert not [line for line in told if "CVode" in line and not line.startswith("cicatrix: ")]


def test_a_row_at_the_instant_of_an_event_is_after_it(case_file):
    """An event at 7 s, and rows every second: 1 s is no decimal number of hours."""
    at = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time">t</csymbol><cn>7</cn>'
    model = DOSES.replace("<leq/><ci>X</ci><cn>0.5</cn>", f"<geq/>{at}").replace("<ci>k</ci><ci>X</ci>", "<cn>0</cn>")
    model = model.replace(f"<math {MATH}><cn>1</cn></math>", f"<math {MATH}><cn>5</cn></math>")
    case = load_case(
        case_file(model), ["network.time_unit=s", f"time.duration_h={10 / 3600}", f"time.step_h={1 / 3600}"]
    )
    np.testing.assert_allclose(cicatrix.simulate(case).history["X"], [1.0] * 7 + [5.0] * 4)


def test_a_rule_switches_at_the_row_of_its_instant(case_file):
    """From 7 s on k2 is 1; rows every second, by the engine of our own: x' = 1."""
    at = '<apply><geq/><csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time">t</csymbol><cn>7</cn></apply>'
    piece = f"<piecewise><piece><cn>1</cn>{at}</piece><otherwise><cn>0</cn></otherwise></piecewise>"
    names = "".join(f'<parameter id="{name}" value="0" constant="false"/>' for name in ("x", "k2"))
    rules = (
        f'<rateRule variable="x"><math {MATH}><cn>1</cn></math></rateRule>'
        f'<assignmentRule variable="k2"><math {MATH}>{piece}</math></assignmentRule>'
    )
    model = f"{TOP}<listOfParameters>{names}</listOfParameters><listOfRules>{rules}</listOfRules></model></sbml>"
    settings = [
        "network.time_unit=s",
        f"time.duration_h={10 / 3600}",
        f"time.step_h={1 / 3600}",
        "solver.method=explicit",
    ]
    history = cicatrix.simulate(load_case(case_file(model), [*settings, "sensitivity.at=none"])).history
    np.testing.assert_array_equal(history["k2"], [0.0] * 7 + [1.0] * 4)
    np.testing.assert_allclose(history["x"], np.arange(11.0), rtol=1e-9, atol=1e-12)


def test_a_pulse_between_two_rows_is_not_missed(tmp_path):
    time = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time">t</csymbol>'
    pulse = f"""<piecewise><piece><ci>k</ci><apply><and/><apply><gt/>{time}<cn>2</cn></apply><apply><lt/>{time}<apply><plus/>
    <cn>2</cn><ci>d</ci></apply></apply></apply></piece><otherwise><cn>0</cn></otherwise></piecewise>"""
    text = f"""{TOP}<listOfParameters><parameter id="x" value="0" constant="false"/><parameter id="k" value="3" constant="true"/>
    <parameter id="d" value="0.01" constant="true"/></listOfParameters><listOfRules><rateRule variable="x"><math {MATH}>{pulse}
    </math></rateRule></listOfRules></model></sbml>"""
    (tmp_path / "model.xml").write_text(text)
    tables = {
        "kind": "signalling",
        "network": {"sbml": str(tmp_path / "model.xml"), "time_unit": "h"},
        "time": {"duration_h": 10.0, "step_h": 5.0},
        "set": {"k": {"time_h": [0.0, 2.005], "value": [3.0, 5.0]}},
        "sensitivity": {"at": "none"},
    }
    result = cicatrix.simulate(cicatrix.case_from(tables))
    # by hand: 3 * 0.005 + 5 * 0.005
    assert result.history["x"][-1] == pytest.approx(0.04, rel=1e-5)
    assert depends_on_constants(cicatrix.build(cicatrix.case_from(tables)).model.law)
