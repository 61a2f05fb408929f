"""Cases of kind "material-point": from file to folder, stopped and resumed, and what is refused."""

import json
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from maxwell_fibre import MaxwellFibre

import cicatrix
from cicatrix.cases.laws import law_of
from cicatrix.cases.reading import case_table
from cicatrix.cli.main import main
from cicatrix.kinds.material_point import run as point_run
from cicatrix.kinds.material_point.build import control_of
from cicatrix.kinds.registry import check_case, load_case
from cicatrix.materials.compose import Sum
from cicatrix.materials.material import EnergyMaterial
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.mechanics.point_integration import soft_axes

LAW = """
kind = "material-point"
[[law]]
type = "neo-hookean"
mu_kPa = 2.0
"""
LOADING = """
[loading]
time_h = [0.0, 1.0, 2.0]
x = [1.0, 1.2, 1.2]
"""
COLUMNS = ["step", "time_h", "lambda_x", "lambda_y", "lambda_z", "sigma_x_kPa", "sigma_y_kPa", "energy_kPa"]
COLUMNS += ["dissipation_kPa", "growth_x", "growth_y"]


@pytest.fixture
def viscous(monkeypatch):
    """Return a case in which every law has a Maxwell branch with a relaxation time of half an hour."""
    monkeypatch.setattr(point_run, "law_of", lambda case: Sum((law_of(case), MaxwellFibre(4.0, 1800.0))))


def test_the_example_runs(tmp_path):
    path = Path(__file__).parents[2] / "examples" / "material-point.toml"
    results = cicatrix.simulate(load_case(path), tmp_path / "run")
    history, outcome = results.history, results.outcome
    assert list(history)[: len(COLUMNS)] == COLUMNS
    lx, ly, lz = (history[f"lambda_{axis}"] for axis in "xyz")
    np.testing.assert_allclose(lx * ly * lz, 1.0)
    np.testing.assert_allclose(history["sigma_x_kPa"], lx**2 - lz**2, atol=1e-12)  # by hand: mu (l_x^2 - l_z^2), mu = 1
    np.testing.assert_allclose(history["energy_kPa"], 0.5 * (lx**2 + ly**2 + lz**2 - 3), atol=1e-12)
    assert outcome["peak_sigma_x_kPa"].value == pytest.approx(1.5**2 - 1 / 1.8**2)
    assert outcome["work_kPa"].value == pytest.approx(0.0, abs=1e-12)  # loaded and unloaded
    assert set(history["n_substeps"]) == {1}
    for name in ("response", "histories"):
        assert (tmp_path / "run" / "figures" / f"{name}.png").stat().st_size > 10_000


def test_y_left_out_is_free(case_file):
    history = cicatrix.simulate(load_case(case_file(LAW + LOADING), ["loading.steps_per_segment=4"])).history
    np.testing.assert_allclose(history["sigma_x_kPa"][-1], 2.0 * (1.44 - 1 / 1.2))
    np.testing.assert_allclose(history["sigma_y_kPa"], 0.0, atol=1e-12)
    np.testing.assert_allclose(history["time_h"], np.linspace(0, 2, 9))


@pytest.mark.parametrize("plane", ['plane="stress"', 'plane="strain"', "z=[1.0, 0.9, 0.9]"])
def test_compressible_tissue(plane, case_file):
    """By hand: sigma_z = mu J^-5/3 (l_z^2 - I1 / 3) + kappa (J - 1)."""
    settings = ["law.0.kappa_kPa=5", "loading.y=[1, 1.1, 1.1]", "loading.steps_per_segment=3", f"loading.{plane}"]
    last = {k: v[-1] for k, v in cicatrix.simulate(load_case(case_file(LAW + LOADING), settings)).history.items()}
    l = np.array([last[f"lambda_{axis}"] for axis in "xyz"])
    J = l.prod()
    by_hand = 2.0 * J ** (-5 / 3) * (l[2] ** 2 - (l**2).sum() / 3) + 5.0 * (J - 1)
    assert last["sigma_z_kPa"] == pytest.approx(by_hand, abs=1e-9)
    assert plane == 'plane="stress"' or l[2] == pytest.approx(1.0 if "strain" in plane else 0.9)
    assert plane != 'plane="stress"' or by_hand == pytest.approx(0.0, abs=1e-9)


