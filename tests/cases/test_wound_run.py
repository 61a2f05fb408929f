"""Cases of kind "wound": the results of the circular wound, resuming, every kind of mechanosensing, and what is refused."""

import json
from pathlib import Path

import meshio
import numpy as np
import pytest
import skfem

import cicatrix
from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.files.vtu import write_vtu
from cicatrix.geometry.tetrahedra import oriented
from cicatrix.kinds.registry import check_case
from cicatrix.kinds.wound import run as wound_run

pytestmark = pytest.mark.xdist_group("wound")  # compiled once
EXAMPLE = Path(__file__).parents[2] / "examples" / "wound.toml"
COARSE = ["elements=16", "duration_h=100.0", "solver.time_tolerance=1e-3", "fields_every_h=50.0"]
BOND = {"k_on_per_s": 0.01, "k_off_per_s": 0.012}
ADHESION = """
[mechanosensing]
type = "adhesion"
K_kPa = 2.0
threshold_kPa = 0.4
[mechanosensing.bond]
k_on_per_s = 0.01
k_off_per_s = 0.012
[mechanosensing.substrate]
type = "exponential-fibre"
k1_MPa = 0.0703966587326
k2 = 20.81811370546901
area_um2 = 0.017
length_um = 0.1
[mechanosensing.cell]
force_pN = 7.0
integrins_per_um2 = 400.0
"""


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    out = tmp_path_factory.mktemp("wound") / "run"
    return cicatrix.simulate(cicatrix.load_case(EXAMPLE, COARSE), out), out


def test_history_and_outcome_are_what_the_interface_says(coarse):
    results, out = coarse
    names = ["time_h", "ring_area_ratio", "rho_centre", "c_centre", "phi_centre", "lamP_area_centre"]
    names += ["rho_edge", "c_edge", "phi_edge", "lamP_area_edge", "cells_total", "step_h", "newton_iterations"]
    assert set(names) <= set(results.history)
    history = results.history
    assert history["time_h"][-1] == pytest.approx(100.0)
    assert history["ring_area_ratio"][0] == 1.0
    np.testing.assert_allclose(np.diff(history["time_h"]), history["step_h"][1:], rtol=1e-9)
    outcome = json.loads((out / "outcome.json").read_text())
    assert outcome["ring_area_ratio"]["value"] == history["ring_area_ratio"][-1]
    assert {"steps", "factorizations", "n_dofs"} <= set(outcome)
    assert {p.stem for p in (out / "figures").glob("*.png")} == {"course", "fields"}


def test_cytokine_at_the_centre_decays_as_it_should(coarse):
    """At the centre there is no source and little diffusion, so cytokine is exp(-d_c t)."""
    history = coarse[0].history
    np.testing.assert_allclose(history["c_centre"], np.exp(-0.01 * history["time_h"]), rtol=0.02)


def test_the_wound_shrinks_and_cells_come(coarse):
    history = coarse[0].history
    assert history["ring_area_ratio"][-1] < 0.99
    assert history["rho_centre"][-1] > 0.05
    assert (np.diff(history["phi_edge"]) > 0).all()


def test_fields_open_elsewhere(coarse):
    first, last = (meshio.read(sorted((coarse[1] / "fields").glob("*.vtu"))[k]) for k in (0, -1))
    assert len(list((coarse[1] / "fields").glob("*.vtu"))) == 3
    assert {"cells", "cytokine", "collagen", "displacement", "signal"} <= set(last.point_data)
    assert first.point_data["cytokine"].max() == pytest.approx(1.0)
    assert np.linalg.norm(last.point_data["displacement"], axis=1).max() > 0.1


def test_without_contraction_the_ring_stays():
    settings = [*COARSE, "parameters.t_rho_MPa=0.0", "parameters.t_rho_c_MPa=0.0"]
    history = cicatrix.simulate(cicatrix.load_case(EXAMPLE, settings)).history
    np.testing.assert_allclose(history["ring_area_ratio"], 1.0, atol=1e-10)
    np.testing.assert_allclose(history["lamP_area_edge"], 1.0, atol=1e-10)


MESHED = """
kind = "wound"
duration_h = 2.0
body = { mesh = "body.vtu", mesh_unit = "cm" }
[solver]
time_tolerance = 1e-2
"""


def meshed(tmp_path, **data):
    """Write a cube of 4 cm with a wound of 1 cm radius at its centre; return the case and the wound's volume [mm^3]."""
    mesh = skfem.MeshTet.init_tensor(*[np.linspace(0.0, 4.0, 5)] * 3)
    points, cells = mesh.p.T.copy(), oriented(mesh.p.T, mesh.t.T)
    corners = points[cells]
    wound = (np.abs(corners.mean(axis=1) - 2.0) < 1.0).all(axis=1)
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    data = {"cell": {"wound": wound.astype(int)}, "point": {"fixed": (points[:, 2] == 0.0).astype(int)}} | data
    write_vtu(tmp_path / "body.vtu", points, cells, data["point"], data["cell"])
    (tmp_path / "case.toml").write_text(MESHED)
    return tmp_path / "case.toml", 1e3 * volumes[wound].sum()


