"""A run that is ended at any moment, several times in a row, goes on to the bytes of a run that was never disturbed.

Moments are drawn at random, from the start of the run to its end; every fourth kill is at a flush while a checkpoint is
written. The table of all kinds is printed at the end (``pytest -m slow -s tests/kinds/test_kills.py``).
"""

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_every_kind import CASES, products, write_inputs

N_KILLS = 20  # of each kind, while its folder was there
N_STOPS = 8
KINDS = [name for name in CASES if " " not in name]
WORKER = Path(__file__).with_name("kill_worker.py")
TABLE = []

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")]


class Killer:
    """Runs of one case in processes that are ended by signals."""

    def __init__(self, case, settings):
        self.case, self.settings = case, settings
        self.process = subprocess.Popen(
            [sys.executable, str(WORKER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def run(self, out, interval_s=10.0, after_s=None, flush=0, number=signal.SIGKILL):
        asked = {"case": str(self.case), "out": str(out), "settings": self.settings, "interval_s": interval_s}
        asked |= {"after_s": after_s, "flush": flush, "signal": int(number)}
        self.process.stdin.write(json.dumps(asked) + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def close(self):
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()


@pytest.fixture
def killer_of(tmp_path):
    started = []

    def start(name):
        write_inputs(tmp_path)
        given, settings = CASES[name][0], []
        if isinstance(given, tuple):
            path, settings = given
        else:
            path = tmp_path / "case.toml"
            path.write_text(given)
        started.append(Killer(path, settings))
        return started[-1]

    yield start
    for killer in started:
        killer.close()


@pytest.fixture(scope="module", autouse=True)
def table():
    yield
    head = ("kind", "kills", "while a checkpoint was written", "runs", "went on from a checkpoint", "equal")
    print("\n" + "\n".join("| " + " | ".join(map(str, row)) + " |" for row in [head, *TABLE]))


def manifest_of(folder):
    path = folder / "manifest.json"
    return json.loads(path.read_text()) if path.exists() else None


def undisturbed(killer, folder):
    """Bytes, notes and seconds of a run to its end, after another one that compiles."""
    killer.run(folder / "first")
    whole = killer.run(folder / "whole")
    assert whole["status"] == 0
    return products(folder / "whole"), manifest_of(folder / "whole")["notes"], whole["seconds"]


@pytest.mark.parametrize("name", KINDS)
def test_killed_at_random_moments(name, killer_of, tmp_path):
    killer, rng = killer_of(name), np.random.default_rng(list(name.encode()))
    expected, _, seconds = undisturbed(killer, tmp_path)
    kills = flushed = runs = resumed = equal = 0
    while kills < N_KILLS:
        out, interval = tmp_path / f"run-{runs}", float(rng.choice([0.0, 0.1])) * seconds
        for _ in range(int(rng.integers(1, 4))):  # kills in a row
            at_flush = kills % 4 == 3
            moment = {"flush": int(rng.integers(1, 9))} if at_flush else {"after_s": rng.uniform(0.0, seconds)}
            if killer.run(out, interval, **moment)["status"] != -signal.SIGKILL:
                break
            manifest = manifest_of(out)
            kills, flushed = kills + bool(manifest), flushed + at_flush
            if manifest and manifest["status"]["state"] == "finished":  # killed after the last byte was written
                assert products(out) == expected
        assert killer.run(out, interval)["status"] == 0
        runs += 1
        resumed += any(note.startswith("Resumed after") for note in manifest_of(out)["notes"])
        equal += products(out) == expected
    TABLE.append((name, kills, flushed, runs, resumed, equal))
    assert equal == runs
    assert resumed > runs // 4


@pytest.mark.parametrize("name", ["automaton", "wound", "lumpectomy"])
def test_stopped_by_a_real_signal(name, killer_of, tmp_path):
    """Ctrl-C and SIGTERM at random moments lose nothing, and no sentence stands twice in the notes."""
    killer, rng = killer_of(name), np.random.default_rng(list(name.encode()))
    expected, notes, seconds = undisturbed(killer, tmp_path)
    for n in range(N_STOPS):
        out, number = tmp_path / f"run-{n}", (signal.SIGINT, signal.SIGTERM)[n % 2]
        for _ in range(2):
            status = killer.run(out, 0.1 * seconds, after_s=rng.uniform(0.15, 0.9) * seconds, number=number)["status"]
            manifest = manifest_of(out)
            assert (status, manifest["status"]["state"]) in [(130, "interrupted"), (0, "finished")], (status, manifest)
        assert killer.run(out)["status"] == 0
        assert products(out) == expected
        assert [note for note in manifest_of(out)["notes"] if not note.startswith("Resumed")] == notes
