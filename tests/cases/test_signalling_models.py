"""Signalling networks as other programs write them: Netflux sheets, SBML in odd units, published sizes and exponents."""

import csv
import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from shared_inputs import FAULTS

import cicatrix
from cicatrix.cli.main import main
from cicatrix.core.errors import InputError
from cicatrix.files.history import read_history
from cicatrix.files.networks import read_network
from cicatrix.kinds.registry import check_case, load_case

pytestmark = pytest.mark.xdist_group("signalling networks")
MATH = 'xmlns="http://www.w3.org/1998/Math/MathML"'
NETFLUX_SPECIES = """Species,,,,,,
module,ID,name,Yinit,Ymax,tau,type
inputs,,,,,,
,CREB,CREB,0,1,0.1,protein
,CBP,CBP,0,1,0.1,protein
genes,,,,,,
,IL6,interleukin 6,0,1,10,mRNA
"""
NETFLUX_REACTIONS = """Reactions,,,,,,
module,ID,Rule,Weight,n,EC50,source
input,i1,=> CREB,0.8,1.4,0.5,
input,i2,=> CBP,0.4,1.4,0.5,
txn,r1,CREB + !CBP => IL6,0.9,1.4,0.5,
"""


def written(folder, **files):
    for name, text in files.items():
        (folder / name.replace("_csv", ".csv").replace("_toml", ".toml").replace("_xml", ".xml")).write_text(text)
    return folder


def sheets(folder, species=NETFLUX_SPECIES, reactions=NETFLUX_REACTIONS):
    written(folder, s_csv=species, r_csv=reactions)
    return folder / "s.csv", folder / "r.csv"


def test_netflux_sheets_are_read_as_netflux_means_them(tmp_path):
    """By hand: NOT is w - act, AND their product over w, so IL6 follows act_CREB (w - act_CBP) / w."""
    model = read_network(*sheets(tmp_path), may_assume=True)
    law = model.law
    assert (law.species, law.input_names, law.inhibition) == (("CREB", "CBP", "IL6"), ("CREB", "CBP"), "weighted")
    np.testing.assert_allclose(law.tau, [360.0, 360.0, 36000.0])
    half = 0.5**1.4

    def act(x):
        return 0.9 * (1 - half) * x**1.4 / (half + (1 - 2 * half) * x**1.4)

    expected = act(0.8) * (0.9 - act(0.4)) / 0.9
    assert law.activation(np.array([0.8, 0.4, 0.0]))[2] == pytest.approx(expected, rel=1e-12)
    assert any("taken as hours" in note for note in model.notes)
    assert any("NOT is w - act" in note for note in model.notes)


def test_what_netflux_leaves_open_can_be_said(tmp_path):
    model = read_network(*sheets(tmp_path), inhibition="complement", time_unit="min")
    np.testing.assert_allclose(model.law.tau, [6.0, 6.0, 600.0])
    assert (model.law.inhibition, model.notes) == ("complement", ())


@pytest.mark.parametrize(
    ("column", "seconds"), [("tau_h", 3600.0), ("tau_min", 60.0), ("Tau_s", 1.0), ("tau_d", 86400.0)]
)
def test_time_constants_in_the_unit_of_their_column(column, seconds, tmp_path):
    model = read_network(*sheets(tmp_path, NETFLUX_SPECIES.replace("tau", column)))
    np.testing.assert_allclose(model.law.tau, seconds * np.array([0.1, 0.1, 10.0]))
    assert (model.law.inhibition, model.notes) == ("complement", ())


def test_a_reaction_listed_twice_is_told(tmp_path):
    twice = NETFLUX_REACTIONS + ",r2,!CBP & CREB => IL6,0.5,2,0.5,\n"
    model = read_network(*sheets(tmp_path, reactions=twice), time_unit="h")
    assert (
        'Reactions "r1" and "r2" have the same rule, !CBP & CREB => IL6: each of them counts, joined by OR.'
        in model.notes
    )


