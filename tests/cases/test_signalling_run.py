"""Cases of kind "signalling": from file to folder, stopped and resumed, and what is refused."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import cicatrix
from cicatrix.cli.main import main
from cicatrix.files.history import read_history
from cicatrix.kinds.registry import check_case, load_case

pytestmark = pytest.mark.xdist_group("signalling networks")
ROOT = Path(__file__).parents[2]
SPECIES = "id,y_init,y_max,tau_h\nA,0.2,1,0.5\nB,1,1,1\n\nC,0,0.5,2\n"
REACTIONS = "id,rule,weight,n,ec50,source\nin,=> A,0.25,1.4,0.5,\nr1,A & !C => B,1,1.4,0.5,x\nr2,B => C,1,1.4,0.5,y\n"
CASE = """
kind = "signalling"
[network]
species = "species.csv"
reactions = "reactions.csv"
[set]
A = { time_h = [1.0, 2.3], value = [0.8, 0.4] }
[time]
duration_h = 6.0
step_h = 0.5
[steady]
starts = 3
[solver]
method = "explicit"
relative_tolerance = 1e-8
absolute_tolerance = 1e-10
"""


@pytest.fixture
def case_file(tmp_path):
    def write(species=SPECIES, reactions=REACTIONS, case=CASE):
        for name, text in (("species.csv", species), ("reactions.csv", reactions), ("case.toml", case)):
            (tmp_path / name).write_text(text)
        return tmp_path / "case.toml"

    return write


def input_alone(t):
    """Return species A by hand: its input is 0.25, from 1 h on 0.8, from 2.3 h on 0.4, and its time constant 0.5 h."""

    def follow(y, goal, spent):
        return goal + (y - goal) * np.exp(-spent / 0.5)

    at_1 = follow(0.2, 0.25, 1.0)
    at_2 = follow(at_1, 0.8, 1.3)
    late = np.where(t <= 2.3, follow(at_1, 0.8, t - 1.0), follow(at_2, 0.4, t - 2.3))
    return np.where(t <= 1.0, follow(0.2, 0.25, t), late)


def test_a_run_and_its_folder(case_file, tmp_path):
    results = cicatrix.simulate(load_case(case_file()), tmp_path / "run")
    history, outcome = results.history, results.outcome
    assert list(history) == ["step", "time_h", "A", "B", "C", "input_A"]
    np.testing.assert_array_equal(history["time_h"], np.arange(13) * 0.5)
    np.testing.assert_allclose(history["A"], input_alone(history["time_h"]), atol=1e-7)
    np.testing.assert_array_equal(history["input_A"], [0.25] * 2 + [0.8] * 3 + [0.4] * 8)
    assert outcome["end"].value["A"] == history["A"][-1]
    assert (outcome["n_stable_states"].value, outcome["is_bistable"].value) == (1, "no")
    (state,) = outcome["steady_states"].value
    assert (state["is_stable"], state["n_starts"]) == (True, 7)  # own start, low, high, end of the run, 3 random
    assert state["values"]["A"] == pytest.approx(0.4)
    assert state["growth_per_h"] < 0.0
    for name in ("courses", "steady_states", "sensitivities"):
        assert (tmp_path / "run" / "figures" / f"{name}.png").stat().st_size > 5000
    with (tmp_path / "run" / "tables" / "sensitivities.csv").open() as stream:
        rows = {(row["output"], row["kind"], row["of"]): row for row in csv.DictReader(stream)}
    assert len(rows) == 3 * (2 * 3 + 3 * 3 + 1)
    assert float(rows["A", "input", "A"]["derivative"]) == pytest.approx(1.0)
    assert float(rows["A", "input", "A"]["relative"]) == pytest.approx(0.4)
    assert float(rows["C", "y_max", "C"]["value"]) == 0.5
    assert float(rows["B", "tau_h", "C"]["derivative"]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_the_example_remembers(tmp_path):
    """Hysteresis: before and after a day on a stiff matrix, the network is in different states at the same stiffness."""
    results = cicatrix.simulate(load_case(ROOT / "examples" / "signalling.toml"), tmp_path / "run")
    outcome, history = results.outcome, results.history
    assert outcome["is_bistable"].value == "yes"
    assert outcome["state_from_own_start"].value != outcome["state_from_end"].value
    before, after = (history["YAP"][np.searchsorted(history["time_h"], t)] for t in (47.5, 144.0))
    assert (before, after) == (pytest.approx(0.02, abs=0.01), pytest.approx(0.91, abs=0.01))
    assert [state["is_stable"] for state in outcome["steady_states"].value] == [True, True, False]
    assert (tmp_path / "run" / "figures" / "steady_branches.png").is_file()


def test_every_link_of_the_example_has_a_source():
    with (ROOT / "examples" / "signalling" / "reactions.csv").open() as stream:
        for row in csv.DictReader(stream):
            assert (
                row["source"] == "input"
                if row["rule"].startswith("=>")
                else any(year in row["source"] for year in "12")
            )


FAULTS = {
    "no network": (
        ["network={}"],
        "network.species is missing: name CSV files by species and reactions, or an SBML file by sbml",
    ),
    "one file": (
        ["network={species='species.csv'}"],
        "network.reactions is missing: a network in CSV files needs both species and reactions",
    ),
    "both": (
        ["network.sbml=species.csv"],
        "network.sbml must be given without species and reactions, or those two without it",
    ),
    "no number": (["set.A=high"], 'set.A must be a number, or a table of time_h and value, both lists; got "high"'),
    "short": (["set.A={time_h=[0, 1], value=[1]}"], "set.A.value must have as many values as time_h (2); got 1"),
    "stands": (
        ["set.A={time_h=[1, 1], value=[1, 0]}"],
        "set.A.time_h must be at least one time, ascending; got [1, 1]",
    ),
    "near key": (["time.duration=3"], "time.duration is not a known key; did you mean time.duration_h?"),
    "too many rows": (["time.step_h=1e-9"], "time.step_h must be at least duration_h / 1e+06; got 1e-09"),
    "no values": (
        ["steady.over=A"],
        "steady.values and over belong together: over names an input, values are what it is set to",
    ),
    "method": (["solver.method=magic"], 'solver.method must be "implicit" or "explicit"; got "magic"'),
}


@pytest.mark.parametrize("name", FAULTS)
def test_one_fault_one_sentence(name, case_file):
    settings, sentence = FAULTS[name]
    assert check_case(case_file(), settings) == [sentence]


REFUSED = {
    "rule": (
        {"reactions": REACTIONS.replace("A & !C", "A && C")},
        [],
        'reaction "r1" has the rule "A && C => B", which does not',
    ),
    "unknown": ({"reactions": REACTIONS.replace("!C", "!c1")}, [], 'reaction "r1" names the unknown species "c1"'),
    "ec50": ({"reactions": REACTIONS.replace("0.5,y", "1.7,y")}, [], 'reaction "r2": ec50 must be above 0 and below 1'),
    "text": ({"species": SPECIES.replace("0.2", "low")}, [], 'row 2, column y_init: "low" is not a number'),
    "tau": ({"species": SPECIES.replace("0,0.5,2", "0,0.5,0")}, [], 'species "C": tau_h must be above 0; got 0'),
    "tau below 0": (
        {"species": SPECIES.replace("0,0.5,2", "0,0.5,-1")},
        [],
        'species "C": tau_h must be above 0; got -1',
    ),
    "no number at all": (
        {"species": SPECIES.replace("0.2", "nan")},
        [],
        'row 2, column y_init: must be a number; "A" has none',
    ),
    "start": ({"species": SPECIES.replace("0.2", "-0.2")}, [], 'species "A": y_init must be at least 0; got -0.2'),
    "column": (
        {"species": SPECIES.replace("tau_h", "lag")},
        [],
        "column tau_h is missing; there are id, y_init, y_max, lag",
    ),
    "ragged": (
        {"species": SPECIES.replace("B,1,1,1", "B,1,1")},
        [],
        "row 3 must have 4 columns, like the row of names; got 3",
    ),
    "twice": ({"species": SPECIES + "A,0,1,1\n"}, [], 'species "A" is listed twice'),
    "column of the history": ({"species": SPECIES + "step,0,1,1\n"}, [], 'species "step" must have another name'),
    "empty": ({"species": "\n"}, [], "is empty: it must start with a row of column names, id, y_init, y_max, tau_h"),
    "no rows": ({"species": "id,y_init,y_max,tau_h\n"}, [], "species.csv has no rows below its column names"),
    "a folder": ({}, ["network.species=."], " is a folder; a file is needed"),
    "no input": ({}, ["set.B=1"], 'set names "B", which is no input of the network; known: A'),
    "no output": (
        {},
        ["sensitivity.outputs=['Z']"],
        'sensitivity.outputs names "Z", which is no species of the network',
    ),
    "beyond": ({}, ["set.A=1.5"], "set.A must be in [0, 1]; got 1.5"),
    "late": ({}, ["time.duration_h=2"], "set.A changes at 2.3 h, after time.duration_h = 2"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_faulty_network_is_a_sentence_and_leaves_nothing(name, case_file, tmp_path, capsys):
    files, settings, sentence = REFUSED[name]
    path = case_file(**files)
    arguments = [part for setting in settings for part in ("--set", setting)]
    (fault,) = check_case(path, settings)
    assert sentence in fault
    assert main(["run", str(path), *arguments, "--out", str(tmp_path / "run")]) == 2
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("cicatrix: ")]
    assert len(told) == 1
    assert sentence in told[0]
    assert not (tmp_path / "run").exists()


def test_a_solver_that_gives_up_is_told_and_the_rows_are_kept(case_file, tmp_path, capsys):
    path = case_file()
    settings = ["--set", "solver.max_steps=30", "--set", "set.A={time_h=[1.0], value=[0.8]}"]
    assert main(["run", str(path), *settings, "--out", str(tmp_path / "run")]) == 3
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("cicatrix: ")]
    assert len(told) == 1
    assert "The network could not be followed beyond" in told[0]
    assert 'solver.method = "implicit"' in told[0]
    kept = read_history(tmp_path / "run" / "history.csv")["time_h"]
    assert list(kept[:3]) == [0.0, 0.5, 1.0]
    assert kept[-1] < 6.0
    status = json.loads((tmp_path / "run" / "manifest.json").read_text())["status"]
    assert status["state"] == "failed"


def test_a_stiff_blow_up_is_told(case_file, tmp_path, capsys):
    """By hand: x' = x^2 from 1 at 0 is 1 / (1 - t), without bound at 1 s."""
    pytest.importorskip("libsbml", reason="needs python-libsbml")
    (tmp_path / "model.xml").write_text(
        '<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1"><model id="m"><listOfParameters>'
        '<parameter id="x" value="1" constant="false"/></listOfParameters><listOfRules><rateRule variable="x"><math '
        'xmlns="http://www.w3.org/1998/Math/MathML"><apply><times/><ci>x</ci><ci>x</ci></apply></math></rateRule>'
        "</listOfRules></model></sbml>"
    )
    table = '[network]\nsbml = "model.xml"\ntime_unit = "h"\n'
    path = case_file(
        case=f'kind = "signalling"\n{table}[time]\nduration_h = 2\n[solver]\nmethod = "explicit"\nmax_steps = 2000\n'
    )
    assert main(["run", str(path), "--set", "solver.max_steps=2000", "--out", str(tmp_path / "run")]) == 3
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("cicatrix: ")]
    assert len(told) == 1
    assert "could not be followed beyond 1 h, where x is " in told[0]
    history = read_history(tmp_path / "run" / "history.csv")
    assert history["x"][1] == pytest.approx(2.0, rel=1e-4)  # at 0.5 h


