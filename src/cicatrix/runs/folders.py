"""Creating, cleaning, removing and locking the folders of runs."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from ..core.errors import InputError
from ..files.atomic import TEMPORARY

try:
    import fcntl
except ImportError:  # not available on Windows, where two runs into one folder are not detected
    fcntl = None


def holds_something(path: Path) -> bool:
    """Return whether a folder contains anything other than temporary files of interrupted writes."""
    return path.is_dir() and any(not entry.name.startswith(TEMPORARY) for entry in path.iterdir())


def sweep(path: Path) -> None:
    """Remove the temporary files of interrupted writes."""
    for leftover in list(path.rglob(TEMPORARY + "*")):
        remove(leftover)


def make(path: Path) -> None:
    """Create a folder with its parents; raise an InputError if that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path} cannot be created: {error.strerror}") from None


def remove(path: Path) -> None:
    """Remove a file or a whole folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def lock(path: Path) -> int | None:
    """Lock a folder for this process; the operating system unlocks it even if the process is killed."""
    if fcntl is None:
        return None
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise InputError(f"{path} is in use by a run that has not ended") from None
    return handle


def unlock(handle: int | None) -> None:
    """Unlock a folder."""
    if handle is not None:
        os.close(handle)
