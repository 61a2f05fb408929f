"""Several MPI ranks, started by mpiexec, give the bits of one process."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from ranks_worker import N_LARGE, chosen, digests

import cicatrix
from cicatrix.core import native, ranks
from cicatrix.core.errors import InputError
from cicatrix.kinds.registry import load_case

BIN = Path(sys.executable).parent
MPIEXEC = shutil.which("mpiexec", path=f"{BIN}{os.pathsep}{os.environ.get('PATH', '')}")
WORKER = Path(__file__).with_name("ranks_worker.py")
CASE = """
kind = "automaton"
[lattice]
type = "fcc"
size = [90, 90, 90]
[wound]
shape = "ball"
radius_um = 250.0
[rules]
p_layer = 0.01
[run]
max_steps = 25
"""

DEMO = Path(cicatrix.__file__).parent / "kinds" / "lumpectomy" / "demo.toml"

pytestmark = pytest.mark.xdist_group("ranks")  # run alone once
needs_mpi = pytest.mark.skipif(MPIEXEC is None, reason="mpiexec is not there")
needs_native = pytest.mark.skipif(not native.is_native, reason="the compiled module is not there")


def mpiexec(n, *command):
    """Start ranks, which may exceed the number of cores; return all their output."""
    environment = {**os.environ, "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    environment |= {"OMPI_MCA_rmaps_base_oversubscribe": "1", "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}
    return subprocess.run(
        [MPIEXEC, "-n", str(n), *map(str, command)], env=environment, capture_output=True, text=True, timeout=300
    )


def worker(n, *arguments):
    done = mpiexec(n, sys.executable, WORKER, *arguments)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.strip().splitlines()[-1])


@pytest.fixture
def case_file(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    return path


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """Return the results of the case on one rank."""
    folder = tmp_path_factory.mktemp("straight")
    (folder / "case.toml").write_text(CASE)
    return cicatrix.simulate(load_case(folder / "case.toml"), folder / "run")


@pytest.fixture(scope="module")
def alone():
    return [digest for digest, _ in digests()]


@needs_mpi
@needs_native
@pytest.mark.parametrize(
    ("n", "every"), [(2, 1), (3, 6), *(pytest.param(n, 1, marks=pytest.mark.slow) for n in (3, 5))]
)
def test_any_number_of_ranks_gives_the_same_bits(n, every, alone):
    """30 cases, or every sixth of them and the large ones where ranks outnumber the cores: waiting ranks use up theirs.

    Masks, several wounds, wounds at the frame, p = 0 and 1, both redistributions, energies per site.
    """
    told = worker(n, "digests", every)
    assert told["alike"]
    assert [digest for digest, _ in told["digests"]] == chosen(alone, every)
    shared = [max(ranks_of_steps) for _, ranks_of_steps in told["digests"]]
    assert shared[-N_LARGE:] == [n] * N_LARGE  # shared in every step
    assert every > 1 or shared.count(n) >= 12


@needs_mpi
def test_a_run_on_two_ranks_is_the_run_of_one(case_file, straight, tmp_path):
    done = mpiexec(2, BIN / "cicatrix", "run", case_file, "--out", tmp_path / "two")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("occupancy_sha256") == 1  # printed once
    assert straight.outcome["occupancy_sha256"].value in done.stdout
    for name in ("history.csv", "figures/closure.png"):
        assert (tmp_path / "two" / name).read_bytes() == (straight.folder / name).read_bytes()
    notes = (tmp_path / "two" / "manifest.json").read_text()
    assert "on 2 ranks" in notes
    assert "Several ranks shared 25 steps" in notes


@needs_mpi
def test_a_run_stopped_on_two_ranks_goes_on_alone(case_file, straight, tmp_path):
    assert worker(2, "interrupted", case_file, tmp_path / "two", "step 12") == "interrupted"
    resumed = cicatrix.simulate(load_case(case_file), tmp_path / "two", resume=True)
    assert any("Resumed after cycle 12" in note for note in resumed.manifest["notes"])
    assert (tmp_path / "two" / "history.csv").read_bytes() == (straight.folder / "history.csv").read_bytes()
    assert resumed.outcome["occupancy_sha256"] == straight.outcome["occupancy_sha256"]


@needs_mpi
@pytest.mark.parametrize(("moment", "end"), [("lattice", "interrupted"), ("outcome", "finished")])
def test_ranks_end_together_whenever_they_are_interrupted(moment, end, case_file, tmp_path):
    """Before the first step the run is saved at step 0; after the last step it is finished."""
    assert worker(2, "interrupted", case_file, tmp_path / "run", moment) == end
    assert f'"{end}"' in (tmp_path / "run" / "manifest.json").read_text()


@needs_mpi
@needs_native
def test_what_all_ranks_see_fail_fails_alike(case_file, tmp_path):
    assert worker(2, "all-fail", case_file, tmp_path / "run") == "cells were lost"
    assert '"failed"' in (tmp_path / "run" / "manifest.json").read_text()


@needs_mpi
@needs_native
def test_a_fault_of_one_rank_ends_all():
    done = mpiexec(3, sys.executable, WORKER, "one-fails")
    assert done.returncode != 0
    assert "never here" not in done.stdout
    assert "rank 2 failed, so all 3 ranks are aborted" in done.stderr
    assert "a fault of one rank" in done.stderr


@needs_mpi
@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (["run", "nosuch.toml"], "there is no such file"),
        (["demo"], "cicatrix demo runs in one process: start it without mpiexec"),
        (["run", DEMO], "runs in one process"),
    ],
)
def test_what_ranks_cannot_do_is_told_once(command, sentence, tmp_path):
    done = mpiexec(2, BIN / "cicatrix", *command, "--out", tmp_path / "run")
    assert done.returncode == 2
    assert done.stderr.count("cicatrix: ") == 1
    assert sentence in done.stderr
    assert not (tmp_path / "run").exists()


@needs_mpi
def test_a_folder_that_is_taken_is_told_once(case_file, tmp_path):
    cicatrix.simulate(load_case(case_file, ["run.max_steps=2"]), tmp_path / "run")
    done = mpiexec(2, BIN / "cicatrix", "run", case_file, "--out", tmp_path / "run")
    assert done.returncode == 2
    assert done.stderr.count("holds a finished run") == 1


@pytest.fixture
def started(monkeypatch):
    """Set the environment as if mpiexec had started this process."""
    ranks.world.cache_clear()
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "3")
    monkeypatch.setenv("MPI4PY_LIBMPI", "")  # the program sets it for this process; it is removed again after the test
    monkeypatch.delenv("MPI4PY_LIBMPI")
    yield monkeypatch
    ranks.world.cache_clear()


def test_ranks_without_mpi4py_are_told_what_to_install(started):
    started.setitem(sys.modules, "mpi4py", None)
    with pytest.raises(InputError, match=r"3 ranks, but mpi4py cannot be loaded .* pip install 'cicatrix\[mpi\]'"):
        ranks.world()


@needs_mpi
def test_mpiexec_of_another_library_is_told(case_file, tmp_path):
    """The environment says that there are three ranks, and the MPI library has only one."""
    command = [BIN / "cicatrix", "run", case_file, "--out", tmp_path / "run"]
    environment = {**os.environ, "OMPI_COMM_WORLD_SIZE": "3"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert "mpiexec started 3 ranks, but mpi4py finds 1" in done.stderr
    assert not (tmp_path / "run").exists()


def test_one_process_is_one_rank(monkeypatch):
    for name in (*ranks.SIZES, ranks.PMIX):
        monkeypatch.delenv(name, raising=False)
    alone = ranks.world.__wrapped__()
    assert (alone.rank, alone.size, alone.is_first) == (0, 1, True)
    assert alone.gather(b"x") == [b"x"]
    assert alone.agree(lambda: alone.share(3)) == 3
