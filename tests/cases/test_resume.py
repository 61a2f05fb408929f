"""Check that a run that is killed and resumed gives the same bytes as an uninterrupted one."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from coarse_lumpectomy import STIFF_TISSUE

CASE = f"""
kind = "lumpectomy"
dimension = 2
[image]
phantom = "half-ellipsoid"
voxel_mm = 3.0
[healing]
pitch_um = 150.0
[mesh]
edge_mm = 6.0
cavity_edge_mm = 2.0
[outcome]
positions = ["upright", "supine"]
visits_weeks = [2, 6]
[coupling]
days_per_cycle = 10.0
{STIFF_TISSUE}
"""


def command(case: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "cicatrix", "run", str(case), "--out", str(out), *more]


def products(out: Path) -> dict[str, bytes]:
    files = [out / "history.csv", out / "outcome.json", out / "labels.nii.gz", *sorted((out / "fields").iterdir())]
    return {f.name: f.read_bytes() for f in files}


@pytest.mark.slow
def test_killed_and_resumed_is_uninterrupted(tmp_path):
    case = tmp_path / "case.toml"
    case.write_text(CASE)
    subprocess.run(command(case, tmp_path / "whole"), check=True, capture_output=True)
    process = subprocess.Popen(command(case, tmp_path / "cut"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    history = tmp_path / "cut" / "history.csv"
    while not (history.exists() and history.read_text().count("\n") >= 4):
        assert process.poll() is None
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "cut" / "outcome.json").exists()
    subprocess.run(command(case, tmp_path / "cut", "--resume"), check=True, capture_output=True)
    assert products(tmp_path / "cut") == products(tmp_path / "whole")