def test_cycles_dissipate_what_they_are_worked(case_file, viscous):
    """In a periodic cycle the work equals the dissipated energy, to first order in the step."""
    path = case_file(LAW + "[loading]\ntime_h = [0, 0.5, 1]\nx = [1.0, 1.3, 1.0]\nrepeat = 4\nsteps_per_segment = 20\n")
    results = cicatrix.simulate(load_case(path, ["solver.relative_tolerance=1e-3"]))
    history, outcome = results.history, results.outcome
    assert len(history["step"]) == 161
    heat = history["dissipation_kPa"]
    assert (np.diff(heat) >= 0.0).all()
    assert outcome["hysteresis_kPa"].value == pytest.approx(heat[160] - heat[120], rel=0.02)
    assert outcome["work_kPa"].value == pytest.approx(heat[-1] + history["energy_kPa"][-1], rel=0.02)
    assert history["n_substeps"].max() > 1
    assert outcome["n_substeps"].value == history["n_substeps"].sum()


def test_shear(case_file):
    settings = ["loading.y=[1,1,1]", "loading.x=[1,1,1]", "loading.shear=[0, 0.5, 0]", "loading.steps_per_segment=4"]
    results = cicatrix.simulate(load_case(case_file(LAW + LOADING), settings))
    np.testing.assert_allclose(results.history["sigma_xy_kPa"], 2.0 * results.history["shear"], atol=1e-12)
    assert results.outcome["work_kPa"].value == pytest.approx(0.0, abs=1e-12)
    up = {name: column[:5] for name, column in results.history.items()}
    assert point_run.work(up) == pytest.approx(0.5 * 2.0 * 0.5**2)  # by hand: mu gamma^2 / 2; trapezoids are exact


def test_a_law_that_jumps_is_told(case_file, monkeypatch):
    """Steps of 1/4096 h cannot resolve a branch with a relaxation time of 1 s where the strain jumps."""
    monkeypatch.setattr(point_run, "law_of", lambda case: Sum((law_of(case), MaxwellFibre(4.0, 1.0))))
    path = case_file(LAW + LOADING.replace("[1.0, 1.2, 1.2]", "[1.2, 1.2, 1.2]"))
    results = cicatrix.simulate(load_case(path, ["loading.steps_per_segment=1"]))
    assert any("their error was above solver.relative_tolerance" in note for note in results.manifest["notes"])
    np.testing.assert_allclose(results.history["sigma_x_kPa"][-1], 2.0 * (1.44 - 1 / 1.2))


