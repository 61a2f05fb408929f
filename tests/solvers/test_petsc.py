"""PETSc on 1, 2 and 3 ranks, started by mpiexec, gives the results of one process without PETSc.

The fast tests start two ranks, for which CI has the cores.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import petsc_worker
import pytest

import cicatrix
from cicatrix.cli.main import main
from cicatrix.geometry.tetrahedra import oriented
from cicatrix.kinds.registry import load_case
from cicatrix.mechanics.division import bisected
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.numerics import petsc

BIN = Path(sys.executable).parent
MPIEXEC = shutil.which("mpiexec.openmpi")  # of the MPI library that Debian's PETSc is linked with
WORKER = Path(petsc_worker.__file__)
CASE = """
kind = "equilibrium"
[body]
mesh = "body.vtu"
[solver]
relative_tolerance = 1e-10
"""

needs_petsc = pytest.mark.skipif(
    MPIEXEC is None or not petsc.is_installed(),
    reason="PETSc and its mpiexec are not there: apt-get install python3-petsc4py openmpi-bin",
)


def start(command, **more):
    """Run a program on a number of ranks, which may exceed the number of cores, with extra environment variables."""
    environment = {**os.environ, **more, "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    environment |= {"OMPI_MCA_rmaps_base_oversubscribe": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    return subprocess.run(list(map(str, command)), env=environment, capture_output=True, text=True, timeout=600)


def worker(n, job, folder):
    done = start([MPIEXEC, "-n", n, sys.executable, WORKER, job, folder / "found.npz"])
    assert done.returncode == 0, done.stderr[-3000:]
    return dict(np.load(folder / "found.npz"))


@pytest.fixture(scope="module")
def alone():
    return petsc_worker.shapes(petsc_worker.breast())


@needs_petsc
@pytest.mark.parametrize("n", [*(pytest.param(n, marks=pytest.mark.slow) for n in (1, 3)), 2])
def test_any_number_of_ranks_finds_the_same_shapes(n, alone, tmp_path):
    """Loaded and unloaded, MUMPS and GAMG: to 1e-8 of the largest displacement, nearly incompressible, 17 mm of 50."""
    found = worker(n, "shapes", tmp_path)
    X = petsc_worker.breast().discretization.space.positions
    assert np.abs(alone["loaded"] - X).max() > 10.0
    for method in petsc_worker.METHODS:
        for name in ("loaded", "unloaded"):
            bound = 1e-8 * np.abs(alone[name] - X).max()
            np.testing.assert_allclose(found[f"{method} {name}"], alone[name], rtol=0, atol=bound)
        for name in ("energy", "potential"):
            assert found[f"{method} {name}"] == pytest.approx(alone[name], rel=1e-8)


@needs_petsc
@pytest.mark.parametrize("n", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_systems_of_every_kind(n, tmp_path):
    """Solutions, signs of eigenvalues, refusals and restored factors are the same for any distribution of rows."""
    found, rhs = worker(n, "systems", tmp_path), np.linspace(-1.0, 1.0, 3 * petsc_worker.N)
    matrices = petsc_worker.matrices()
    for method in petsc_worker.METHODS:
        for name in ("definite", "indefinite", "general"):
            x = np.linalg.solve(matrices[name], rhs)
            np.testing.assert_allclose(found[f"{method} {name}"], x, rtol=0, atol=1e-9 * np.abs(x).max())
            assert found[f"{method} {name} is definite"] == (name == "definite")
            for again in ("again", "restored"):
                np.testing.assert_allclose(found[f"{method} {name} {again}"], x / 1.01, atol=1e-9 * np.abs(x).max())
        assert "singular" in str(found[f"{method} singular"])
        assert "not finite" in str(found[f"{method} not finite"])


@needs_petsc
@pytest.mark.slow
def test_downhill_on_two_ranks_with_elements_that_are_empty(tmp_path):
    whole = petsc_worker.breast()
    fraction = whole.fraction.copy()
    fraction[::50] = 0.0
    body = whole.with_tissue(whole.law, whole.density, fraction)
    X = body.discretization.space.positions
    expected, _ = Equilibrium(1e-10).loaded(body, X, 0.3 * petsc_worker.GRAVITY)
    found = worker(2, "downhill", tmp_path)["found"]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected - X).max())


def write_cube(folder, **point_data):
    """Write a soft cube fixed at its bottom, with optional point data (27, ...), and its case."""
    mesh = petsc_worker.skfem.MeshTet.init_tensor(*[np.linspace(0.0, 20.0, 3)] * 3)
    points, tetrahedra = mesh.p.T.copy(), oriented(mesh.p.T, mesh.t.T)
    same = np.ones(len(tetrahedra))
    cell_data = {"youngs_modulus_kPa": 3.0 * same, "poisson_ratio": 0.49 * same, "density_kg_m3": 1e3 * same}
    meshio.Mesh(
        points,
        [("tetra", tetrahedra)],
        point_data={"fixed": (points[:, 2] < 1e-9).astype(float), **point_data},
        cell_data={name: [values] for name, values in cell_data.items()},
    ).write(folder / "body.vtu")
    (folder / "case.toml").write_text(CASE)
    return folder / "case.toml"


def displacement(folder):
    (path,) = (folder / "fields").glob("*.vtu")
    return meshio.read(path).point_data["displacement"]


@needs_petsc
@pytest.mark.parametrize(
    ("n", "linear"), [(0, "mumps"), *(pytest.param(*of, marks=pytest.mark.slow) for of in ((2, "direct"), (3, "gamg")))]
)
def test_a_run_on_ranks_is_the_run_of_one(n, linear, tmp_path):
    """0 ranks means without mpiexec."""
    case = write_cube(tmp_path)
    cicatrix.simulate(load_case(case), tmp_path / "one")
    command = [BIN / "cicatrix", "run", case, "--out", tmp_path / "many", "--set", f"solver.linear={linear}"]
    done = start([MPIEXEC, "-n", n, *command] if n else command)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("max_displacement_mm") == 1  # printed once
    expected = displacement(tmp_path / "one")
    np.testing.assert_allclose(displacement(tmp_path / "many"), expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    method = "GAMG" if linear == "gamg" else "MUMPS"
    assert (
        f"PETSc's {method} solved the linear systems on {max(n, 1)} rank"
        in (tmp_path / "many/manifest.json").read_text()
    )


@needs_petsc
@pytest.mark.slow
def test_held_nodes_that_move_on_two_ranks(tmp_path):
    """The bottom is displaced by 2 mm; one process with PETSc selected by the environment gives the same."""
    case = write_cube(tmp_path)
    is_held = meshio.read(tmp_path / "body.vtu").point_data["fixed"]
    case = write_cube(tmp_path, prescribed_displacement=is_held[:, None] * (2.0, 0.0, 0.0))
    cicatrix.simulate(load_case(case), tmp_path / "one")
    expected = displacement(tmp_path / "one")
    assert (expected[is_held == 1.0] == (2.0, 0.0, 0.0)).all()
    command = [BIN / "cicatrix", "run", case, "--out"]
    for done in (
        start([MPIEXEC, "-n", 2, *command, tmp_path / "two"]),
        start([*command, tmp_path / "petsc"], CICATRIX_LINEAR_SOLVER="petsc"),
    ):
        assert done.returncode == 0, done.stderr
    for name in ("two", "petsc"):
        np.testing.assert_allclose(displacement(tmp_path / name), expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@needs_petsc
@pytest.mark.parametrize("what", ["sliding", "pressurised"])
def test_what_ranks_cannot_share_is_told(what, tmp_path):
    case = write_cube(tmp_path)
    points = meshio.read(tmp_path / "body.vtu").points
    is_top = (points[:, 2] > 19.9).astype(float)
    write_cube(tmp_path, **{what: is_top})
    command = [BIN / "cicatrix", "run", case, "--out", tmp_path / "run", "--set", "solver.linear=mumps"]
    done = start([*command, "--set", "loads.pressure_kPa=0.1"] if what == "pressurised" else command)
    assert done.returncode == 2
    assert "sliding walls and pressure are for one process" in done.stderr
    assert not (tmp_path / "run").exists()


@needs_petsc
def test_faults_of_a_case_are_told_once_by_two_ranks(tmp_path):
    case = write_cube(tmp_path)
    (tmp_path / "body.vtu").write_text("this is no mesh")
    done = start([MPIEXEC, "-n", 2, BIN / "cicatrix", "run", case, "--out", tmp_path / "run"])
    assert done.returncode == 2
    assert done.stderr.count("body.vtu cannot be read as a mesh") == 1
    assert not (tmp_path / "run").exists()


@needs_petsc
@pytest.mark.slow
def test_a_body_too_soft_fails_on_all_ranks_alike(tmp_path):
    case = write_cube(tmp_path)
    mesh = meshio.read(tmp_path / "body.vtu")
    mesh.cell_data["youngs_modulus_kPa"] = [0.002 * np.ones(len(mesh.cells[0].data))]
    mesh.write(tmp_path / "body.vtu")
    done = start([MPIEXEC, "-n", 2, BIN / "cicatrix", "run", case, "--out", tmp_path / "run"])
    assert done.returncode == 3
    assert "ranks are aborted" not in done.stderr  # nobody was aborted
    assert '"failed"' in (tmp_path / "run" / "manifest.json").read_text()


@needs_petsc
@pytest.mark.skipif(not (BIN / "mpiexec").exists(), reason="no other MPI library is there")
def test_mpiexec_of_another_library_is_told(tmp_path):
    """mpi4py then uses MPICH, and PETSc Open MPI."""
    done = start([BIN / "mpiexec", "-n", 2, BIN / "cicatrix", "run", write_cube(tmp_path), "--out", tmp_path / "run"])
    assert done.returncode == 2
    assert "PETSc's MPI library finds 1 ranks instead of 2" in done.stderr
    assert not (tmp_path / "run").exists()


def test_without_petsc_the_run_says_what_to_install(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(petsc, "_candidates", list)
    petsc.petsc.cache_clear()
    case = write_cube(tmp_path)
    assert main(["run", str(case), "--out", str(tmp_path / "run"), "--set", "solver.linear=gamg"]) == 2
    assert "PETSc was not found: apt-get install" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_parts_are_equal_and_compact(n):
    centres = np.random.default_rng(0).random((1000, 3)) * (4.0, 2.0, 1.0)
    part = bisected(centres, n)
    sizes = np.bincount(part, minlength=n)
    assert len(sizes) == n
    assert sizes.max() - sizes.min() <= 2
    if n == 2:  # divided along the longest side
        assert centres[part == 0, 0].max() <= centres[part == 1, 0].min()