def test_a_species_above_1_beside_a_pole_is_told(tmp_path):
    high = NETFLUX_SPECIES.replace("CREB,CREB,0,1", "CREB,CREB,0,2")
    model = read_network(
        *sheets(tmp_path, high, NETFLUX_REACTIONS.replace("0.9,1.4,0.5", "0.9,1.25,0.6")), time_unit="h"
    )
    assert any(note.startswith('"CREB" can exceed 1') for note in model.notes)


def test_a_time_constant_without_a_unit_is_refused_where_nothing_can_be_noted(tmp_path):
    with pytest.raises(InputError, match="the column tau states no unit: name it tau_h, tau_min, tau_s or tau_d"):
        read_network(*sheets(tmp_path))


@pytest.mark.parametrize("first", [b"PK\x03\x04", b"\xd0\xcf\x11\xe0"])
def test_a_workbook_is_a_sentence(first, tmp_path):
    species, reactions = sheets(tmp_path)
    species.write_bytes(first + bytes(100))
    with pytest.raises(
        InputError, match="is a spreadsheet workbook: save its sheets, species and reactions, as two CSV"
    ):
        read_network(species, reactions)


def layered(folder, n_inputs=9, n_species=109):
    """Write a network of cascades with feedback, AND and NOT, all of n = 1.25 and EC50 = 0.6; return the rules as data."""
    rng = np.random.Generator(np.random.Philox(109))
    names = [f"S{k:03d}" for k in range(n_species)]
    rules = [((), k) for k in range(n_inputs)]
    for k in range(n_inputs, n_species):
        for _ in range(rng.integers(1, 4)):
            near = rng.choice(np.arange(max(0, k - 20), min(n_species, k + 5)), rng.integers(1, 3), replace=False)
            rules.append((tuple((int(j), bool(rng.random() < 0.25)) for j in near), k))
    weight = np.where([not factors for factors, _ in rules], 0.4, np.round(rng.uniform(0.5, 1.0, len(rules)), 3))
    tau = np.round(rng.uniform(0.2, 3.0, n_species), 3)
    with (folder / "species.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([["ID", "Yinit", "Ymax", "tau"], *([one, 0, 1, t] for one, t in zip(names, tau))])
    with (folder / "reactions.csv").open("w", newline="") as stream:
        rows = [
            [f"r{i}", f"{' & '.join('!' * no + names[j] for j, no in factors)} => {names[k]}", w, 1.25, 0.6]
            for i, ((factors, k), w) in enumerate(zip(rules, weight))
        ]
        csv.writer(stream).writerows([["ID", "Rule", "Weight", "n", "EC50"], *rows])
    return rules, weight, tau


def printed_rates(y, rules, weight, tau):
    """Return dy/dt [1/h] from the function as printed, whose B and K^n are negative here, and NOT as in Netflux."""
    B = (0.6**1.25 - 1.0) / (2.0 * 0.6**1.25 - 1.0)
    x = np.maximum(y, 0.0) ** 1.25
    act, idle = B * x / (B - 1.0 + x), np.ones(len(y))
    for (factors, k), w in zip(rules, weight):
        parts = [w * (1.0 - act[j]) if no else w * act[j] for j, no in factors]
        idle[k] *= 1.0 - (np.prod(parts) / w ** (len(parts) - 1) if parts else w)
    return ((1.0 - idle) - y) / tau


def test_rates_of_a_network_of_published_size_and_exponents(tmp_path):
    rules, weight, tau = layered(tmp_path)
    assert 0.6 > 0.5 ** (1 / 1.25)  # where B and K^n of the printed function are negative
    law = read_network(tmp_path / "species.csv", tmp_path / "reactions.csv", time_unit="h").law
    for y in np.random.default_rng(1).random((3, 109)):
        np.testing.assert_allclose(law.rate(y) * 3600.0, printed_rates(y, rules, weight, tau), atol=1e-12)


@pytest.mark.slow
def test_a_network_of_published_size_and_exponents_runs(tmp_path):
    rules, weight, tau = layered(tmp_path)
    case = 'kind="signalling"\n[network]\nspecies="species.csv"\nreactions="reactions.csv"\n[set]\nS000=0.9\n[time]\n'
    more = "duration_h=40\nstep_h=4\n[steady]\nstarts=0\n[sensitivity]\nat='none'\n[solver]\nmethod='explicit'\n"
    written(tmp_path, case_toml=case + more)
    assert main(["run", str(tmp_path / "case.toml"), "--out", str(tmp_path / "run")]) == 0
    history = read_history(tmp_path / "run" / "history.csv")
    weight = weight.copy()
    weight[0] = 0.9
    times = history["time_h"]
    theirs = solve_ivp(
        lambda t, y: printed_rates(y, rules, weight, tau), (0, 40), np.zeros(109), "LSODA", times, rtol=1e-9
    )
    ours = np.array([history[f"S{k:03d}"] for k in range(109)])
    np.testing.assert_allclose(ours, theirs.y, atol=2e-6)
    outcome = json.loads((tmp_path / "run" / "outcome.json").read_text())
    assert outcome["n_unsettled_starts"]["value"] == 0
    at_rest = np.array(list(outcome["steady_states"]["value"][0]["values"].values()))
    np.testing.assert_allclose(printed_rates(at_rest, rules, weight, tau), 0.0, atol=1e-9)


def sbml(species, constants, rates, varied=None):
    """Write SBML of rate rules (name -> MathML) on species (name -> amount) and on parameters that vary."""
    links = "".join(
        f'<rateRule variable="{name}"><math {MATH}>{math}</math></rateRule>' for name, math in rates.items()
    )
    kinds = "".join(
        f'<species id="{name}" compartment="c" initialAmount="{value!r}" hasOnlySubstanceUnits="true" '
        'boundaryCondition="false" constant="false"/>'
        for name, value in species.items()
    )
    values = "".join(
        f'<parameter id="{name}" value="{value}" constant="{str(is_constant).lower()}"/>'
        for table, is_constant in ((constants, True), (varied or {}, False))
        for name, value in table.items()
    )
    place = '<listOfCompartments><compartment id="c" size="1" constant="true"/></listOfCompartments>' if species else ""
    return (
        '<sbml xmlns="http://www.sbml.org/sbml/level3/version1/core" level="3" version="1"><model id="m">'
        + place
        + (f"<listOfSpecies>{kinds}</listOfSpecies>" if species else "")
        + (f"<listOfParameters>{values}</listOfParameters>" if values else "")
        + f"<listOfRules>{links}</listOfRules></model></sbml>"
    )


def apply(word, *parts):
    return f"<apply><{word}/>{''.join(parts)}</apply>"


def ci(name):
    return f"<ci>{name}</ci>"


def cn(value):
    return f'<cn type="real">{value}</cn>'


def sbml_case(folder, model, duration=5, at="steady"):
    pytest.importorskip("libsbml", reason="needs python-libsbml")
    case = f'kind="signalling"\n[network]\nsbml="m.xml"\ntime_unit="h"\n[time]\nduration_h={duration}\nstep_h={duration / 5}\n'
    written(folder, m_xml=model, case_toml=case + f"[sensitivity]\nat='{at}'\n[solver]\nmethod='explicit'\n")
    return folder / "case.toml"


def test_amounts_of_1e_12_are_right_to_the_tolerance_asked(tmp_path):
    """By hand: S1 = a exp(-t), S2 = a (exp(-t) - exp(-20 t)) / 19 with a = 1e-12."""
    rates = {
        "S1": apply("minus", ci("S1")),
        "S2": apply("minus", ci("S1"), apply("times", cn(20), ci("S2"))),
    }
    results = cicatrix.simulate(load_case(sbml_case(tmp_path, sbml({"S1": 1e-12, "S2": 0.0}, {}, rates), at="none")))
    t = results.history["time_h"]
    np.testing.assert_allclose(results.history["S1"], 1e-12 * np.exp(-t), rtol=1e-6)
    np.testing.assert_allclose(results.history["S2"], 1e-12 * (np.exp(-t) - np.exp(-20 * t)) / 19, rtol=1e-6)
    assert results.outcome["is_bistable"].value == "no"


def test_what_accumulates_is_said_to_have_no_steady_state(tmp_path, capsys):
    rates = {"X": apply("minus", cn(1), ci("X")), "P": ci("X")}
    path = sbml_case(tmp_path, sbml({"X": 0.2, "P": 0.0}, {"k": 1.0}, rates), 10)
    assert main(["run", str(path), "--out", str(tmp_path / "run")]) == 0
    assert "It has no steady state: X + P changes by 1 per h for ever." in capsys.readouterr().out
    outcome = json.loads((tmp_path / "run" / "outcome.json").read_text())
    assert (outcome["n_stable_states"]["value"], outcome["is_bistable"]["value"]) == (0, "no")
    assert {path.stem for path in (tmp_path / "run" / "figures").iterdir()} == {"courses"}


def test_rate_rules_without_a_parameter_draw_what_there_is(tmp_path):
    """A toggle of two parameters, x' = 12 / (1 + y^4) - 2 x: there are no parameters to be sensitive to."""

    def rate(a, b):
        made = apply("divide", cn(12), apply("plus", cn(1), apply("power", ci(b), cn(4))))
        return apply("minus", made, apply("times", cn(2), ci(a)))

    path = sbml_case(tmp_path, sbml({}, {}, {"x": rate("x", "y"), "y": rate("y", "x")}, {"x": 4, "y": 0}))
    assert main(["run", str(path), "--out", str(tmp_path / "run")]) == 0
    assert {path.stem for path in (tmp_path / "run" / "figures").iterdir()} == {"courses", "steady_states"}
    assert {path.stem for path in (tmp_path / "run" / "tables").iterdir()} == {"steady_states"}
    states = json.loads((tmp_path / "run" / "outcome.json").read_text())["steady_states"]["value"]
    # x = 5.9999999973, y = 0.0046260601 by hand: y = 6 / (1 + x^4); its mirror, which no course reaches; the saddle between
    assert [state["is_stable"] for state in states] == [True, True, False]
    assert states[1]["values"]["y"] == pytest.approx(states[0]["values"]["x"]) == pytest.approx(6.0)
    assert not [
        note for note in json.loads((tmp_path / "run" / "manifest.json").read_text())["notes"] if "figure" in note
    ]


def test_a_rate_that_is_no_number_at_the_start_is_named(tmp_path, capsys):
    path = sbml_case(tmp_path, sbml({"X": 0.0}, {"k": 1.0}, {"X": apply("divide", ci("k"), ci("X"))}))
    sentence = 'the rate of "X" is inf at time 0; its formula must give a finite number there'
    assert sentence in check_case(path)[0]
    assert main(["run", str(path), "--out", str(tmp_path / "run")]) == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.slow
def test_a_rate_that_stops_being_a_number_is_named(tmp_path, capsys):
    """X' = 1 while t < 2 h, and nothing is said of later."""
    time = '<csymbol encoding="text" definitionURL="http://www.sbml.org/sbml/symbols/time"> t </csymbol>'
    early = f"<piecewise><piece>{cn(1)}{apply('lt', time, cn(2))}</piece></piecewise>"
    path = sbml_case(tmp_path, sbml({"X": 0.0}, {}, {"X": early}))
    assert main(["run", str(path), "--set", "solver.max_steps=300", "--out", str(tmp_path / "run")]) == 3
    told = capsys.readouterr().err
    assert "could not be followed beyond 2 h" in told
    assert 'the rate of change of "X" is not a number' in told
    assert read_history(tmp_path / "run" / "history.csv")["X"][-1] == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["sig/moiety", "sbml/accumulate/case", "sbml/tiny/case", "sig/ec50", "sig/netflux", "sig/case"]
)
def test_reported_networks_run(name, tmp_path):
    if not FAULTS.is_dir():
        pytest.skip("the folder of reported inputs is absent")
    results = cicatrix.simulate(load_case(FAULTS / f"{name}.toml"), tmp_path / "run")
    if name == "sig/moiety":
        (state,) = results.outcome["steady_states"].value
        assert state["values"]["X"] + state["values"]["XI"] == pytest.approx(30.0)
        assert results.outcome["n_conserved"].value == 3
