"""The one way to open a file that a user names: a regular file, of a size that fits in memory."""

from __future__ import annotations

import stat
from pathlib import Path

from ..core.errors import InputError

LARGEST_NAME = 4096  # bytes of a path that Linux opens


def file_or_folder(path: Path) -> Path:
    """Return the path of a file that can be read from its beginning to its end, or of a folder.

    Raises
    ------
    InputError
        If there is no such file; if it is a device, a pipe or a socket, which may never end; or if it is refused.
    """
    shown = str(path)
    if "\0" in shown:
        raise InputError(f"{shown!r}: a path cannot hold a NUL character; name a file")
    if len(shown.encode(errors="replace")) > LARGEST_NAME:
        raise InputError(f"{shown[:60]}...: the path has {len(shown)} characters; at most {LARGEST_NAME} can be opened")
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise InputError(f"{path} is a device, a pipe or a socket; a file is needed")
    return path


def regular_file(path: Path) -> Path:
    """Return the path of a file that can be read from its beginning to its end.

    Raises
    ------
    InputError
        As :func:`file_or_folder`, or if it is a folder.
    """
    if file_or_folder(path).is_dir():
        raise InputError(f"{path} is a folder; a file is needed")
    return path


def bytes_of(path: Path, largest: int | None = None) -> bytes:
    """Return a file's bytes.

    Parameters
    ----------
    path : Path
        A regular file.
    largest : int, optional
        Most bytes that such a file can hold [B]; a larger one is refused before it is read.

    Raises
    ------
    InputError
        As :func:`regular_file`, or if the file is larger than ``largest``, or the system stops reading it.
    """
    size = regular_file(path).stat().st_size
    if largest is not None and size > largest:
        raise InputError(f"{path} has {size / 1e6:.0f} MB; such a file has at most {largest / 1e6:g} MB")
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
