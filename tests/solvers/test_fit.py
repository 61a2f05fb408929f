"""Fits recover parameters exactly from exact data and within their errors from noisy data; derivatives by differences."""

import importlib.util
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

import cicatrix
from cicatrix.cases.laws import law_of
from cicatrix.cases.parameters import parameters_of, replaced
from cicatrix.core.errors import InputError
from cicatrix.inference.fit import fit, stresses_of
from cicatrix.kinds.material_point.case import PointCase
from cicatrix.kinds.material_point.measured import experiment
from cicatrix.numerics.compiler import COMPILER

EXAMPLE = Path(__file__).parents[2] / "examples" / "fit"
LOADING = {"plane": "incompressible", "time_h": [0.0, 1.0], "x": [1.0, 1.2], "y": [1.0, 1.2]}
BOUNDS = {
    "law.0.mu_kPa": (0.1, 20.0),
    "law.0.k1_kPa": (0.1, 20.0),
    "law.0.k2": (0.05, 10.0),
    "law.0.angle_deg": (0.0, 90.0),
}
TRUE = np.array([2.0, 3.0, 1.5, 30.0])
RUBBER = {"type": "mooney-rivlin", "c10_kPa": 1.0, "c01_kPa": 0.5}


def case_of(*laws):
    return PointCase.model_validate({"kind": "material-point", "law": laws, "loading": LOADING})


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("make_data", EXAMPLE / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def start():
    return cicatrix.load_case(EXAMPLE / "case.toml")


def test_exact_data_give_the_parameters_back(example, start):
    found = fit(start, experiment(start.loading, example.measured(0.0)), BOUNDS)
    np.testing.assert_allclose(found.estimates, TRUE, rtol=1e-6)
    assert max(found.rms_kPa.values()) < 1e-6
    assert min(found.r_squared.values()) > 1 - 1e-12


def test_noisy_data_give_them_within_three_standard_errors(example, start):
    found = fit(start, experiment(start.loading, example.measured()), BOUNDS)
    assert (np.abs(found.estimates - TRUE) < 3 * found.standard_errors).all()
    assert found.rms_kPa["sigma_x_kPa"] == pytest.approx(example.NOISE_KPA, rel=0.3)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.standard_errors)
    assert found.notes == ()


