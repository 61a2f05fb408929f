"""A disk that is full, files changed by hand, odd manifests: each is a sentence, or costs one checkpoint."""

import contextlib
import errno
import json
import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cicatrix
from cicatrix.cli.main import main
from cicatrix.core.errors import CicatrixError, InputError, StorageError
from cicatrix.files import atomic
from cicatrix.files.history import History
from cicatrix.files.images import write_volume
from cicatrix.geometry.volume import Volume
from cicatrix.runs import folders
from cicatrix.runs.checkpoints import load_checkpoint, save_checkpoint
from cicatrix.runs.kind import Fields
from cicatrix.runs.manifest import read_manifest
from cicatrix.runs.quantity import Quantity
from cicatrix.runs.results import RunFolder

CASE = {"kind": "automaton", "run": {"seed": 1}}
POINTS, TRIANGLES = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([[0, 1, 2]])
LAST = 5


def go(path, stop_after=None, resume=True):
    """Stand in for a computation whose state is one number, with a checkpoint in every cycle and a map in every other."""
    with RunFolder.open(path, CASE, seed=1, resume=resume) as run:
        if run.already_finished:
            return run
        at = run.checkpoint
        x, start = (at.arrays["x"], at.cycle + 1) if at else (np.array([1.0]), 0)
        for cycle in range(start, LAST):
            x = x / 3
            run.record({"cycle": cycle, "x": x[0]})
            if cycle % 2 == 0:
                run.write_fields(Fields("body", cycle // 2, cycle * 0.7, POINTS * x, TRIANGLES))
            run.save_checkpoint(cycle, {"x": x})
            if cycle == stop_after:
                raise KeyboardInterrupt
        run.write_outcome({"x": Quantity(x[0], "mm")})
        run.finish("Done.")
    return run


def stopped(path, after=3):
    with pytest.raises(KeyboardInterrupt):
        go(path, stop_after=after)
    return path


def bytes_of(path):
    files = [file for file in sorted(path.rglob("*")) if file.is_file() and file.name != "manifest.json"]
    return {str(file.relative_to(path)): file.read_bytes() for file in files}


def manifest_of(path):
    return json.loads((path / "manifest.json").read_text())


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "run"
    go(path)
    return bytes_of(path)


def changed(old, new):
    return lambda text: text.replace(old, new, 1)


HISTORIES = {
    "shortened": lambda text: text[: text.rindex("\n3,") + 1],
    "a digit": changed("\n3,", "\n7,"),
    "a row twice": lambda text: text.rstrip("\n") + "\n" + text.splitlines()[-1] + "\n",
    "rows of later cycles": lambda text: text + "4,0.5\n5,0.25\n",
    "half a row": lambda text: text + "4,0.",
}


@pytest.mark.parametrize("change", HISTORIES)
def test_a_history_changed_at_its_end_costs_one_checkpoint_at_most(change, whole, tmp_path):
    history = stopped(tmp_path / "run") / "history.csv"
    history.write_text(HISTORIES[change](history.read_text()))
    go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == whole
    is_behind = change in ("shortened", "a digit")
    notes = " ".join(manifest_of(tmp_path / "run")["notes"])
    assert ("history.csv no longer begins with the 4 rows" in notes) == is_behind
    assert f"Resumed after cycle {2 if is_behind else 3}." in notes


@pytest.mark.parametrize(
    "change", [changed("\n1,", "\n9,"), lambda text: text[:15], lambda text: text.replace("\n", "\r\n"), lambda _: None]
)
def test_a_history_that_no_checkpoint_fits_is_refused(change, tmp_path):
    history = stopped(tmp_path / "run") / "history.csv"
    text = change(history.read_text())
    history.unlink()
    if text is None:
        history.mkdir()
    else:
        history.write_text(text, newline="")
    before = bytes_of(tmp_path / "run")
    with pytest.raises(InputError, match=r"state-000002 was skipped: history\.csv .*; start without --resume"):
        go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == before
    go(tmp_path / "run", resume=False)


def test_a_map_that_is_missing_is_said(whole, tmp_path):
    stopped(tmp_path / "run", after=2)
    (tmp_path / "run" / "fields" / "body-0001.vtu").unlink()
    go(tmp_path / "run")  # written after the checkpoint before
    assert bytes_of(tmp_path / "run") == whole
    (stopped(tmp_path / "other") / "fields" / "body-0000.vtu").unlink()
    with pytest.raises(InputError, match=r"fields/body-0000\.vtu is missing"):
        go(tmp_path / "other")


def test_maps_after_the_checkpoint_are_removed(tmp_path):
    """Maps are numbered apart from cycles, so the number alone does not say whether a map is later."""
    run = stopped(tmp_path / "run")
    (run / "fields" / "body-0002.vtu").write_bytes((run / "fields" / "body-0001.vtu").read_bytes())
    with RunFolder.open(run, CASE, seed=1, resume=True):
        there = sorted(file.name for file in (run / "fields").iterdir())
    assert there == ["body-0000.vtu", "body-0001.vtu", "series.pvd"]


def folder_in_place(path):
    path.unlink()
    path.mkdir()


ODD = {
    "JSON of a number": lambda path: path.with_suffix(".json").write_text("5"),
    "JSON of null": lambda path: path.with_suffix(".json").write_text("null"),
    "JSON nested without end": lambda path: path.with_suffix(".json").write_text("[" * 100_000),
    "null entries": lambda path: path.with_suffix(".json").write_text('{"sha256": null, "cycle": null}'),
    "not text": lambda path: path.with_suffix(".json").write_bytes(b"\xff\xfe\x00"),
    "folder for JSON": lambda path: folder_in_place(path.with_suffix(".json")),
    "folder for arrays": lambda path: folder_in_place(path.with_suffix(".npz")),
    "arrays cut short": lambda path: os.truncate(path.with_suffix(".npz"), 40),
    "no arrays": lambda path: path.with_suffix(".npz").unlink(),
}


@pytest.mark.parametrize("odd", ODD)
def test_an_odd_checkpoint_costs_one_checkpoint(odd, whole, tmp_path):
    ODD[odd](stopped(tmp_path / "run") / "checkpoint" / "state-000003")
    go(tmp_path / "run")
    assert any("state-000003 is damaged" in note for note in manifest_of(tmp_path / "run")["notes"])
    assert bytes_of(tmp_path / "run") == whole


@pytest.mark.parametrize("spoil", [folder_in_place, lambda path: path.write_text("[" * 100_000)])
def test_an_odd_outcome_is_a_sentence(spoil, tmp_path):
    go(tmp_path / "run")
    spoil(tmp_path / "run" / "outcome.json")
    with pytest.raises(InputError, match=r"outcome\.json is damaged"):
        cicatrix.open_run(tmp_path / "run")


def test_a_damaged_series_is_a_sentence(whole, tmp_path):
    (stopped(tmp_path / "run") / "fields" / "series.pvd").write_text("<VTKFile")
    with pytest.raises(InputError, match=r"series\.pvd is damaged"):
        _ = cicatrix.open_run(tmp_path / "run").fields
    go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == whole


def test_a_checkpoint_of_another_form_is_a_sentence(tmp_path):
    case, out = tmp_path / "case.toml", tmp_path / "run"
    case.write_text(FILES)
    cicatrix.simulate(case, out)
    state = load_checkpoint(out / "checkpoint")
    save_checkpoint(out / "checkpoint", state.cycle, {"x": np.ones(2)}, {}, state.files)
    (out / "outcome.json").unlink()
    with pytest.raises(InputError, match=r"checkpoint of cycle \d+ holds no state of this case"):
        cicatrix.simulate(case, out, resume=True)


def test_a_file_in_place_of_the_checkpoints(tmp_path):
    checkpoint = stopped(tmp_path / "run") / "checkpoint"
    checkpoint.rename(tmp_path / "away")
    checkpoint.write_text("")
    with pytest.raises(InputError, match="checkpoint is a file, but must be the folder of checkpoints"):
        go(tmp_path / "run")


def test_without_checkpoints_the_run_begins_anew_and_says_so(whole, tmp_path):
    (stopped(tmp_path / "run") / "checkpoint").rename(tmp_path / "away")
    go(tmp_path / "run")
    assert "Resumed without a checkpoint: the run began anew." in manifest_of(tmp_path / "run")["notes"]
    assert bytes_of(tmp_path / "run") == whole


def put(**entries):
    return lambda manifest: json.dumps(manifest | entries)


MANIFESTS = {
    "5": lambda manifest: "5",
    "null": lambda manifest: "null",
    "[" * 50_000: lambda manifest: "[" * 50_000,
    "seconds": put(seconds=None),
    "seconds.heal": put(seconds={"heal": None}),
    "seconds.heal.wall": put(seconds={"heal": {"wall": "long", "cpu": 1.0}}),
    "9": put(seconds={"heal": {"wall": float("nan"), "cpu": 1.0}}),
    "1e400": lambda manifest: json.dumps(manifest).replace('"seed": 1', '"seed": 1e400'),
    "notes": put(notes=None),
    "libraries": put(libraries=7),
    "inputs.mask": put(inputs={"mask": None}),
    "status.state": put(status={"state": "done", "sentence": ""}),
    "status.sentence": put(status={"state": "finished", "sentence": None}),
    "case": lambda manifest: json.dumps({key: value for key, value in manifest.items() if key != "case"}),
}


@pytest.mark.parametrize("name", MANIFESTS, ids=lambda name: name[:20])
def test_an_odd_manifest_is_a_sentence(name, tmp_path):
    path = stopped(tmp_path / "run") / "manifest.json"
    path.write_text(MANIFESTS[name](manifest_of(tmp_path / "run")))
    for read in (go, cicatrix.open_run):
        with pytest.raises(InputError, match=r"not the manifest of a run") as error:
            read(tmp_path / "run")
        assert name in str(error.value) or not name[0].isalpha() or name == "null"


def test_a_folder_in_place_of_the_manifest(tmp_path):
    folder_in_place(stopped(tmp_path / "run") / "manifest.json")
    with pytest.raises(InputError, match=r"manifest\.json is a folder"):
        go(tmp_path / "run")


def test_a_manifest_without_seconds_goes_on(whole, tmp_path):
    path = stopped(tmp_path / "run") / "manifest.json"
    kept = ("program", "case", "inputs", "status")
    path.write_text(json.dumps({key: value for key, value in manifest_of(tmp_path / "run").items() if key in kept}))
    go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == whole


@pytest.mark.parametrize("spoil", [Path.unlink, folder_in_place, lambda path: path.write_text('{"x": 5}')])
def test_a_finished_run_without_its_outcome_writes_it_again(spoil, whole, tmp_path):
    go(tmp_path / "run")
    spoil(tmp_path / "run" / "outcome.json")
    go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == whole
    assert any(
        "Resumed although finished, as outcome.json is" in note for note in manifest_of(tmp_path / "run")["notes"]
    )


def test_a_finished_run_whose_history_was_changed_is_refused(tmp_path):
    go(tmp_path / "run")
    history = tmp_path / "run" / "history.csv"
    history.write_text(history.read_text().replace("\n1,", "\n2,"))
    with pytest.raises(InputError, match=r"history\.csv no longer begins with the 5 rows"):
        go(tmp_path / "run")


def test_rows_after_the_end_of_a_finished_run_are_removed(whole, tmp_path):
    go(tmp_path / "run")
    with (tmp_path / "run" / "history.csv").open("a") as stream:
        stream.write("5,0.1\n")
    go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == whole


def test_a_finished_run_keeps_one_checkpoint(whole, tmp_path):
    stopped(tmp_path / "run")
    go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == whole
    assert [name for name in whole if name.startswith("checkpoint")] == [
        f"checkpoint/state-00000{LAST - 1}.{ending}" for ending in ("json", "npz")
    ]


def test_cycles_of_seven_digits_are_newer_than_those_of_six(tmp_path):
    for cycle in (999_999, 1_000_000):
        save_checkpoint(tmp_path, cycle, {"x": np.ones(1)})
    checkpoint = load_checkpoint(tmp_path)
    assert checkpoint is not None
    assert checkpoint.cycle == 1_000_000


DISK = {
    errno.ENOSPC: r"the disk is full; free space, then run again with --resume",
    errno.EDQUOT: r"quota of this disk is used up; free space, then run again with --resume",
    errno.EIO: r"the disk reports an error; check it, then run again with --resume",
    errno.EFBIG: r"larger than this system allows",
}


@pytest.mark.parametrize("code", DISK, ids=errno.errorcode.get)
@pytest.mark.parametrize("n", [1, 5, 11, 18, 27])
def test_a_full_disk_is_a_sentence_and_loses_nothing(code, n, whole, tmp_path, monkeypatch):
    """The disk is full from the n-th flush on, then there is room again."""
    force, count = atomic._force_to_disk, 0

    def refusing(path):
        nonlocal count
        count += 1
        if count >= n:
            raise OSError(code, os.strerror(code))
        force(path)

    with monkeypatch.context() as patch:
        patch.setattr(atomic, "_force_to_disk", refusing)
        with pytest.raises(StorageError, match=DISK[code]) as error:
            go(tmp_path / "run")
        assert error.value.exit_code == 3
    manifest = read_manifest(tmp_path / "run")
    assert manifest is None or manifest["status"]["state"] in ("running", "failed")
    go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == whole


@pytest.mark.parametrize(
    ("code", "says"),
    [
        (errno.EROFS, "the disk is read-only"),
        (errno.EACCES, "there is no permission to write there"),
        (errno.ENAMETOOLONG, "the name is too long"),
    ],
    ids=["read-only", "forbidden", "long"],
)
def test_a_place_that_cannot_be_written_is_the_input(code, says, tmp_path, monkeypatch):
    def refusing(path):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(atomic, "_force_to_disk", refusing)
    with pytest.raises(InputError, match=f"manifest.json cannot be written: {says}"):
        go(tmp_path / "run")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("x" * 300, "the name is too long"),
        ("x/" * 3000, "the name is too long"),
        ("a\0b", "NUL"),
        ("file", "is a file"),
        ("file/run", "a file is in the place of one of its folders"),
    ],
    ids=["name", "path", "NUL", "file", "under a file"],
)
def test_names_of_folders_that_cannot_be(name, says, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=says) as error:
        go(tmp_path / name)
    assert len(str(error.value)) < 1000