def test_sbml_rests_where_its_own_start_leads(case_file, tmp_path):
    """A conserved sum gives a continuum of steady states: the run says so and gives no sensitivities."""
    pytest.importorskip("libsbml", reason="needs python-libsbml")
    model = (ROOT / "tests" / "io" / "sbml" / "reversible.xml").read_text()
    clock = model[model.index("<rateRule") : model.index("</rateRule>") + len("</rateRule>")]
    model = model.replace(clock, "").replace('<speciesReference species="N" stoichiometry="2" constant="true"/>', "")
    (tmp_path / "model.xml").write_text(model)
    table = '[network]\nsbml = "model.xml"\n[set]\nk_on = 0.75\n[time]\nduration_h = 0.01\nstep_h = 0.001\n'
    results = cicatrix.simulate(
        load_case(case_file(case=f'kind = "signalling"\n{table}[solver]\nmethod = "explicit"\n'))
    )
    (state,) = results.outcome["steady_states"].value
    assert state["values"]["A"] == pytest.approx(
        3.0 * 0.25 / (0.75 + 0.25), rel=1e-5
    )  # by hand: k / (k_on + k) of 3 mol/l
    assert results.outcome["n_conserved"].value == 1
    assert any("has no derivatives" in note for note in results.manifest["notes"])
