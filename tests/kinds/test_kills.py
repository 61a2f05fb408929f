"""A run that is killed at any moment, several times in a row, goes on to the bytes of a run that was never disturbed.

Moments are drawn at random, from the start of the run to its end; every fourth kill is at a flush while a checkpoint is written. The
table of all kinds is printed at the end (``pytest -m slow -s tests/kinds/test_kills.py``).
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_every_kind import CASES, products, write_inputs

N_KILLS = 20
KINDS = [name for name in CASES if " " not in name]
WORKER = Path(__file__).with_name("kill_worker.py")
TABLE = []


class Killer:
    """Runs of one case in processes that are killed."""

    def __init__(self, case, settings):
        self.case, self.settings = case, settings
        self.process = subprocess.Popen(
            [sys.executable, str(WORKER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def run(self, out, interval_s, kill_after_s=None, flush=0):
        asked = {"case": str(self.case), "out": str(out), "settings": self.settings, "interval_s": interval_s}
        self.process.stdin.write(json.dumps(asked | {"kill_after_s": kill_after_s, "flush": flush}) + "\n")
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
    head = ("kind", "kills", "while a checkpoint was written", "runs", "resumed", "equal")
    print("\n" + "\n".join("| " + " | ".join(map(str, row)) + " |" for row in [head, *TABLE]))


def manifest_of(folder):
    path = folder / "manifest.json"
    return json.loads(path.read_text()) if path.exists() else {"status": {"state": "absent"}, "notes": []}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
@pytest.mark.parametrize("name", KINDS)
def test_killed_at_random_moments(name, killer_of, tmp_path):
    killer, rng = killer_of(name), np.random.default_rng(list(name.encode()))
    killer.run(tmp_path / "first", 10.0)  # which compiles
    whole = killer.run(tmp_path / "whole", 10.0)
    assert whole["status"] == 0
    expected, seconds = products(tmp_path / "whole"), whole["seconds"]
    kills = flushed = runs = resumed = equal = 0
    while kills < N_KILLS:
        out, interval = tmp_path / f"run-{runs}", float(rng.choice([0.0, 0.1])) * seconds
        for _ in range(int(rng.integers(1, 4))):  # kills in a row
            at_flush = kills % 4 == 3
            moment = {"flush": int(rng.integers(1, 9))} if at_flush else {"kill_after_s": rng.uniform(0.0, seconds)}
            if killer.run(out, interval, **moment)["status"] != -9:
                break
            kills, flushed = kills + 1, flushed + at_flush
            if manifest_of(out)["status"]["state"] == "finished":  # killed after the last byte was written
                assert products(out) == expected
        assert killer.run(out, interval)["status"] == 0
        runs += 1
        resumed += any(note.startswith("Resumed after") for note in manifest_of(out)["notes"])
        equal += products(out) == expected
    TABLE.append((name, kills, flushed, runs, resumed, equal))
    assert equal == runs
    assert resumed > runs // 4
