"""Atomic writing of files: each is written under a temporary name, forced to disk, then renamed.

What the operating system refuses is told in a sentence: that of a name or a folder is an error in the input, that of the disk is
a :class:`StorageError`.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ..core.errors import CicatrixError, InputError, StorageError

DISK_AT_FAULT = {
    getattr(errno, "EDQUOT", errno.ENOSPC): "your quota of this disk is used up; free space",  # Windows has none
    errno.ENOSPC: "the disk is full; free space",
    errno.EFBIG: "the file would be larger than this system allows; raise the limit (ulimit -f)",
    errno.EIO: "the disk reports an error; check it",
}
PLACE_AT_FAULT = {
    errno.EROFS: "the disk is read-only; name a folder on another one",
    errno.EACCES: "there is no permission to write there; name another folder",
    errno.EPERM: "there is no permission to write there; name another folder",
    errno.ENAMETOOLONG: "the name is too long; give a shorter one",
    errno.ENOENT: "its folder does not exist or was removed; name another one",
    errno.ENOTDIR: "a file is in the place of one of its folders; move that file, or name another folder",
    errno.EEXIST: "a file is in the place of one of its folders; move that file, or name another folder",
    errno.EISDIR: "a folder is in its place; move that folder, or name another one",
    errno.EINVAL: "the name is not one that this disk can hold; give another one",
}
UNSYNCED_FOLDERS = (errno.EINVAL, errno.ENOTSUP, errno.EBADF)  # of network disks that flush files alone
TEMPORARY = ".partial-"  # a prefix, so that the suffix is still that of the format


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; on success that file replaces ``path`` in one step.

    If the block raises, the temporary file is removed and ``path`` is unchanged. If the machine crashes, a file whose name starts
    with ``.partial-`` may remain, which no reader uses.

    Raises
    ------
    InputError, StorageError
        As :func:`writing`.
    """
    temporary = path.with_name(TEMPORARY + path.name)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            _force_to_disk(temporary)
            temporary.replace(path)
        except BaseException:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        _force_to_disk(path.parent)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tell in a sentence why the operating system refuses to write ``path``.

    Raises
    ------
    InputError
        If the name or the folder is at fault.
    StorageError
        If the disk is full or reports an error.
    """
    try:
        yield
    except OSError as error:
        raise writing_error(path, error) from error


def writing_error(path: Path | str, error: OSError) -> CicatrixError:
    """Return the error that says why a file or folder could not be written, and what to do."""
    code = error.errno or 0
    if code in PLACE_AT_FAULT:
        return InputError(f"{path} cannot be written: {PLACE_AT_FAULT[code]}")
    reason = DISK_AT_FAULT.get(code, f"{error.strerror or error}; check the disk")
    return StorageError(f"{path} cannot be written: {reason}")


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_json(path: Path, content: Any) -> None:
    """Write JSON that every program can read: UTF-8, indented by two spaces, without NaN."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
    write_bytes(path, (text + "\n").encode())


def _force_to_disk(path: Path) -> None:
    if path.is_dir() and os.name == "nt":  # Windows cannot open folders
        return
    handle = os.open(path, os.O_RDWR if path.is_file() else os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if path.is_file() or error.errno not in UNSYNCED_FOLDERS:
            raise
    finally:
        os.close(handle)
