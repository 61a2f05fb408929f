"""Creating, cleaning, removing and locking the folders of runs."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

from ..core.errors import InputError
from ..files.atomic import TEMPORARY, writing, writing_error

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


def is_new(path: Path) -> bool:
    """Return whether there is no such folder yet.

    Raises
    ------
    InputError
        If a file is in its place, or it is no name of a folder.
    """
    shown = str(path)
    if "\0" in shown:
        raise InputError(f"{shown!r} cannot be created: a name cannot hold a NUL character")
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return True
    except OSError as error:
        raise writing_error(_short(path), error) from None
    if not stat.S_ISDIR(mode):
        raise InputError(f"{path} is a file; --out must name a folder")
    return False


def make(path: Path) -> None:
    """Create a folder with its parents; raise an InputError if that fails."""
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)


def remove(path: Path) -> None:
    """Remove a file or a whole folder, if it exists."""
    with writing(path):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def lock(path: Path) -> int | None:
    """Lock a folder for this process; the operating system unlocks it even if the process is killed.

    Where the disk has no locks, as some network disks, the folder is not locked.
    """
    if fcntl is None:
        return None
    with writing(path):
        handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise InputError(f"{path} is in use by a run that has not ended") from None
    except OSError:
        os.close(handle)
        return None
    return handle


def unlock(handle: int | None) -> None:
    """Unlock a folder."""
    if handle is not None:
        os.close(handle)


def _short(path: Path) -> str:
    shown = str(path)
    return shown if len(shown) < 200 else f"{shown[:60]}..."