@pytest.mark.skipif(sys.platform == "win32", reason="no flock")
def test_a_disk_without_locks_and_without_flushes_of_folders(whole, tmp_path, monkeypatch):
    """As some network disks are."""
    sync = os.fsync

    def of_files(handle):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(errno.EINVAL, "Invalid argument")
        sync(handle)

    def unlocked(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(os, "fsync", of_files)
    monkeypatch.setattr(folders.fcntl, "flock", unlocked)
    go(tmp_path / "run")
    assert bytes_of(tmp_path / "run") == whole


FILES = 'kind = "automaton"\n[lattice]\nsize = [96, 96]\n[wound]\nshape = "disc"\nradius_um = 200.0\n'
LIMITED = """
import resource, sys
from cicatrix.cli.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (4000, resource.RLIM_INFINITY))
sys.exit(main(["run", *sys.argv[1:]]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no limits of files")
def test_the_system_stops_a_file(tmp_path, capsys):
    """A real refusal by the operating system, in a run of the command line."""
    case, out = tmp_path / "case.toml", tmp_path / "run"
    case.write_text(FILES)
    command = [sys.executable, "-c", LIMITED, str(case), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    last = done.stderr.splitlines()[-1]
    assert "larger than this system allows" in last
    assert last.endswith("--resume")
    assert manifest_of(out)["status"]["state"] == "failed"
    assert main(["run", str(case), "--out", str(out), "--resume"]) == 0
    assert main(["run", str(case), "--out", str(tmp_path / "whole")]) == 0
    assert bytes_of(out) == bytes_of(tmp_path / "whole")


def test_an_image_that_is_not_written_whole_is_an_error(tmp_path, monkeypatch):
    """ITK says nothing when the disk is full; what it leaves ends too early."""
    sitk = pytest.importorskip("SimpleITK")
    write = sitk.WriteImage

    def short(image, path, **more):
        write(image, path, **more)
        os.truncate(path, os.path.getsize(path) // 2)  # noqa: PTH202 - a text

    volume = Volume(np.arange(60, dtype=np.int16).reshape(3, 4, 5), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    with RunFolder.open(tmp_path / "run", CASE, seed=1) as run, monkeypatch.context() as patch:
        run.save_volume("labels", volume)
        write_volume(tmp_path / "whole.nii.gz", volume)
        patch.setattr(sitk, "WriteImage", short)
        with pytest.raises(StorageError, match=r"picture\.nii\.gz cannot be written"):
            run.save_volume("picture", volume)
    assert (tmp_path / "run" / "labels.nii.gz").read_bytes() == (tmp_path / "whole.nii.gz").read_bytes()
    assert not (tmp_path / "run" / "picture.nii.gz").exists()


def test_the_disk_that_is_full_at_the_end_of_a_verb_is_a_sentence(tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device", "report/index.html")

    monkeypatch.setattr("cicatrix.cli.check.run", full)
    assert main(["check", str(tmp_path / "case.toml")]) == 3
    assert capsys.readouterr().err == "cicatrix: report/index.html cannot be written: the disk is full; free space\n"


def test_threads_are_recorded_and_a_change_is_noted(tmp_path, monkeypatch):
    monkeypatch.setenv("MKL_NUM_THREADS", "3")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.delenv("CICATRIX_THREADS", raising=False)
    stopped(tmp_path / "run")
    threads = manifest_of(tmp_path / "run")["threads"]
    assert (threads["CICATRIX_THREADS"], threads["MKL_NUM_THREADS"], threads["OMP_NUM_THREADS"]) == ("1", "3", "1")
    monkeypatch.setenv("CICATRIX_THREADS", "2")
    go(tmp_path / "run")
    manifest = manifest_of(tmp_path / "run")
    assert manifest["threads"]["MKL_NUM_THREADS"] == "2"
    assert "Resumed with CICATRIX_THREADS = 2, after 1; bytes may differ." in manifest["notes"]
    assert "Resumed with MKL_NUM_THREADS = 2, after 3; bytes may differ." in manifest["notes"]
    assert not [note for note in manifest["notes"] if "OMP_NUM_THREADS" in note]


@pytest.mark.parametrize(
    ("given", "used"),
    [({}, "1"), ({"MKL_NUM_THREADS": "3"}, "3"), ({"MKL_NUM_THREADS": "3", "CICATRIX_THREADS": "2"}, "2")],
)
def test_our_number_of_threads_is_that_of_mkl(given, used):
    names = ("MKL_NUM_THREADS", "CICATRIX_THREADS")
    clean = {name: value for name, value in os.environ.items() if name not in names}
    code = "import os, cicatrix.numerics.factors; print(os.environ['MKL_NUM_THREADS'])"
    done = subprocess.run([sys.executable, "-c", code], env=clean | given, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == used


def test_a_history_goes_on_from_its_mark_alone(tmp_path):
    history = History(tmp_path / "h.csv")
    history.record({"step": 1, "x": 0.1})
    mark = history.mark()
    history.record({"step": 2, "x": 0.2})
    history.close()
    again = History.continued(tmp_path / "h.csv", mark)
    again.cut()
    again.record({"step": 2, "x": 0.2})
    assert again.mark() == history.mark()
    with pytest.raises(ValueError, match="must have the columns"):
        again.record({"step": 3})
    again.close()
    with pytest.raises(ValueError, match="the first 1 rows"):
        History.continued(tmp_path / "h.csv", mark._replace(sha256="0"))


def test_errors_of_the_disk_are_errors_of_the_program():
    assert issubclass(StorageError, CicatrixError)


def damaged(content, rng):
    """Return bytes with a fault: flipped, cut, filled, emptied, doubled, or a JSON value replaced."""
    at = int(rng.integers(len(content)))
    odd = [b"null", b"5", b"[]", b"{}", b'"x"', b"NaN", b"-1", b"1e400", b"\xff\xfe", b"\0" * 9][rng.integers(10)]
    values = [match.span() for match in re.finditer(rb"(?<=: )[^\n]+?(?=,?\n)", content)] or [(at, at + 1)]
    start, end = values[rng.integers(len(values))]
    return [
        content[:at] + bytes([content[at] ^ 1 << rng.integers(8)]) + content[at + 1 :],
        content[:at],
        content[:at] + odd + content[at:],
        odd,
        b"",
        content + content[at:],
        content[:start] + odd + content[end:],
    ][rng.integers(7)]


@pytest.mark.parametrize("after", [3, None], ids=["stopped", "finished"])
@pytest.mark.parametrize(
    "name",
    ["manifest.json", "history.csv", "outcome.json", "checkpoint/state-000003.json", "checkpoint/state-000003.npz"],
)
def test_damage_at_random_is_a_sentence_or_mended(name, after, whole, tmp_path):
    rng, kept = np.random.default_rng(list(name.encode())), tmp_path / "kept"
    go(kept) if after is None else stopped(kept, after)
    n_mended = 0
    for n in range(20):
        run = shutil.copytree(kept, tmp_path / f"run-{n}")
        content = (kept / name).read_bytes() if (kept / name).is_file() else b"{}\n"
        (run / name).write_bytes(damaged(content, rng))
        with contextlib.suppress(InputError):
            go(run)
            left = bytes_of(run)
            assert {file: left[file] for file in whole} == whole
            n_mended += 1
    may_all_be_refused = name == "manifest.json" or (name, after) == (
        "history.csv",
        None,
    )  # no copy, no checkpoint before
    assert n_mended or may_all_be_refused
