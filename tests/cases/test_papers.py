"""Run the papers' scripts on coarse meshes with two seeds; the slow tests run them unchanged."""

import csv
import importlib.util
import subprocess
import sys
from pathlib import Path

import meshio
import pytest

from cicatrix.core.errors import InputError

PAPERS = Path(__file__).parents[2] / "papers"
FIGURES = ["garbey-2013-fig2", "garbey-2013-fig5", "garbey-2013-fig6"]
COARSE = ["image.voxel_mm=3.0", "healing.pitch_um=100", "mesh.edge_mm=6.0", "mesh.cavity_edge_mm=2.0"]
POINTS = ["guo-2022-fig2", "guo-2022-fig3", "guo-2022-fig4", "guo-2022-fig5"]
WOUNDS = ["circular-wound", "breast-cavity", "automaton-and-fields"]
FEWER = ["law.1.orientation.n_angles=12", "law.1.viscous.n_waviness=32", "loading.repeat=2"]


def script(name: str):
    spec = importlib.util.spec_from_file_location(name.replace("-", "_"), PAPERS / name / "run.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", FIGURES)
def test_claims_come_out_on_a_coarse_mesh_too(name):
    paper = script(name)
    with (PAPERS / name / "expected.csv").open() as file:
        expected = {row["claim"]: row["holds"] == "yes" for row in csv.DictReader(file)}
    rows = paper.table(paper.measure((1, 2), COARSE)[0])
    assert {claim: holds for claim, _, holds in rows} == expected, rows


def test_viscous_fibres_come_out_with_fewer_of_them_too():
    """The script of Fig. 3 (growth) takes longer to compile and is among the slow tests."""
    paper = script("guo-2022-fig2")
    rows = paper.table(paper.measure([*FEWER, "solver.relative_tolerance=5e-3"]))
    assert all(holds for _, _, holds in rows), rows


@pytest.mark.slow
def test_adhesion_comes_out_with_fewer_bonds_too():
    paper = script("guo-2022-fig4")
    with (PAPERS / "guo-2022-fig4" / "expected.csv").open() as file:
        expected = {row["claim"]: row["holds"] == "yes" for row in csv.DictReader(file)}
    few = ["method.n_integrins=500", "method.n_cells=4", "method.n_rows=10", "method.dt_s=0.1"]
    rows = paper.table(paper.measure([*few, "law.1.orientation.n_angles=12"]))
    assert {claim: holds for claim, _, holds in rows} == expected, rows


def test_the_level_set_teleports_and_paths_do_not():
    paper = script("level-set-teleports")
    rows = paper.table(paper.measure((1, 2)))
    assert all(holds for _, _, holds in rows), rows


def test_the_published_compression_carries_forces_of_rounding():
    paper = script("awwad-2025-compression")
    try:
        rows = paper.table(paper.measure())
    except (InputError, meshio.ReadError):
        pytest.skip("the shared data is not beside the project; set CICATRIX_DATA to its folder")
    assert all(holds for _, _, holds in rows), rows


@pytest.mark.slow
def test_the_published_compression_is_found_again_with_the_same_rounding():
    """This takes five minutes on one core."""
    paper = script("awwad-2025-compression")
    try:
        reference = paper.Reference.read()
    except (InputError, meshio.ReadError):
        pytest.skip("the shared data is not beside the project; set CICATRIX_DATA to its folder")
    u = paper.explicit(reference, "single")
    assert paper.rms(paper.error(reference, u)) < 0.02 * paper.rms(reference.displacement)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*FIGURES, *POINTS, *WOUNDS, "clinic-closure", "level-set-teleports"])
def test_the_whole_table_is_as_expected(name, tmp_path):
    """The exit code of each script says whether its table agrees with expected.csv."""
    done = subprocess.run([sys.executable, PAPERS / name / "run.py"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
