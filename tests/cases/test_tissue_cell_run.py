"""Cases of kind "tissue-cell": compared with SciPy and an independent adhesion model, resumed, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import cicatrix
from cicatrix.cli.main import main
from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.kinds.registry import check_case, load_case
from cicatrix.kinds.tissue_cell.build import model_of
from cicatrix.kinds.tissue_cell.run import network_of

pytestmark = pytest.mark.xdist_group("tissue-cell")  # compiled once

EXAMPLE = Path(__file__).parents[2] / "examples" / "tissue-cell.toml"
SHORT = ["loading.time_h=[0.0, 24.0, 200.0]", "loading.n_rows=20"]
COLUMNS = "step time_h lambda lambda_s lambda_g rho_per_mm3 c_g_per_mm3 m_f bound_fraction traction_kPa sigma_kPa "
COLUMNS += "sigma_passive_kPa force_pN signal"
K1, K2, AREA, LENGTH = 0.0703966587326e6, 20.81811370546901, 0.017, 0.1  # pN, um


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return cicatrix.simulate(load_case(EXAMPLE, SHORT), tmp_path_factory.mktemp("tissue") / "run")


def pulled(stretch):
    """Return the force of a bond [pN] and its rate of opening [1/s] at a stretch: Eqs (22), (25), with the root by bisection."""
    stress = lambda x: K1 * x * np.expm1(K2 * (x**2 - 1.0))  # noqa: E731
    e = np.exp(K2 * (stretch**2 - 1.0))
    k = AREA * K1 * (e - 1.0 + 2.0 * K2 * stretch**2 * e) / LENGTH
    f = 100.0 / (1.0 - 0.5 + 2e4 / k + 2e4 / 4e3)
    far = brentq(lambda x: AREA * (stress(x) - stress(stretch)) - f, stretch, stretch + 1.0, xtol=1e-15)
    return f, 0.012 * np.exp(f * LENGTH * (far - stretch) / 4.28317e-3)


def rate(t, y):
    """Return the rates of Eqs (24), (27)-(30) as printed, per hour, with the parameters of the example."""
    g, rho, c, m, phi = y
    f, k_off = pulled(np.interp(t, [0.0, 24.0, 200.0], [1.0, 1.1, 1.1]) / g)
    beyond = max(f * phi * 400.0 * 1e-3 - 3.02, 0.0)
    H = beyond / (0.3 + beyond)
    m_rate = 0.002 * (1 + c / (1 + c) + H) * rho / (0.002 / 0.00097 - 1 + m) - 0.00097 * (1 + 0.5 * rho * c) * m
    rho_rate = 0.034 * (1 + c / (0.1 + c) + H) * (1 - rho / 1.25) * rho - 0.0068 * rho + 0.034 * (1 - rho)
    c_rate = (9e-11 * c + 2e-2 * H) * rho / (1 + c) - 0.02 * c
    return [m_rate, rho_rate, c_rate, m_rate, 3600 * (0.01 * (1 - phi) - k_off * phi)]


def test_it_is_what_scipy_finds(whole):
    found = solve_ivp(rate, (0.0, 200.0), [1, 1, 0, 1, 0], "Radau", whole.history["time_h"], rtol=1e-8, atol=1e-10)
    scale = {"lambda_g": 1.0, "rho_per_mm3": 1e4, "c_g_per_mm3": 1e-4, "m_f": 1.0, "bound_fraction": 1.0}
    for row, (name, unit) in zip(found.y, scale.items(), strict=True):
        np.testing.assert_allclose(whole.history[name] / unit, row, rtol=0, atol=2e-6, err_msg=name)


def test_it_holds_what_it_must(whole):
    history = whole.history
    assert list(history) == COLUMNS.split()
    np.testing.assert_allclose(history["lambda_s"] * history["lambda_g"], history["lambda"], rtol=1e-13)
    np.testing.assert_allclose(history["lambda_g"], history["m_f"], rtol=1e-7)  # both start at 1, and varrho_f = 1
    np.testing.assert_allclose(
        history["sigma_passive_kPa"], 10.0 * (history["lambda_s"] ** 2 - history["lambda_s"] ** -4)
    )
    active = history["rho_per_mm3"] / 1e4 * history["traction_kPa"]
    np.testing.assert_allclose(history["sigma_kPa"], history["sigma_passive_kPa"] + active)
    _, k_off = pulled(history["lambda_s"][-1])
    assert history["bound_fraction"][-1] == pytest.approx(
        0.01 / (0.01 + k_off), rel=1e-4
    )  # bonds are soon in the steady state
    assert (np.diff(history["lambda_s"][5:]) < 0).all()


def test_tissue_that_is_not_stretched_stays_as_it_is():
    history = cicatrix.simulate(load_case(EXAMPLE, [*SHORT, "loading.stretch=[1.0, 1.0, 1.0]"])).history
    for name in ("lambda_g", "m_f"):
        np.testing.assert_allclose(history[name], 1.0, rtol=0, atol=1e-9)
    assert history["traction_kPa"][-1] > 2.9


@pytest.mark.slow
def test_the_example_and_other_signals():
    results = cicatrix.simulate(load_case(EXAMPLE))
    assert results.history["lambda_s"][-1] == pytest.approx(1.0, abs=5e-3)
    moreo = (
        'signal={ type = "moreo", K_pass_kPa = 0.1, K_act_kPa = 10.0, p_max_kPa = 1.0, theta_1 = 0.0, theta_2 = 0.4 }'
    )
    history = cicatrix.simulate(load_case(EXAMPLE, [*SHORT, moreo])).history
    assert history["signal"][0] == 0.0
    assert history["lambda_g"][-1] > 1.001
    files = 'species = "signalling/species.csv", reactions = "signalling/reactions.csv", input = "stiffness", output = "YAP"'
    network = f'signal={{ type = "network", {files}, K_kPa = 0.3, threshold_kPa = 3.02 }}'
    history = cicatrix.simulate(load_case(EXAMPLE, [*SHORT, network])).history
    np.testing.assert_allclose(history["signal"], history["activity_YAP"])


@pytest.mark.parametrize(("threshold", "n"), [("3.02", 0), ("0.0", 1)])
def test_cells_that_feel_tissue_at_rest_are_noted(threshold, n):
    notes = model_of(load_case(EXAMPLE, [f"signal.threshold_kPa={threshold}"]), None).notes
    assert len(notes) == n
    assert all(note.startswith("Cells sense tissue that is not stretched: it grows until") for note in notes)


FILES = 'species = "signalling/species.csv", reactions = "signalling/reactions.csv"'


def network(driven, output):
    return [f'signal={{type="network", {FILES}, input="{driven}", output="{output}"}}']


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (["substrate.stretch=[1.0]"], "substrate.stretch must be left out: it is the elastic stretch of the tissue"),
        (["loading.stretch=[1.0, 1.1]"], "loading.stretch must have as many values as time_h (3); got 2"),
        (["turnover.p_rho=1.0"], "turnover.p_rho is not a known key; did you mean turnover.p_rho_per_h?"),
        (["turnover.d_c_per_h=-1.0"], "turnover.d_c_per_h must be at least 0; got -1"),
        (["signal.K_kPa=0.0"], "signal.K_kPa must be above 0; got 0"),
        (["signal.type=stretch"], 'signal.type must be "traction", "moreo" or "network"; got "stretch"'),
        (["law.0.viscous={beta=1.0, relaxation_s=1.0}"], "law must be elastic"),
        (["cell={clutch={}}"], "cell.clutch must be left out: give force_pN or feedback"),
    ],
)
def test_what_is_refused(settings, sentence, capsys):
    arguments = ["run", str(EXAMPLE), *[word for setting in settings for word in ("--set", setting)]]
    assert main(arguments) == 2
    (said,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("cicatrix: ")]
    assert sentence in said
    assert len(check_case(EXAMPLE, settings)) == 1


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        (["cell.feedback.beta=8.0"], "feedback is not valid"),
        (
            ["loading.stretch=[1.0, 0.7, 0.7]"],
            "loading.stretch 0.7: the tangent stiffness there must be positive; got -",
        ),
        (["loading.stretch=[1.0, 10.0, 10.0]"], "loading.stretch 10: the stress of the substrate overflows there"),
        (network("stif", "YAP"), 'signal.input names the unknown input "stif"; did you mean "stiffness"?'),
        (network("stiffness", "YAB"), 'signal.output names the unknown output "YAB"; did you mean "YAP"?'),
    ],
)
def test_what_does_not_hold_is_told(settings, sentence):
    with pytest.raises(InputError) as error:
        model_of(case := load_case(EXAMPLE, settings), network_of(case))
    assert sentence in str(error.value)


RELEASED = ["loading.time_h=[0.0, 24.0, 3000.0, 3024.0]", "loading.stretch=[1.0, 1.3, 1.3, 1.0]", "loading.n_rows=100"]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ([*SHORT, "solver.max_steps=10"], "solver.max_steps = 10 were taken; raise it."),
        (RELEASED, "the cells' pull exceeds the load that the substrate can carry there."),
    ],
)
def test_why_it_could_not_be_followed(settings, words):
    with pytest.raises(ConvergenceError, match="could not be followed beyond") as error:
        cicatrix.simulate(load_case(EXAMPLE, settings))
    assert str(error.value).endswith(words)
