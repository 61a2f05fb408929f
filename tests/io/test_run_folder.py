"""Folder of a run: refusals, resuming to the same bytes, and unfinished runs that never look finished."""

import hashlib
import json
import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.files.history import read_history
from cicatrix.runs.kind import Fields
from cicatrix.runs.progress import Progress
from cicatrix.runs.quantity import Quantity
from cicatrix.runs.results import RunFolder, open_run

mpl.use("Agg")
CASE = {"kind": "lumpectomy", "run": {"seed": 1, "max_weeks": 52.0}}
POINTS, TRIANGLES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([[0, 1, 2]])


def open_folder(path, case=CASE, **more):
    return RunFolder.open(path, case, seed=1, **more)


def go(run, last=6, stop_after=None, by=KeyboardInterrupt):
    """Stand in for a computation whose state is one number."""
    with run:
        if run.already_finished:
            return
        start = run.checkpoint.cycle + 1 if run.checkpoint else 0
        x = run.checkpoint.arrays["x"] if run.checkpoint else np.array([1.0])
        for cycle in range(start, last):
            x = x / 3
            run.record({"cycle": cycle, "time_days": cycle * 0.7, "x": x[0], "done": cycle > 3})
            run.write_fields(Fields("body", cycle, cycle * 0.7, POINTS * x, TRIANGLES))
            if cycle == stop_after:
                raise by("stopped")
            run.save_checkpoint(cycle, {"x": x}, {"time_days": cycle * 0.7})
        figure = Figure()
        figure.subplots().plot([0, 1])
        run.save_figure("line", figure)
        run.write_outcome({"x": Quantity(x[0], "mm"), "never": Quantity(float("nan"), "days", "not closed")})
        run.finish("Closed.")


def state_of(path):
    return json.loads((path / "manifest.json").read_text())["status"]