def test_a_mesh_of_ones_own(tmp_path):
    """Wound volume and cells are those of the marked tetrahedra; without flux and division the number of cells is constant."""
    path, volume = meshed(tmp_path)
    still = [f"parameters.{name}_per_h=0.0" for name in ("p_rho", "p_rho_c", "p_rho_H", "d_rho")]
    still += ["parameters.t_rho_MPa=0.0", "parameters.t_rho_c_MPa=0.0"]
    history = cicatrix.simulate(cicatrix.load_case(path, still), tmp_path / "run").history
    assert history["wound_size"][0] == pytest.approx(volume, rel=1e-12)
    np.testing.assert_allclose(history["cells_total"], history["cells_total"][0], rtol=1e-12)
    assert (np.diff(history["rho_centre"]) > 0).all()  # they come from the surroundings


@pytest.mark.parametrize(
    ("data", "settings", "sentence"),
    [
        ({"cell": {}}, [], "body.vtu: cell data `wound` are missing"),
        ({"cell": {"wound": np.ones(384)}}, [], "body.vtu: cell data `wound` must be 1 in some tetrahedra"),
        ({"cell": {"wound": np.full(384, 0.5)}}, [], "body.vtu: cell data wound must be 0 or 1; got 0.5 at cell 0"),
        ({"point": {}}, [], "body.vtu: point data `fixed` (1 where a node is fixed, else 0) are missing"),
        ({}, ['benchmark="circular-wound"'], "benchmark must be"),
        ({}, ["elements=8"], "elements belongs to the benchmarks"),
    ],
)
def test_a_mesh_that_is_no_wound_is_told(data, settings, sentence, tmp_path):
    path, _ = meshed(tmp_path, **data)
    with pytest.raises(InputError) as error:
        cicatrix.simulate(cicatrix.load_case(path, settings))
    assert sentence in str(error.value)


def written(tmp_path, text, *parameters):
    path = tmp_path / "case.toml"
    head = 'kind = "wound"\nbenchmark = "circular-wound"\nelements = 8\nduration_h = 20.0\n'
    path.write_text(head + text + "\n[parameters]\n" + "\n".join(parameters) + "\n[solver]\ntime_tolerance = 1e-2\n")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["none", "moreo", "adhesion", "network"])
def test_every_way_of_sensing_runs(kind, tmp_path):
    network = Path(__file__).parents[2] / "examples" / "signalling"
    texts = {
        "none": '[mechanosensing]\ntype = "none"',
        "moreo": '[mechanosensing]\ntype = "moreo"\nK_pass_kPa = 1.0\nK_act_kPa = 20.0\np_max_kPa = 1.0\n'
        "theta_1 = -0.3\ntheta_2 = 0.4",
        "adhesion": ADHESION,
        "network": ADHESION.replace(
            'type = "adhesion"',
            f'type = "network"\nspecies = "{network}/species.csv"\nreactions = "{network}/reactions.csv"\n'
            'input = "stiffness"\noutput = "YAP"',
        ),
    }
    history = cicatrix.simulate(cicatrix.load_case(written(tmp_path, texts[kind]))).history
    assert history["time_h"][-1] == pytest.approx(20.0)
    assert np.isfinite(history["ring_area_ratio"]).all()


@pytest.mark.parametrize(
    ("text", "parameters", "sentence"),
    [
        ("", ["D_rho_mm2_per_h = -1.0"], "parameters.D_rho_mm2_per_h must be at least 0; got -1"),
        ("", ["rho_wound = -0.1"], "parameters.rho_wound must be at least 0"),
        ("", ["phi_wound = 0.0"], "parameters.phi_wound must be above 0"),
        ("", ["kappa = 0.6"], "parameters.kappa must be at least 0 and at most 0.5; got 0.6"),
        ("", ["tau_omega = 1.0"], "parameters.tau_kappa is missing"),
        ("", ["D_rho_mm_per_h = 1.0"], "D_rho_mm2_per_h"),
        ('[mechanosensing]\ntype = "logistics"', [], "logistic"),
        ('[mechanosensing]\ntype = "moreo"', [], "mechanosensing.K_pass_kPa"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(text, parameters, sentence, tmp_path):
    path = written(tmp_path, text, *parameters)
    assert any(sentence in fault for fault in check_case(path)), check_case(path)
    with pytest.raises(InputError):
        cicatrix.load_case(path)


def test_a_pull_that_the_fresh_wound_does_not_bear_is_told(tmp_path):
    with pytest.raises(ConvergenceError, match=r"No equilibrium of the fresh wound .*at most .*kPa"):
        cicatrix.simulate(cicatrix.load_case(written(tmp_path, "", "t_rho_MPa = 10.0")))


def test_a_front_that_elements_cannot_show_is_told(tmp_path):
    case = cicatrix.load_case(written(tmp_path, "", "D_rho_mm2_per_h = 0.001"))
    assert "a front of cells is about" in wound_run.WoundRun(case).notes[0]


def test_sixty_elements_and_more_show_the_front_of_the_benchmark(tmp_path):
    assert not wound_run.WoundRun(cicatrix.load_case(EXAMPLE, ["elements=120"])).notes
