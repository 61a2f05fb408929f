"""Folders that a run makes, removes and holds while it works."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from ..core.errors import InputError
from ..files.atomic import TEMPORARY

try:
    import fcntl
except ImportError:  # not on Windows, where two runs into one folder are not noticed
    fcntl = None


def holds_something(path: Path) -> bool:
    """Tell whether a folder holds anything but what a killed write left behind."""
    return path.is_dir() and any(not entry.name.startswith(TEMPORARY) for entry in path.iterdir())


def sweep(path: Path) -> None:
    """Remove what killed writes left behind."""
    for leftover in list(path.rglob(TEMPORARY + "*")):
        remove(leftover)


def make(path: Path) -> None:
    """Make a folder with its parents; an InputError if that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path} cannot be made: {error.strerror}") from None


def remove(path: Path) -> None:
    """Remove a file or a whole folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def lock(path: Path) -> int | None:
    """Hold the folder for this process; the system lets go of it even when the process is killed."""
    if fcntl is None:
        return None
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise InputError(f"{path} is in use by a run that is still going on") from None
    return handle


def unlock(handle: int | None) -> None:
    """Let go of a folder."""
    if handle is not None:
        os.close(handle)