def bytes_of(path):
    files = [file for file in sorted(path.rglob("*")) if file.is_file() and file.name != "manifest.json"]
    return {str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def test_finished_run_reads_back(tmp_path):
    source = tmp_path / "image.nii"
    source.write_bytes(b"voxels")
    progress = Progress()
    with progress.stage("solve"):
        run = open_folder(tmp_path / "a", inputs={"image.path": source}, sources={"x": "y"}, progress=progress)
    go(run)
    results = open_run(tmp_path / "a")
    assert results.status == ("finished", "Closed.")
    np.testing.assert_array_equal(results.history["time_days"], np.arange(6) * 0.7)
    assert results.history["cycle"].dtype.kind == "i"
    assert results.outcome["never"] == Quantity(None, "days", "not closed")
    manifest = results.manifest
    assert manifest["inputs"]["image.path"] == {"name": "NIfTI image", "sha256": hashlib.sha256(b"voxels").hexdigest()}
    assert manifest["case"] == CASE
    assert manifest["sources"] == {"x": "y"}
    assert manifest["seconds"]["solve"]["wall"] >= 0
    assert manifest["libraries"]["numpy"] == np.__version__
    assert (tmp_path / "a" / "fields" / "series.pvd").is_file()
    assert not list((tmp_path / "a").rglob(".*"))


@pytest.mark.parametrize("stop_after", [0, 1, 5])
def test_resumed_run_has_the_same_bytes(tmp_path, stop_after):
    go(open_folder(tmp_path / "whole"))
    with pytest.raises(KeyboardInterrupt):
        go(open_folder(tmp_path / "halved"), stop_after=stop_after)
    assert state_of(tmp_path / "halved")["state"] == "interrupted"
    go(open_folder(tmp_path / "halved", resume=True))
    assert bytes_of(tmp_path / "halved") == bytes_of(tmp_path / "whole")
    assert state_of(tmp_path / "halved")["state"] == "finished"


def test_half_written_row_is_dropped(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        go(open_folder(tmp_path / "a"), stop_after=3)
    with (tmp_path / "a" / "history.csv").open("a") as stream:
        stream.write("1")  # the first byte of "12,..."
    open_folder(tmp_path / "a", resume=True).__exit__(None, None, None)
    assert list(read_history(tmp_path / "a" / "history.csv")["cycle"]) == [0, 1, 2]


@pytest.mark.skipif(sys.platform == "win32", reason="no flock")
def test_two_runs_into_one_folder(tmp_path):
    run = open_folder(tmp_path / "a")
    with pytest.raises(InputError, match="has not ended"):
        open_folder(tmp_path / "a")
    go(run)


def test_what_is_no_run_is_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty and holds no run"):
        open_folder(tmp_path)
    with pytest.raises(InputError, match="is a file"):
        open_folder(tmp_path / "thesis.txt")
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="not the manifest of a run"):
        open_folder(tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_finished_run_is_not_overwritten(tmp_path):
    go(open_folder(tmp_path / "a"))
    before = bytes_of(tmp_path / "a"), state_of(tmp_path / "a")
    with pytest.raises(InputError, match="holds a finished run"):
        open_folder(tmp_path / "a")
    run = open_folder(tmp_path / "a", resume=True)
    assert run.already_finished
    go(run)
    assert (bytes_of(tmp_path / "a"), state_of(tmp_path / "a")) == before


def test_another_case_is_not_resumed(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        go(open_folder(tmp_path / "a"), stop_after=2)
    other = {"kind": "lumpectomy", "run": {"seed": 2, "max_weeks": 52.0}, "mesh": {"edge_mm": 3.0}}
    with pytest.raises(InputError, match=r"another run.*: run\.seed, mesh\.edge_mm differ"):
        open_folder(tmp_path / "a", other, resume=True)


def test_other_bytes_are_not_resumed(tmp_path):
    source = tmp_path / "image.nii"
    for content in (b"1", b"2"):
        source.write_bytes(content)
        if content == b"1":
            with pytest.raises(KeyboardInterrupt):
                go(open_folder(tmp_path / "a", inputs={"image.path": source}), stop_after=2)
    with pytest.raises(InputError, match=r"the content of image\.path differ"):
        open_folder(tmp_path / "a", inputs={"image.path": source}, resume=True)


def test_unfinished_run_starts_over(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        go(open_folder(tmp_path / "a"), stop_after=2)
    run = open_folder(tmp_path / "a")
    assert run.checkpoint is None
    assert not (tmp_path / "a" / "history.csv").exists()
    go(run)


def test_resume_without_a_run_starts_one(tmp_path):
    go(open_folder(tmp_path / "new", resume=True))
    assert state_of(tmp_path / "new")["state"] == "finished"


def test_failure_has_its_sentence(tmp_path):
    with pytest.raises(ConvergenceError), open_folder(tmp_path / "a"):
        raise ConvergenceError("Newton stopped at load 0.4.", ["step 1: 1e-3"])
    assert state_of(tmp_path / "a") == {"state": "failed", "sentence": "Newton stopped at load 0.4."}
    assert open_run(tmp_path / "a").manifest["notes"] == ["step 1: 1e-3"]
    with pytest.raises(ZeroDivisionError), open_folder(tmp_path / "b"):
        raise ZeroDivisionError("by\nzero")
    assert state_of(tmp_path / "b")["sentence"] == "Unexpected ZeroDivisionError: by"


def test_fault_of_the_input_leaves_no_folder(tmp_path):
    with pytest.raises(InputError), open_folder(tmp_path / "a"):
        raise InputError("the image holds no breast")
    assert not (tmp_path / "a").exists()


def test_row_with_other_columns(tmp_path):
    run = open_folder(tmp_path / "a")
    run.record({"cycle": 0, "x": 1.0})
    with pytest.raises(ValueError, match="must have the columns"), run:
        run.record({"cycle": 1, "y": 1.0})


KILLED = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
import test_run_folder as t
from pathlib import Path
run = t.open_folder(Path(sys.argv[2]))
t.go(run, stop_after=3, by=lambda _: os.kill(os.getpid(), signal.SIGKILL))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_killed_run_is_not_finished_and_resumes(tmp_path, request):
    go(open_folder(tmp_path / "whole"))
    arguments = [sys.executable, "-c", KILLED, str(request.path.parent), str(tmp_path / "killed")]
    assert subprocess.run(arguments, check=False).returncode == -9
    assert state_of(tmp_path / "killed")["state"] == "running"
    go(open_folder(tmp_path / "killed", resume=True))
    assert bytes_of(tmp_path / "killed") == bytes_of(tmp_path / "whole")


KILLED_AT_EACH_FLUSH = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
import test_run_folder as t
from pathlib import Path
from cicatrix.files import atomic
force = atomic._force_to_disk
for flushes in range(100):
    count = 0
    def dying(path):
        global count
        count += 1
        if count > flushes:
            os.kill(os.getpid(), signal.SIGKILL)
        force(path)
    child = os.fork()
    if child == 0:
        atomic._force_to_disk = dying
        t.go(t.open_folder(Path(sys.argv[2]) / str(flushes)), last=2)
        os._exit(0)
    if os.waitpid(child, 0)[1] == 0:
        break
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_killed_at_any_flush(tmp_path, request):
    """End the process before the n-th flush, for every n: it is never marked finished too early and resumes to the same bytes."""
    go(open_folder(tmp_path / "whole"), last=2)
    whole = bytes_of(tmp_path / "whole")
    arguments = [sys.executable, "-c", KILLED_AT_EACH_FLUSH, str(request.path.parent), str(tmp_path / "killed")]
    subprocess.run(arguments, check=True)
    folders = sorted((tmp_path / "killed").iterdir(), key=lambda folder: int(folder.name))
    assert 20 < len(folders) < 100
    for folder in folders:
        if (folder / "manifest.json").exists() and state_of(folder)["state"] == "finished":
            assert {name: mark for name, mark in bytes_of(folder).items() if ".partial-" not in name} == whole
        go(open_folder(folder, resume=True), last=2)
        assert bytes_of(folder) == whole
