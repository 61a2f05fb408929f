"""Cases of kind "adhesion": from file to folder, stopped and resumed, and what is refused."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import cicatrix
from cicatrix.biology.adhesion import steady_state
from cicatrix.cli.main import main
from cicatrix.core.errors import ConvergenceError
from cicatrix.kinds.adhesion import run as adhesion_run
from cicatrix.kinds.adhesion.build import law_and_notes
from cicatrix.kinds.registry import check_case, load_case
from cicatrix.materials.neo_hookean import NeoHookean
from cicatrix.mechanics.uniaxial import Tension

EXAMPLES = Path(__file__).parents[2] / "examples" / "adhesion"
COLUMNS = ["step", "time_s", "stretch", "bound_fraction", "bound_fraction_sd", "force_pN", "traction_kPa"]
KT = 4.28317e-3
CASE = """
kind = "adhesion"
[bond]
k_on_per_s = 0.01
k_off_per_s = 0.012
[substrate]
type = "linear"
stiffness_pN_um = 2e4
stretch = [1.0, 1.2]
[cell]
force_pN = 7.0
[method]
type = "ode"
duration_s = 100.0
n_rows = 4
"""
SAMPLED = ["method.n_integrins=2000", "method.n_cells=8", "method.duration_s=300.0", "method.n_rows=6"]
STEPS = [*SAMPLED, "method.type=monte-carlo", "method.dt_s=0.5"]
EXACT = [*SAMPLED, "method.type=ssa"]
SOLID = "substrate={type='standard-linear-solid', long_pN_um=8e3, added_pN_um=8e4, viscosity_pN_s_um=1e6}"


@pytest.fixture
def case_file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    return path


@pytest.fixture
def no_pictures(monkeypatch):
    """Skip drawing figures, which takes longer than the bonds."""
    for name in ("course_figure", "stretch_figure"):
        monkeypatch.setattr(adhesion_run, name, lambda *_: Figure())


def test_mean_field(case_file, tmp_path):
    """By hand: k_off = 0.012 exp(49 / 2e4 / kT), phi = phi* (1 - exp(-(k_on + k_off) t)), t_a = f phi rho."""
    results = cicatrix.simulate(load_case(case_file), tmp_path / "run")
    history, outcome = results.history, results.outcome
    assert list(history) == COLUMNS
    k_off = 0.012 * np.exp(49.0 / 2e4 / KT)
    steady = 0.01 / (0.01 + k_off)
    np.testing.assert_array_equal(history["time_s"], np.repeat([0.0, 25.0, 50.0, 75.0, 100.0], 2))
    bound = steady * -np.expm1(-(0.01 + k_off) * history["time_s"])
    np.testing.assert_allclose(history["bound_fraction"], bound, rtol=1e-12)
    np.testing.assert_allclose(history["traction_kPa"], 2.8 * bound, rtol=1e-12)
    assert not history["bound_fraction_sd"].any()
    assert outcome["steady_bound_fraction"].value == pytest.approx([steady, steady], rel=1e-12)
    assert outcome["stretch"].value == [1.0, 1.2]
    assert outcome["bound_fraction_spread"].value == 0.0
    for name in ("course", "stretch"):
        assert (tmp_path / "run" / "figures" / f"{name}.png").stat().st_size > 10_000


@pytest.mark.parametrize("settings", [STEPS, EXACT], ids=["steps", "exact"])
def test_samples_are_about_their_mean(settings, case_file, no_pictures):
    """Check the mean to 4 sigma of the steady state and the variance of independent bonds, also with stored energy."""
    settings = [*settings, "bond.energy=stored", "method.start_bound_fraction=0.25"]
    results = cicatrix.simulate(load_case(case_file, settings))
    history, outcome = results.history, results.outcome
    assert (history["bound_fraction"][:2] == 0.25).all()
    mean = outcome["steady_bound_fraction"].value[0]
    assert mean == pytest.approx(1 / (1 + 1.2 * np.exp(0.5 * 49 / 2e4 / KT)))
    sigma = np.sqrt(mean * (1 - mean) / 2000)
    assert np.abs(history["bound_fraction"][-2:] - mean).max() < 4 * sigma / np.sqrt(8)
    assert 0.3 * sigma < history["bound_fraction_sd"][2:].mean() < 2 * sigma
    assert ("step_fixed_point" in outcome) == (settings[4] == "method.type=monte-carlo")


@pytest.mark.parametrize("settings", [pytest.param(STEPS, marks=pytest.mark.slow), EXACT], ids=["steps", "exact"])
def test_samples_follow_a_substrate_that_yields(settings, case_file, no_pictures):
    """Compare samples with the mean-field solution, which another test compares with SciPy to 1e-7."""
    sampled = cicatrix.simulate(load_case(case_file, [*settings, SOLID])).history
    mean = cicatrix.simulate(load_case(case_file, [*SAMPLED[2:], SOLID])).history
    phi = mean["bound_fraction"]
    assert np.ptp(phi[1:]) > 0.05
    assert (np.abs(sampled["bound_fraction"] - phi) <= 4 * np.sqrt(phi * (1 - phi) / 16000) + 1e-12).all()


def test_mean_field_on_a_substrate_that_yields(case_file, no_pictures):
    case = load_case(case_file, [SOLID, "method.duration_s=300.0"])
    law, _ = law_and_notes(case)
    tau = 1e6 * (1 / 8e3 + 1 / 8e4)

    def rate(t, phi):
        u = 7.0 / 8e3 * (1 - 80 / 88 * np.exp(-t / tau))
        return 0.01 * (1 - phi) - 0.012 * np.exp(7.0 * u / KT) * phi

    theirs = solve_ivp(rate, (0.0, 300.0), [0.0], rtol=1e-10, atol=1e-12, t_eval=np.linspace(0, 300, 5)).y[0]
    np.testing.assert_allclose(cicatrix.simulate(case).history["bound_fraction"], theirs, atol=1e-7)
    assert float(jax.jit(law.rate)(0.3, 1.0, 50.0)) == pytest.approx(rate(50.0, 0.3), rel=1e-10)


def test_threads_do_not_matter(case_file, monkeypatch, no_pictures):
    histories = []
    for threads in ("1", "2"):
        monkeypatch.setenv("CICATRIX_THREADS", threads)
        histories.append(cicatrix.simulate(load_case(case_file, STEPS)).history["bound_fraction"])
    np.testing.assert_array_equal(*histories)
    other = cicatrix.simulate(load_case(case_file, [*STEPS, "run.seed=2"])).history["bound_fraction"]
    assert (other != histories[0]).any()


NEO = "substrate={type='neo-hookean', mu_kPa=10.0, area_um2=0.017, length_um=0.1, stretch=[1.0, 1.3]}"


def test_tissue_as_substrate(case_file):
    """Incompressible neo-Hookean by hand: P = mu (l - l^-2), P' = mu (1 + 2 l^-3); pulled by 7 pN at 0.017 um^2."""
    case = load_case(case_file, [NEO, "cell.force_pN=7.0"])
    law, notes = law_and_notes(case)
    assert "tabulated in uniaxial tension" in notes[0]
    at = steady_state(law, np.array([1.0, 1.3]))
    mu = 1e4  # pN/um^2
    np.testing.assert_allclose(at.stiffness, 0.17 * mu * np.array([3.0, 1 + 2 / 1.3**3]), rtol=1e-7)
    way = np.asarray(at.energy) / 7.0 / 0.1
    to = np.array([1.0, 1.3]) + way
    np.testing.assert_allclose(to - to**-2.0, [7.0 / 0.017 / mu, 1.3 - 1.3**-2 + 7.0 / 0.017 / mu], rtol=1e-7)
    same = load_case(
        case_file, ["substrate={type='law', area_um2=0.017, length_um=0.1, stretch=[1.0, 1.3]}", *two(5.0)]
    )
    np.testing.assert_allclose(steady_state(law_and_notes(same)[0], np.array([1.0, 1.3])).energy, at.energy, rtol=1e-9)


