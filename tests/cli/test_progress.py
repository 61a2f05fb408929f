"""Stages are timed and shown as plain lines or bars."""

import io
import time

import pytest
from rich.console import Console

from cicatrix.cli.progress import BarProgress, PlainProgress
from cicatrix.runs.progress import Progress


def test_stages_add_up():
    progress = Progress()
    for _ in range(2):
        with progress.stage("wait"):
            time.sleep(0.01)
    assert progress.seconds["wait"].wall >= 0.02
    assert progress.seconds["wait"].cpu < progress.seconds["wait"].wall


def test_plain_lines_every_tenth():
    stream = io.StringIO()
    progress = PlainProgress(stream)
    with progress.stage("cycles"):
        for i in range(101):
            progress.update(i / 100)
    lines = stream.getvalue().splitlines()
    assert lines[0] == "cycles ..."
    assert 11 <= len(lines) <= 13
    with pytest.raises(ValueError), progress.stage("broken"):
        raise ValueError
    assert stream.getvalue().splitlines()[-1].startswith("broken: ")


def test_bars_on_a_terminal():
    stream = io.StringIO()
    progress = BarProgress(Console(file=stream, force_terminal=True, width=80))
    with progress.stage("solve"), progress.stage("newton"):
        progress.update(0.5, "load 0.5")
    progress.close()
    assert "newton" in stream.getvalue()
    assert "load 0.5" in stream.getvalue()
