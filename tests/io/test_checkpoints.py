"""Checkpoints are exact, deterministic and never half-written; damage is detected."""

import signal
import subprocess
import sys

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.runs.checkpoints import load_checkpoint, npz_bytes, save_checkpoint

ARRAYS = {"b": np.linspace(0, 1, 7), "a": np.array([[True, False]]), "n": np.array(3)}


def test_round_trip_is_exact(tmp_path):
    save_checkpoint(tmp_path, 3, ARRAYS, {"time_days": 0.1 + 0.2, "name": "x"})
    checkpoint = load_checkpoint(tmp_path)
    assert checkpoint is not None
    assert (checkpoint.cycle, checkpoint.scalars, checkpoint.notes) == (3, {"time_days": 0.1 + 0.2, "name": "x"}, ())
    for name, values in ARRAYS.items():
        np.testing.assert_array_equal(checkpoint.arrays[name], values, strict=True)


def test_bytes_depend_on_content_alone():
    assert npz_bytes(ARRAYS) == npz_bytes(dict(reversed(ARRAYS.items())))


def test_two_are_kept(tmp_path):
    for cycle in range(5):
        save_checkpoint(tmp_path, cycle, ARRAYS)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        f"state-00000{cycle}.{ending}" for cycle in (3, 4) for ending in ("json", "npz")
    ]


def test_no_checkpoint(tmp_path):
    assert load_checkpoint(tmp_path / "none") is None


@pytest.mark.parametrize("ending", ["npz", "json"])
@pytest.mark.parametrize("damage", ["truncated", "flipped", "gone"])
def test_damaged_newest_falls_back(tmp_path, ending, damage):
    for cycle in (1, 2):
        save_checkpoint(tmp_path, cycle, ARRAYS, {"time_days": float(cycle)})
    path = tmp_path / f"state-000002.{ending}"
    content = path.read_bytes()
    middle = len(content) // 2
    if damage == "gone":
        path.unlink()
    else:
        flipped = content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
        path.write_bytes(content[:middle] if damage == "truncated" else flipped)
    checkpoint = load_checkpoint(tmp_path)
    assert checkpoint is not None
    assert checkpoint.cycle == 1
    assert bool(checkpoint.notes) == ((ending, damage) != ("json", "gone"))


def test_all_damaged_is_refused(tmp_path):
    save_checkpoint(tmp_path, 1, ARRAYS)
    (tmp_path / "state-000001.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"no checkpoint can be read .* start without --resume"):
        load_checkpoint(tmp_path)


KILLED = """
import os, signal, sys
from pathlib import Path
import numpy as np
from cicatrix.files import atomic
from cicatrix.runs import checkpoints
folder, after = Path(sys.argv[1]), int(sys.argv[2])
checkpoints.save_checkpoint(folder, 1, {"a": np.arange(10)})
count = 0
force = atomic._force_to_disk
def dying(path):
    global count
    count += 1
    if count > after:
        os.kill(os.getpid(), signal.SIGKILL)
    force(path)
atomic._force_to_disk = dying
checkpoints.save_checkpoint(folder, 2, {"a": np.arange(20)})
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
@pytest.mark.parametrize(("after", "cycle"), [(0, 1), (1, 1), (2, 1), (3, 2), (4, 2)])
def test_kill_while_writing(tmp_path, after, cycle):
    """End the process before the n-th flush (two per file, npz then JSON); renaming the JSON file makes cycle 2 valid."""
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path), str(after)], check=False)
    assert done.returncode == (0 if after == 4 else -signal.SIGKILL)
    checkpoint = load_checkpoint(tmp_path)
    assert checkpoint is not None
    assert (checkpoint.cycle, len(checkpoint.arrays["a"])) == (cycle, 10 * cycle)
    save_checkpoint(tmp_path, 3, ARRAYS)
    assert not list(tmp_path.glob(".partial-*"))
