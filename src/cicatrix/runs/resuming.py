"""Whether a run can go on: what its folder must hold at a checkpoint, and why a folder is refused."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..files.history import History, HistoryMark
from ..files.vtu import TimeStepFile
from .checkpoints import Checkpoint, load_checkpoint
from .folders import holds_something
from .manifest import differences, read_manifest
from .quantity import Quantity

SERIES_FOLDERS = ("fields", "shapes")
HISTORY, SERIES = "history", "series"  # of the files that a checkpoint knows


def content_of(mark: HistoryMark, step_files: Mapping[str, Sequence[TimeStepFile]]) -> dict[str, Any]:
    """Return what a checkpoint keeps of a run's files: how far the history is written, and the VTU files of each series."""
    return {
        HISTORY: list(mark),
        SERIES: {name: [astuple(file) for file in files] for name, files in step_files.items()},
    }


def history_of(checkpoint: Checkpoint) -> HistoryMark:
    """Return how far the history was written at a checkpoint."""
    return HistoryMark(*checkpoint.files[HISTORY])


def step_files_of(checkpoint: Checkpoint, name: str) -> list[TimeStepFile]:
    """Return the VTU files that a series had at a checkpoint."""
    return [TimeStepFile(*file) for file in checkpoint.files[SERIES].get(name, ())]


def doubt_of(path: Path, checkpoint: Checkpoint) -> str:
    """Return why a checkpoint does not fit the history and the fields in a run's folder; empty if it does."""
    if HISTORY not in checkpoint.files:
        return "it does not know the files of the run"
    mark = history_of(checkpoint)
    try:
        History.continued(path / "history.csv", mark)
    except (OSError, ValueError):
        return f"history.csv no longer begins with the {mark.rows} rows that were written before it"
    for name in SERIES_FOLDERS:
        for step_file in step_files_of(checkpoint, name):
            if not (path / name / step_file.name).is_file():
                return f"{name}/{step_file.name} is missing"
    return ""


def flaw_of(path: Path) -> str:
    """Return what is wrong with the files of a run that its manifest calls finished; empty if nothing is."""
    try:
        if not read_outcome(path / "outcome.json"):
            return "outcome.json is missing"
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return "outcome.json is damaged"
    try:
        newest = load_checkpoint(path / "checkpoint")
    except InputError:  # nothing is left to compare with
        return ""
    if newest is None:
        return ""
    doubt, history = doubt_of(path, newest), path / "history.csv"
    if not doubt and history.is_file() and history.stat().st_size > history_of(newest).size:
        return "history.csv has rows that were not written"
    return doubt


def read_outcome(path: Path) -> dict[str, Quantity]:
    """Read outcome.json; empty if there is none."""
    table = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return {name: Quantity(**asked) for name, asked in table.items()}


def earlier_manifest(path: Path) -> dict[str, Any] | None:
    """Return the manifest of the run that a folder holds; None if the folder is empty.

    Raises
    ------
    InputError
        If the folder holds something else.
    """
    manifest = read_manifest(path)
    if manifest is None and holds_something(path):
        raise InputError(f"{path} is not empty and holds no run; give another --out")
    return manifest


def refuse_other(path: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Raise an InputError if a new manifest is that of another run, whose state the old run's folder cannot hold."""
    differing = differences(old, new)
    if differing:
        raise InputError(f"{path} holds another run, so it cannot be resumed: {', '.join(differing)} differ")