def two(mu):
    return [f"law=[{{type='neo-hookean', mu_kPa={mu}}}, {{type='neo-hookean', mu_kPa={mu}}}]"]


def test_tension_of_compressible_tissue():
    """By hand: Young's modulus 9 kappa mu / (3 kappa + mu) = 4500 / 160 at the start; slopes are derivatives of the stresses."""
    stretch = np.linspace(0.8, 1.5, 71)
    stress, slope = Tension(NeoHookean(10.0, 50.0)).nominal(stretch)
    assert (stress[20], slope[20]) == pytest.approx((0.0, 28.125), abs=1e-9)
    np.testing.assert_allclose(np.gradient(stress, stretch)[1:-1], slope[1:-1], rtol=2e-3)


def test_law_without_a_state_is_told():
    with pytest.raises(ConvergenceError, match="No state of the substrate's law was found at a stretch of"):
        Tension(NeoHookean(1.0)).table(1.0, np.nan)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_examples_load(path):
    assert load_case(path).kind == "adhesion"


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_examples_run(path, tmp_path):
    results = cicatrix.simulate(load_case(path), tmp_path / "run")
    assert results.status[0] == "finished"
    assert np.isfinite(results.history["bound_fraction"]).all()


FEEDBACK = "cell={feedback={f0_pN=100.0, beta=3.0, k_a_pN_um=2e4, k_N_pN_um=4e4}}"
CATCH = "catch={k_catch_per_s=1.0, k_slip_per_s=1.0, f_catch_pN=1.0, f_slip_pN=1.0}"
FAULTS = {
    "rate 0": (["bond.k_on_per_s=0.0"], "bond.k_on_per_s must be at least 1e-12; got 0.0"),
    "negative rate": (["bond.k_off_per_s=-1.0"], "bond.k_off_per_s must be at least 1e-12; got -1.0"),
    "no rate": (["bond={k_on_per_s=1.0}"], "bond.k_off_per_s is missing"),
    "both manners to open": (
        ["bond.catch={k_catch_per_s=1.0, k_slip_per_s=1.0, f_catch_pN=1.0, f_slip_pN=1.0}"],
        "bond.k_off_per_s and catch exclude each other: catch has rates of its own",
    ),
    "energy of a catch bond": (
        [f"bond={{k_on_per_s=1.0, energy='stored', {CATCH}}}"],
        "bond.energy and catch exclude each other: the rates of a catch bond depend on the force alone",
    ),
    "heat of a catch bond": (
        [f"bond={{k_on_per_s=1.0, kT_pN_um=4e-3, {CATCH}}}"],
        "bond.kT_pN_um and catch exclude each other: the rates of a catch bond depend on the force alone",
    ),
    "energy": (["bond.energy=both"], 'bond.energy must be "work" or "stored"; got "both"'),
    "both forces": (
        [FEEDBACK, "cell.force_pN=1.0"],
        "cell.force_pN or feedback or clutch must be given, one of them; got force_pN, feedback",
    ),
    "no force": (["cell={}"], "cell.force_pN or feedback or clutch must be given, one of them; got none"),
    "clutches of the mean": (["cell={clutch={}}"], 'method.type must be "monte-carlo" for cell.clutch; got "ode"'),
    "no stretch": (["substrate.stretch=[]"], "substrate.stretch must be a list of at least one number"),
    "stretch 0": (["substrate.stretch=[0.0]"], "substrate.stretch[0] must be above 0; got 0.0"),
    "near key": (
        ["substrate.stiffness=1.0"],
        "substrate.stiffness is not a known key; did you mean substrate.stiffness_pN_um?",
    ),
    "no steps": (["method.type=monte-carlo", "method.n_integrins=5"], "method.dt_s is missing; type = "),
    "no bonds": (["method.type=ssa"], "method.n_integrins is missing; type = "),
    "steps of the mean": (["method.dt_s=1.0"], 'method.dt_s must be left out for type = "ode"'),
    "long step": (
        ["method.type=monte-carlo", "method.n_integrins=5", "method.dt_s=1e3"],
        "method.dt_s must give a whole number of steps, 1 to 2^32 - 1, in duration_s = 100; got 1000, 0.1 steps",
    ),
    "a part of a step": (
        ["method.type=monte-carlo", "method.n_integrins=5", "method.dt_s=0.3"],
        "method.dt_s must give a whole number of steps, 1 to 2^32 - 1, in duration_s = 100; got 0.3, 333.333 steps",
    ),
    "long step of clutches": (
        ["method.type=monte-carlo", "method.n_integrins=5", "method.dt_s=150.0", "cell={clutch={}}"],
        "method.dt_s must give a whole number of steps, 1 to 2^32 - 1, in duration_s = 100; got 150",
    ),
    "too many bonds": (
        ["method.type=ssa", "method.n_integrins=100000000"],
        "method.n_integrins times n_cells times stretches must be at most 1e+09 bonds; got 3.2e+09",
    ),
    "a law for nothing": (
        two(1.0),
        'law must be at least one table [[law]] for substrate.type = "law", and none otherwise',
    ),
    "law at fault": (
        ["substrate={type='neo-hookean', mu_kPa=-1.0, area_um2=1.0, length_um=1.0}"],
        "substrate.mu_kPa must be at least 0; got -1.0",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_one_fault_one_sentence(name, case_file):
    settings, sentence = FAULTS[name]
    (told,) = check_case(case_file, settings)
    assert told.startswith(sentence)


def test_unknown_substrate_lists_the_known_ones(case_file):
    (told,) = check_case(case_file, ["substrate.type=jelly"])
    assert told.startswith('substrate.type must be "linear", "exponential-fibre", ')
    assert '"neo-hookean"' in told
    assert told.endswith('; got "jelly"')


FIBRE = "substrate={type='exponential-fibre', k1_MPa=0.07, k2=20.8, area_um2=0.017, length_um=0.1, stretch=[1.0, 0.7]}"
UNSOUND = {
    "feedback": (
        [FEEDBACK],
        "feedback is not valid: 1 - beta + k_a / k_eff + k_a / k_N must be positive; got -0.5 at",
    ),
    "slack": ([FIBRE], "substrate.stretch 0.7: the tangent stiffness there must be positive; got -"),
    "overflow": (
        [FIBRE.replace("0.7]", "10.0]")],
        "substrate.stretch 10: the stress of the substrate overflows there",
    ),
    "too strong": (
        ["cell.force_pN=1e9"],
        "the adhesion has no finite k_off at a stretch of 1: a force of 1e+09 pN is too much",
    ),
    "too strong in the end": (
        [SOLID, *EXACT, "cell.force_pN=200.0"],
        "the adhesion has no finite k_off at a stretch of 1 after 300 s: a force of 200 pN is too much for this substrate",
    ),
    "too many events": (
        [SOLID, *EXACT, "cell.force_pN=100.0"],
        'method.type = "ssa" would take about ',
    ),
    "too many events of the still": (
        [*EXACT, "bond.k_on_per_s=1e6", "bond.k_off_per_s=1e6"],
        "more than 1e+07 and 1e+10; reduce duration_s or force",
    ),
}


@pytest.mark.parametrize("name", UNSOUND)
def test_what_does_not_hold_is_told(name, case_file, tmp_path, capsys):
    settings, sentence = UNSOUND[name]
    arguments = [word for setting in settings for word in ("--set", setting)]
    assert main(["run", str(case_file), *arguments, "--out", str(tmp_path / "run")]) == 2
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith("cicatrix: ")]
    assert len(told) == 1
    assert sentence in told[0]
    assert not (tmp_path / "run").exists()


def test_outcome_is_plain(case_file, tmp_path, no_pictures):
    cicatrix.simulate(load_case(case_file, STEPS), tmp_path / "run")
    outcome = json.loads((tmp_path / "run" / "outcome.json").read_text())
    assert outcome["bonds"]["value"] == 32_000
    assert outcome["steps"]["value"] == 600
    assert all(set(asked) == {"value", "unit", "note"} for asked in outcome.values())


@pytest.mark.parametrize(("dt", "chance"), [("10.0", "0.19"), ("1.0", None)])
def test_long_steps_are_noted(dt, chance, case_file):
    """By hand: 1 - exp(-10 * 0.012 exp(49 / 2e4 / kT)) = 0.19."""
    _, notes = law_and_notes(load_case(case_file, [*STEPS, f"method.dt_s={dt}"]))
    words = (
        f"A bond switches with probability {chance} in one step of {dt[:-2]} s: a shorter method.dt_s is more exact."
    )
    assert notes == ([words] if chance else [])


@pytest.mark.parametrize("ground", [SOLID, "substrate={type='maxwell', stiffness_pN_um=1e3, viscosity_pN_s_um=1e4}"])
def test_clutches_on_ground_that_yields(ground, case_file, no_pictures):
    settings = [
        ground,
        "cell={clutch={}}",
        *STEPS,
        "method.n_integrins=20",
        "method.duration_s=10.0",
        "method.dt_s=0.1",
    ]
    assert np.isfinite(cicatrix.simulate(load_case(case_file, settings)).history["force_pN"]).all()


def test_motors_and_clutches(case_file, tmp_path, no_pictures):
    """By hand: motors stall if bonds never open; 50 motors of 2 pN on 40 clutches give 2.5 pN each, and 1 kPa at 400 per um^2."""
    settings = ["cell={clutch={}}", "bond.k_off_per_s=1e-12", "method.start_bound_fraction=1.0", *STEPS[2:]]
    settings += ["cell.clutch.bond_force_pN=1e3", "method.n_integrins=40", "method.n_cells=2"]
    case = load_case(case_file, settings)
    straight = cicatrix.simulate(case, tmp_path / "straight")
    assert straight.outcome["cell_force_pN"].value == pytest.approx([100.0, 100.0], rel=1e-6)
    assert straight.outcome["flow_um_per_s"].value == pytest.approx([0.0, 0.0], abs=1e-6)
    assert list(straight.history) == [*COLUMNS, "cell_force_pN", "flow_um_per_s"]
    assert straight.history["cell_force_pN"][-1] == pytest.approx(100.0, rel=1e-6)
    assert straight.history["force_pN"][-1] == pytest.approx(2.5, rel=1e-6)
    assert straight.history["traction_kPa"][-1] == pytest.approx(1.0, rel=1e-6)


def test_cluster_of_a_case(case_file, no_pictures):
    """By hand, for two bonds that share 14 pN, each on its own spring: 1/r_2 + (1 + g_1 / r_2) / r_1."""
    results = cicatrix.simulate(load_case(case_file, ["cluster={bonds=2}"]))
    r2, r1 = 2 * 0.012 * np.exp(49 / 2e4 / KT), 0.012 * np.exp(14**2 / 2e4 / KT)
    by_hand = 1 / r2 + (1 + 0.01 / r2) / r1
    assert results.outcome["cluster_lifetime_s"].value == pytest.approx([by_hand, by_hand], rel=1e-10)
    assert results.outcome["shortest_cluster_lifetime_s"].value == pytest.approx(by_hand, rel=1e-10)
    f = np.linspace(1.0, 30.0, 100_001)
    most = 2 * np.max(f * 0.01 / (0.01 + 0.012 * np.exp(f**2 / 2e4 / KT)))
    assert results.outcome["critical_force_pN"].value == pytest.approx([most, most], rel=1e-6)
    assert results.outcome["least_critical_force_pN"].value == pytest.approx(most, rel=1e-6)