def test_the_data_beside_the_example_are_the_script_s(example):
    written = np.loadtxt(EXAMPLE / "biaxial.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(written, np.column_stack(list(example.measured().values())), rtol=1e-5)


def uniaxial(stress):
    """Return columns of a stretch along x with y stress-free."""
    stretch = np.linspace(1.05, 1.5, 10)
    return {"time_h": np.arange(10.0), "lambda_x": stretch, "sigma_x_kPa": stress(stretch)}


def pulled(mu):
    """Return the stress of two parallel springs: sigma = mu (l^2 - 1/l)."""
    return uniaxial(lambda stretch: mu * (stretch**2 - 1 / stretch))


def test_what_the_data_cannot_tell_apart_is_said():
    case = case_of({"type": "neo-hookean", "mu_kPa": 1.0}, {"type": "neo-hookean", "mu_kPa": 3.0})
    bounds = {"law.0.mu_kPa": (0.1, 9.0), "law.1.mu_kPa": (0.1, 9.0)}
    found = fit(case, experiment(case.loading, pulled(5.0)), bounds)
    assert found.estimates.sum() == pytest.approx(5.0, rel=1e-8)
    assert np.isnan(found.standard_errors).all()
    assert "Not identifiable: only a combination of law.0.mu_kPa, law.1.mu_kPa" in found.notes[0]


def test_a_parameter_at_its_bound_is_said():
    case = case_of({"type": "neo-hookean", "mu_kPa": 1.0})
    found = fit(case, experiment(case.loading, pulled(5.0)), {"law.0.mu_kPa": (0.1, 3.0)})
    assert found.estimates == pytest.approx([3.0], rel=1e-5)
    assert "law.0.mu_kPa is at its upper bound, 3" in found.notes[0]
    assert np.isnan(found.standard_errors).all()


def test_standard_error_of_a_straight_line():
    """sigma = mu x is linear in mu: the standard error by hand is s / |x|, s^2 the sum of squares over n - 1."""
    noise = 0.1 * np.random.default_rng(2).standard_normal(10)
    columns = pulled(5.0) | {"sigma_x_kPa": pulled(5.0)["sigma_x_kPa"] + noise}
    case = case_of({"type": "neo-hookean", "mu_kPa": 1.0})
    found = fit(case, experiment(case.loading, columns), {"law.0.mu_kPa": (0.1, 30.0)})
    x, y = pulled(1.0)["sigma_x_kPa"], columns["sigma_x_kPa"]
    mu = (x @ y) / (x @ x)
    s = np.sqrt(np.sum((y - mu * x) ** 2) / 9)
    assert found.estimates[0] == pytest.approx(mu, rel=1e-9)
    assert found.standard_errors[0] == pytest.approx(s / np.linalg.norm(x), rel=1e-7)


@pytest.mark.slow
def test_derivatives_through_a_viscous_history_are_those_of_differences():
    fibres = {
        "type": "fibre-distribution",
        "mu_f_kPa": 2.0,
        "orientation": {"type": "single"},
        "viscous": {"beta": 0.8, "relaxation_s": 20.0},
    }
    case = case_of({"type": "neo-hookean", "mu_kPa": 1.0}, fibres)
    keys = ("law.0.mu_kPa", "law.1.mu_f_kPa", "law.1.viscous.beta", "law.1.viscous.relaxation_s")
    p = np.array([parameters_of(case)[key] for key in keys])
    columns = {"time_h": np.arange(4) / 360, "lambda_x": np.array([1.0, 1.1, 1.2, 1.2]), "sigma_x_kPa": np.zeros(4)}
    model = stresses_of(case, experiment(case.loading, columns), keys, p)
    found = jax.jit(jax.jacfwd(model), compiler_options=COMPILER)(p)[:, 0]
    compiled = partial(jax.jit(model, compiler_options=COMPILER))
    for k, value in enumerate(p):
        h = 1e-5 * value * np.eye(4)[k]
        by_differences = (compiled(p + h) - compiled(p - h))[:, 0] / (2 * h[k])
        np.testing.assert_allclose(found[:, k], by_differences, rtol=1e-6, atol=1e-8)
    assert (np.abs(found[-1]) > 1e-4).all()


def test_keys_of_all_laws():
    case = case_of(RUBBER | {"viscous": {"beta": [0.5], "relaxation_s": [10.0]}})
    found = parameters_of(case)
    assert found["law.0.viscous.beta.0"] == 0.5
    assert law_of(replaced(case, {"law.0.viscous.relaxation_s.0": 7.0})).relaxation == (7.0,)


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ({"law.0.c1_kPa": (0.1, 1.0)}, "law.0.c1_kPa is not a parameter .* did you mean law.0.c"),
        ({"law.0.c10_kPa": (2.0, 1.0)}, "bounds must ascend; got 2..1"),
        ({"law.0.c10_kPa": (-2.0, 1.0)}, "law.0.c10_kPa = -2: MooneyRivlin.c10"),
        (
            {"law.0.c10_kPa": (0.1, 1.0), "law.0.c01_kPa": (0.1, 1.0), "law.0.kappa_kPa": (0.0, 1.0)},
            "2 measured stresses for 3",
        ),
    ],
)
def test_wrong_wishes_are_refused(bounds, words):
    case = case_of(RUBBER)
    columns = {name: column[:2] for name, column in pulled(1.0).items()}
    with pytest.raises(InputError, match=words):
        fit(case, experiment(case.loading, columns), bounds)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"lambda_y": np.ones(10)}, "column sigma_y_kPa is missing"),
        ({"sigma_x_kPa": np.full(10, np.nan)}, "sigma_x_kPa has no number in row 1"),
        ({"lambda_x": -np.ones(10)}, "lambda_x must be above 0"),
        ({"time_h": np.arange(10.0)[::-1]}, "time_h must ascend; it does not in row 2"),
        ({"sigma_x_kPa": np.array(["?"] * 10)}, "sigma_x_kPa must hold numbers alone"),
    ],
)
def test_wrong_data_are_refused(changed, words):
    with pytest.raises(InputError, match=words):
        experiment(case_of(RUBBER).loading, pulled(1.0) | changed)
