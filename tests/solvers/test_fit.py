"""Fits recover parameters exactly from exact data and within their errors from noisy data; derivatives by differences."""

import importlib.util
import re
from functools import partial
from itertools import pairwise, permutations
from pathlib import Path

import jax
import numpy as np
import pytest

import cicatrix
from cicatrix.cases.laws import law_of
from cicatrix.cases.parameters import parameters_of, replaced
from cicatrix.core.errors import InputError
from cicatrix.files.measurements import Measurements
from cicatrix.inference.fit import fit, stresses_of
from cicatrix.inference.identifiability import covariance_of, undetermined
from cicatrix.inference.residuals import chance_of_runs, notes_on_residuals, r_squared, refuse_nothing_fitted
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
    found = fit(start, experiment(start.loading, Measurements(example.measured(0.0))), BOUNDS)
    np.testing.assert_allclose(found.estimates, TRUE, rtol=1e-6)
    assert max(found.rms_kPa.values()) < 1e-6
    assert min(found.r_squared.values()) > 1 - 1e-12


def test_noisy_data_give_them_within_three_standard_errors(example, start):
    found = fit(start, experiment(start.loading, Measurements(example.measured())), BOUNDS)
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


@pytest.mark.parametrize(
    ("law", "true", "beside"),
    [
        ("exponential", {"mu_kPa": (0.1, 0.05, 2.0), "b": (2.0, 0.0, 20.0)}, []),
        pytest.param(
            "locking-skin",
            {
                "mu_kPa": (8.0, 0.1, 20.0),
                "stiff_kPa": (43.0, 5.0, 200.0),
                "steepness": (4.0, 1.0, 20.0),
                "locking_stretch": (1.2, 1.05, 1.4),
            },
            [],
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "ligaments",
            {"stiffness_kPa": (40.0, 1.0, 300.0), "slack_stretch": (1.15, 1.0, 1.4)},
            [{"type": "exponential", "mu_kPa": 0.1, "b": 2.0}],
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_law_is_found_again_from_its_own_noisy_data(law, true, beside):
    """Tension along x with a free y up to 1.5; noise of 0.3 % of the largest stress, three standard errors."""
    share = {"share": 0.02} if law == "ligaments" else {}
    made = case_of({"type": law, **share} | {key: value for key, (value, _, _) in true.items()}, *beside)
    stretch = np.linspace(1.0, 1.5, 41)[1:]
    exact = uniaxial_stress(law_of(made), stretch)
    noise = 0.003 * exact.max()
    noisy = exact + noise * np.random.default_rng(4).standard_normal(len(exact))
    columns = {"time_h": np.arange(40.0), "lambda_x": stretch, "sigma_x_kPa": noisy}
    start = case_of(
        {"type": law, **share}
        | {key: value + 0.3 * (0.5 * (low + value) - value) for key, (value, low, _) in true.items()},
        *beside,
    )
    free = {f"law.0.{key}": (low, high) for key, (_, low, high) in true.items()}
    found = fit(start, experiment(start.loading, Measurements(columns)), free)
    values = np.array([value for value, _, _ in true.values()])
    assert (np.abs(found.estimates - values) < 3 * found.standard_errors).all()
    assert (found.standard_errors < 0.2 * values).all()
    assert found.rms_kPa["sigma_x_kPa"] == pytest.approx(noise, rel=0.3)


def uniaxial_stress(law, stretch):
    """Return the Cauchy stress of incompressible tension: l dPsi/dl along diag(l, l^-1/2, l^-1/2), by central differences."""

    def energy(l):
        return np.asarray(law.energy(np.array([np.diag([x, x**-0.5, x**-0.5]) for x in l])))

    return stretch * (energy(stretch + 1e-6) - energy(stretch - 1e-6)) / 2e-6


def test_what_the_data_cannot_tell_apart_is_said():
    case = case_of({"type": "neo-hookean", "mu_kPa": 1.0}, {"type": "neo-hookean", "mu_kPa": 3.0})
    bounds = {"law.0.mu_kPa": (0.1, 9.0), "law.1.mu_kPa": (0.1, 9.0)}
    found = fit(case, experiment(case.loading, Measurements(pulled(5.0))), bounds)
    assert found.estimates.sum() == pytest.approx(5.0, rel=1e-8)
    assert np.isnan(found.standard_errors).all()
    assert "Not identifiable: only a combination of law.0.mu_kPa, law.1.mu_kPa" in found.notes[0]


def test_a_parameter_at_its_bound_is_said():
    case = case_of({"type": "neo-hookean", "mu_kPa": 1.0})
    found = fit(case, experiment(case.loading, Measurements(pulled(5.0))), {"law.0.mu_kPa": (0.1, 3.0)})
    assert found.estimates == pytest.approx([3.0], rel=1e-5)
    assert "law.0.mu_kPa is at its upper bound, 3" in found.notes[0]
    assert np.isnan(found.standard_errors).all()


def test_standard_error_of_a_straight_line():
    """sigma = mu x is linear in mu: the standard error by hand is s / |x|, s^2 the sum of squares over n - 1."""
    noise = 0.1 * np.random.default_rng(2).standard_normal(10)
    columns = pulled(5.0) | {"sigma_x_kPa": pulled(5.0)["sigma_x_kPa"] + noise}
    case = case_of({"type": "neo-hookean", "mu_kPa": 1.0})
    found = fit(case, experiment(case.loading, Measurements(columns)), {"law.0.mu_kPa": (0.1, 30.0)})
    x, y = pulled(1.0)["sigma_x_kPa"], columns["sigma_x_kPa"]
    mu = (x @ y) / (x @ x)
    s = np.sqrt(np.sum((y - mu * x) ** 2) / 9)
    assert found.estimates[0] == pytest.approx(mu, rel=1e-9)
    assert found.standard_errors[0] == pytest.approx(s / np.linalg.norm(x), rel=1e-7)


def neo_hookean():
    return case_of({"type": "neo-hookean", "mu_kPa": 1.0})


def spring(columns, mu):
    """Return derivative by mu, residual and stress of sigma = mu (l^2 - 1/l) at the measurements."""
    slope = columns["lambda_x"] ** 2 - 1 / columns["lambda_x"]
    return slope[:, None], mu * slope - columns["sigma_x_kPa"], mu * slope


def best(columns):
    """Return mu by hand, linear least squares."""
    slope = spring(columns, 0.0)[0][:, 0]
    return float(slope @ columns["sigma_x_kPa"] / (slope @ slope))


def test_one_informative_row_gives_no_error():
    """At stretch 1 the stress is 0 whatever mu: of three rows one tells something, and a line through one point has no error."""
    stretch = np.array([1.0, 1.0, 1.2])
    columns = {"lambda_x": stretch, "sigma_x_kPa": 2.0 * (stretch**2 - 1 / stretch) + 1e-16}
    slope, residual, _ = spring(columns, 2.0)
    covariance, _, doubts = covariance_of(("mu",), slope, residual, np.array([0]))
    assert np.isnan(covariance).all()
    assert doubts == [
        "Errors cannot be estimated: 1 of 3 measured stresses depend on the free parameters, which are 1."
    ]
    two, _, doubts = covariance_of(("mu",), np.append(slope, slope[-1:], 0), np.append(residual, 0.1), np.array([0]))
    assert np.isfinite(two).all()
    assert doubts == []


def test_nothing_fitted_is_refused():
    with pytest.raises(InputError, match="nothing was fitted: mu has no effect on these data"):
        covariance_of(("mu",), np.zeros((5, 1)), np.ones(5), np.array([0]))
    for factor in (1e-3, 1e3):
        columns = pulled(2.0 * factor)
        _, residual, _ = spring(columns, 0.1 if factor < 1.0 else 30.0)
        with pytest.raises(
            InputError, match=r"nothing was fitted: .* check the units .*, and the bounds: mu is at its end"
        ):
            refuse_nothing_fitted(residual, columns["sigma_x_kPa"], ["mu is at its end"])


def test_stresses_that_are_all_zero_fit_nothing():
    with pytest.raises(InputError, match=r"none of the data; measured stresses reach 0 kPa"):
        refuse_nothing_fitted(np.full((5, 1), 0.1), np.zeros((5, 1)), [])


def test_equal_stresses_have_no_variation_to_explain():
    errors, stress = np.full(13, 1e-16), np.full(13, 0.6) + 1e-16 * (np.arange(13) % 2)
    assert np.isnan(r_squared(errors, stress))
    columns = {"lambda_x": np.full(13, 1.1), "sigma_x_kPa": stress}
    assert notes_on_residuals(columns, {"sigma_x_kPa": errors}, {"sigma_x_kPa": stress}) == []


def test_a_nearly_constant_stress_is_fitted_by_its_mean():
    """A stress that relaxes a little at constant stretch: an elastic law explains none of the variation, but the stress."""
    columns = {"lambda_x": 1.2 + 1e-3 * (np.arange(9) % 2), "sigma_x_kPa": np.linspace(2.1, 1.9, 9)}
    residual = spring(columns, best(columns))[1]
    assert r_squared(residual, columns["sigma_x_kPa"]) < 0.0
    refuse_nothing_fitted(residual, columns["sigma_x_kPa"], [])


def test_a_parameter_that_data_hardly_determine_is_said():
    x, errors, span = (
        np.array([0.63, 0.63, 1e-9, 90.0]),
        np.array([1.7, 0.1, 1e-8, 60.0]),
        np.array([5.0, 5.0, 1.0, 100.0]),
    )
    said = ["a is hardly determined by these data: 0.63 has the standard error 1.7."]
    said += ["d is hardly determined by these data: 90 has the standard error 60."]
    assert undetermined("abcd", x, errors, span) == said
    assert undetermined("a", x[:1], np.array([np.nan]), span[:1]) == []


@pytest.mark.parametrize("of", ["an offset", "a preload"])
def test_systematic_residuals_are_said(of):
    stretch = np.linspace(1.0, 1.3, 13)
    stress = 2.0 * (stretch**2 - 1 / stretch) + (0.4 if of == "an offset" else 0.0)
    columns = {"lambda_x": stretch / (1.03 if of == "a preload" else 1.0), "sigma_x_kPa": stress}
    _, residual, fitted = spring(columns, best(columns))
    first, *more = notes_on_residuals(columns, {"sigma_x_kPa": residual}, {"sigma_x_kPa": fitted})
    # by hand: 2 runs of 13 signs, 8 and 5 of a kind, are 2 of the 13!/(8! 5!) = 1287 orders, or 6 and 7, 2 of 1716
    assert re.match(
        r"The residuals of sigma_x_kPa are systematic: among 13, 1 change of sign, .* probability 0.00[123] ", first
    )
    assert [note.partition(" kPa at stretch 1")[0] for note in more] == (
        ["sigma_x_kPa is 0.4"] if of == "an offset" else []
    )


def test_scatter_is_not_systematic():
    columns = pulled(2.0)
    for seed in range(5):
        noise = 0.05 * np.random.default_rng(seed).standard_normal(10)
        scattered = columns | {"sigma_x_kPa": columns["sigma_x_kPa"] + noise}
        _, residual, fitted = spring(scattered, best(scattered))
        assert notes_on_residuals(scattered, {"sigma_x_kPa": residual}, {"sigma_x_kPa": fitted}) == []


def test_chance_of_runs_is_that_of_all_orders():
    for n_plus, n_minus in ((3, 4), (1, 5), (4, 4)):
        orders = set(permutations([1] * n_plus + [-1] * n_minus))
        runs = [1 + sum(a != b for a, b in pairwise(order)) for order in orders]
        for most in range(2, n_plus + n_minus + 1):
            counted = sum(count <= most for count in runs) / len(orders)
            assert chance_of_runs(most, n_plus, n_minus) == pytest.approx(counted, rel=1e-12)
    assert chance_of_runs(1, 8, 0) == 2 * 0.5**8  # all of one sign, either one


@pytest.mark.parametrize(
    ("plane", "columns", "words"),
    [
        (
            "incompressible",
            {"lambda_y": 1.0, "lambda_z": 1.0, "sigma_y_kPa": 1.0},
            "lambda_z contradicts incompressibility",
        ),
        ("incompressible", {"lambda_z": 1.1}, "lambda_z contradicts incompressibility with equal stretches across"),
        (
            "incompressible",
            {"sigma_z_kPa": 2.0},
            "sigma_z_kPa is not used: the loading assumes that it is 0; it reaches 2 kPa",
        ),
        ("stress", {"lambda_z": 0.9}, "lambda_z is not used"),
        ("strain", {"lambda_z": 0.9}, "lambda_z is not used: plane strain assumes that it is 1"),
        ("incompressible", {"sigma_xy_kPa": 1.0}, "sigma_xy_kPa is not used, as there is no column shear"),
        ("incompressible", {"sigma_z_kPa": 0.0}, None),
    ],
)
def test_a_column_that_contradicts_the_loading_is_said(plane, columns, words):
    case = neo_hookean().changed({"law.0.kappa_kPa": 10.0, "loading.plane": plane, "loading.y": None})
    notes = experiment(
        case.loading, Measurements(pulled(1.0) | {name: np.full(10, v) for name, v in columns.items()})
    ).notes
    assert len(notes) == (words is not None)
    assert words is None or words in notes[0]


def test_a_consistent_thickness_is_no_contradiction():
    columns = pulled(1.0)
    columns["lambda_z"] = columns["lambda_x"] ** -0.5
    assert experiment(neo_hookean().loading, Measurements(columns)).notes == ()


def test_rows_with_gaps_are_left_out():
    columns = pulled(5.0)
    columns["sigma_x_kPa"][3] = np.nan
    found = experiment(neo_hookean().loading, Measurements(columns, lines=tuple(range(2, 12))))
    assert len(found.asked.time) == len(found.stresses["sigma_x_kPa"]) == 9
    words = "Rows without a value in each of time_h, lambda_x, sigma_x_kPa are left out: 1, the first is row 5."
    assert found.notes == (words,)


def test_measured_shear_is_prescribed_without_a_measured_shear_stress():
    measured = Measurements(pulled(1.0) | {"shear": np.linspace(0.0, 0.3, 10)})
    found = experiment(neo_hookean().loading, measured)
    np.testing.assert_array_equal(found.asked.shear, measured.columns["shear"])
    assert list(found.stresses) == ["sigma_x_kPa"]


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
    model = stresses_of(case, experiment(case.loading, Measurements(columns)), keys, p)
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
        fit(case, experiment(case.loading, Measurements(columns)), bounds)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"lambda_y": np.ones(10)}, "column sigma_y_kPa is missing"),
        ({"sigma_x_kPa": np.full(10, np.nan)}, "no row has a value for each of time_h, lambda_x, sigma_x_kPa"),
        (
            {"lambda_x": -np.ones(10)},
            "lambda_x must be a stretch, .* above 0; got -1 in row 1: of a strain take 1 . strain",
        ),
        ({"time_h": np.arange(10.0)[::-1]}, "time_h must ascend; it does not in row 2"),
        ({"lambda_x": 100 * pulled(1.0)["lambda_x"]}, "got 150 in row 10: divide percent by 100"),
        ({"lambda_x": np.linspace(0.01, 0.3, 10)}, "1 at rest; the largest is 0.3: of a strain take 1 . strain"),
    ],
)
def test_wrong_data_are_refused(changed, words):
    with pytest.raises(InputError, match=words):
        experiment(case_of(RUBBER).loading, Measurements(pulled(1.0) | changed))