FAULTS = {
    "negative": (["law[0].mu_kPa=-1"], "law[0].mu_kPa must be at least 0; got -1"),
    "near key": (["law.0.mu=1"], "law[0].mu is not a known key; did you mean law[0].mu_kPa?"),
    "strange key": (
        ["law.0.xyz=1"],
        "law[0].xyz is not a known key; known in [law[0]]: type, mu_kPa, kappa_kPa, viscous",
    ),
    "law is a number": (["law=3"], "law must be a list; got 3"),
    "law is a table": (["law={mu_kPa=1}"], "law must be a list of tables: write [[law]]; got [law]"),
    "law of numbers": (["law=[3]"], "law[0] must be a table; got 3"),
    "no law": (["law=[]"], "law must be at least one table [[law]]"),
    "no parameter": (["law=[{type='neo-hookean'}]"], "law[0].mu_kPa is missing"),
    "time stands": (["loading.time_h=[0,1,1]"], "loading.time_h must be at least two times that ascend; got [0, 1, 1]"),
    "one time": (["loading.time_h=[0]"], "loading.time_h must be at least two times that ascend; got [0]"),
    "short": (["loading.x=[1,2]"], "loading.x must have as many values as time_h (3); got 2"),
    "crushed": (["loading.x=[1,0,1]"], 'loading.x must be above 0 for control = "stretch"; got 0'),
    "nan": (["loading.x=[1,nan,1]"], "loading.x[1] must be a finite number; got nan"),
    "no steps": (
        ["loading.steps_per_segment=0"],
        "loading.steps_per_segment must be at least 1 and at most 1e+06; got 0",
    ),
    "control": (
        ["loading.control=both"],
        'loading.control must be "stretch" or "stress", or a list of one of them for each axis; got "both"',
    ),
    "three controls": (
        ["loading.control=['stress','stress','stress']"],
        "loading.control must be one word, or two: for x and y; got 3",
    ),
    "y has no stretch": (
        ["loading.control=['stress','stretch']"],
        'loading.y is missing, as control makes y a stretch; with "stress" along y it may be left out',
    ),
    "plane": (["loading.plane=flat"], 'loading.plane must be "incompressible", "stress" or "strain"; got "flat"'),
    "no bulk modulus": (
        ["loading.plane=stress"],
        'law must have a bulk modulus for loading.plane = "stress": set kappa_kPa of at least one [[law]] above 0',
    ),
    "no bulk modulus in 3-D": (
        ["loading.z=[1,1,1]"],
        "law must have a bulk modulus for loading.z: set kappa_kPa of at least one [[law]] above 0",
    ),
    "both z and plane": (
        ["loading.z=[1,1,1]", "loading.plane=strain", "law.0.kappa_kPa=1"],
        "loading.plane is a condition along z, and z is given: leave one of the two out",
    ),
    "branches of two lengths": (
        ["law.0.viscous={beta=[1, 2], relaxation_s=[1]}"],
        "law[0].viscous.relaxation_s must be as many as beta (2); got 1",
    ),
    "no branch": (
        ["law.0.viscous={beta=[], relaxation_s=[]}"],
        "law[0].viscous.beta must be a number or a list of at least one number",
    ),
    "negative branch": (
        ["law.0.viscous={beta=[1, -1], relaxation_s=[1, 2]}"],
        "law[0].viscous.beta[1] must be at least 0; got -1",
    ),
    "branch without time": (
        ["law.0.viscous={beta=1, relaxation_s=0}"],
        "law[0].viscous.relaxation_s[0] must be above 0; got 0",
    ),
    "fibres about no axis": (
        ["law=[{type='active-fibres', tension_kPa=1, orientation={type='fisher', concentration=1, axis=[0, 0, 0]}}]"],
        "law[0] is at fault: Fisher.axis must be three numbers that are not all 0; got [0.0, 0.0, 0.0].",
    ),
    "fibres straight before they are": (
        [
            "law=[{type='fibre-distribution', mu_f_kPa=1, orientation={type='single'}, "
            "waviness={type='uniform', low=0.9, high=2}}]"
        ],
        "law[0].waviness.low must be at least 1; got 0.9",
    ),
    "fibres of no direction": (["law=[{type='fibre-distribution', mu_f_kPa=1}]"], "law[0].orientation is missing"),
    "two growths": (
        [
            "law=[{type='fibre-distribution', mu_f_kPa=1, orientation={type='single'}, growth={tau_h=1}}]",
            "growth={type='area', tau_h=1}",
        ],
        "growth must be given once, for the whole tissue; found law[0].growth, [growth]",
    ),
    "growth inside a mixture": (
        [
            "law=[{type='constrained-mixture', constituent=[{fraction=1, law={type='fibre-distribution', mu_f_kPa=1, "
            "orientation={type='single'}, growth={tau_h=1}}}]}]"
        ],
        "law[0] is at fault: a law inside another one must not grow: give the outer law growth, or a table [growth]",
    ),
    "growth by a stress that nothing knows": (
        ["growth={type='volume', tau_h=1, homeostatic_kPa=1}", "law.0.kappa_kPa=1"],
        "growth.homeostatic_kPa needs the mean stress, which a law leaves undetermined in incompressible tissue: "
        'give loading.plane = "stress" or "strain"',
    ),
    "growth by a volume that is kept": (
        ["growth={type='volume', tau_h=1}"],
        'growth by volume depends on the elastic change of volume, which loading.plane = "incompressible" excludes: '
        'give loading.plane = "stress" or "strain", and kappa_kPa of a part of the law',
    ),
    "too much of everything": (
        [
            "law=[{type='constrained-mixture', constituent=[{fraction=0.6, law={type='neo-hookean', mu_kPa=1}}, "
            "{fraction=0.6, law={type='neo-hookean', mu_kPa=1}}]}]"
        ],
        "law[0] is at fault: ConstrainedMixture.constituents: fractions must add up to 1 or less; got 1.2.",
    ),
    "replaced at once": (
        [
            "law=[{type='constrained-mixture', constituent=[{fraction=1, law={type='neo-hookean', mu_kPa=1}, lifetime_h=0}]}]"
        ],
        "law[0].constituent[0].lifetime_h must be at least 0.000277778; got 0",
    ),
    "no cycle": (["loading.repeat=2"], "loading.x must end where it starts for repeat = 2; got 1 and 1.2"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_one_fault_one_sentence(name, case_file):
    settings, sentence = FAULTS[name]
    assert check_case(case_file(LAW + LOADING), settings) == [sentence]


def test_unknown_law_lists_the_known_ones(case_file):
    (sentence,) = check_case(case_file(LAW + LOADING), ["law.0.type=rubber"])
    assert sentence.startswith("law[0].type must be ")
    assert '"neo-hookean"' in sentence
    assert sentence.endswith('; got "rubber"')
    (sentence,) = check_case(case_file(LAW + LOADING), ["law.0.type=neo-hokean"])
    assert sentence.endswith('; got "neo-hokean", did you mean "neo-hookean"?')
    (sentence,) = check_case(case_file(LAW + LOADING), ["law=[{mu_kPa=1}]"])
    assert sentence.startswith("law[0].type must be ")
    assert sentence.endswith("; it is missing")


def test_bad_input_is_a_sentence_and_leaves_nothing(case_file, tmp_path, capsys):
    path = case_file(LAW + LOADING)
    assert main(["run", str(path), "--set", "law.0.mu_kPa=-1", "--out", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err == f"cicatrix: {path}: law[0].mu_kPa must be at least 0; got -1\n"
    assert not (tmp_path / "run").exists()


class Yielding(EnergyMaterial):
    """Tissue whose stress has a maximum as a function of stretch."""

    def energy(self, F, state=()):
        return 0.5 * (1.0 - jnp.exp(-(jnp.sum(F * F, axis=(-2, -1)) - 3.0)))


def test_too_much_stress_is_told_and_the_rows_are_kept(case_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(point_run, "law_of", lambda case: Yielding())
    path = case_file(LAW + '[loading]\ncontrol = "stress"\ntime_h = [0, 1]\nx = [0, 1]\nsteps_per_segment = 10\n')
    assert main(["run", str(path), "--out", str(tmp_path / "run")]) == 3
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("cicatrix: ")]
    assert len(told) == 1
    assert "No state of the law was found at 0.88" in told[0]
    assert len((tmp_path / "run" / "history.csv").read_text().splitlines()) == 1 + 9  # 0 to 0.8 kPa
    status = json.loads((tmp_path / "run" / "manifest.json").read_text())["status"]
    assert status["state"] == "failed"
    assert list((tmp_path / "run" / "checkpoint").iterdir())


@pytest.mark.parametrize(
    ("law", "axes"),
    [
        ("type='neo-hookean', mu_kPa=0", "x, y, z"),
        ("type='may-newman', c0_kPa=1, c1=1, c2=1", "x, y, z"),
        ("type='fibre-distribution', mu_f_kPa=1, orientation={type='single'}", "y, z"),
        ("type='neo-hookean', mu_kPa=1", ""),
    ],
)
def test_no_stiffness_at_rest_is_seen(law, axes, case_file):
    settings = [f"law=[{{{law}}}]", "loading.control=stress"]
    case = load_case(case_file(LAW + LOADING), settings)
    assert ", ".join(soft_axes(law_of(case), control_of(case.loading))) == axes


def test_no_stiffness_at_rest_is_told(case_file, capsys, tmp_path):
    path = case_file(LAW + LOADING)
    settings = ["--set", "law.0.mu_kPa=0", "--set", "loading.control=stress", "--set", "loading.x=[0, 1, 1]"]
    assert main(["run", str(path), *settings, "--out", str(tmp_path / "run")]) == 3
    words = "The law has no stiffness at rest along x, y, z: add a part that has, such as neo-hookean."
    assert words in capsys.readouterr().err


@pytest.mark.slow  # compiles for half a minute
def test_a_history_without_places_left_is_told(case_file, tmp_path, capfd):
    mixture = (
        "law=[{type='constrained-mixture', form={type='exact', cohorts=8}, constituent=[{fraction=0.5, lifetime_h=1, "
    )
    law = mixture + "law={type='neo-hookean', mu_kPa=1}}]}]"
    path = case_file(LAW + LOADING)
    settings = ["--set", law, "--set", "loading.steps_per_segment=10"]
    assert main(["run", str(path), *settings, "--out", str(tmp_path / "run")]) == 3
    said = capfd.readouterr().err
    assert "Traceback" not in said
    told = r"law\[\.\.\]\.form\.cohorts = 8 is too small for the exact form: it is full after (\d+) of 20 steps; set at least \d+"
    n_done = int(re.search(told, said)[1])  # few, as steps are halved
    assert len((tmp_path / "run" / "history.csv").read_text().splitlines()) == 1 + 1 + n_done
    assert json.loads((tmp_path / "run" / "manifest.json").read_text())["status"]["state"] == "failed"


def test_settings_reach_into_lists(case_file):
    case = load_case(case_file(LAW + LOADING), ["law.0.mu_kPa=3", "law[0].kappa_kPa=4", "loading.x.1=1.1"])
    law = law_of(case)
    assert isinstance(law, NeoHookean)
    assert (law.mu, law.kappa, case.loading.x) == (3.0, 4.0, (1.0, 1.1, 1.2))
    assert case_table(case)["law"] == [{"type": "neo-hookean", "mu_kPa": 3.0, "kappa_kPa": 4.0, "viscous": None}]
    for setting, words in (("law.1.mu_kPa=3", "law is a list"), ("law.mu_kPa=3", "law is a list")):
        (sentence,) = check_case(case_file(LAW + LOADING), [setting])
        assert words in sentence


def test_several_laws_add_up(case_file):
    law = law_of(load_case(case_file(LAW + '[[law]]\ntype = "contraction"\ntension_kPa = 0.5\n' + LOADING)))
    assert isinstance(law, Sum)
    assert [type(part).__name__ for part in law.parts] == ["NeoHookean", "Contraction"]
