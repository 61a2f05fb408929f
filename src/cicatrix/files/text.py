"""Text files read as UTF-8, and hashes of files."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..core.errors import InputError


def text_of(path: Path) -> str:
    """Read a text file in UTF-8.

    Raises
    ------
    InputError
        If it is a folder, is not text or cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except IsADirectoryError:
        raise InputError(f"{path} is a folder; a file is needed") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file in UTF-8 (byte {error.start})") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


def sha256_of(path: Path) -> str:
    """Hash a file's bytes; for a folder, hash the sorted hashes of its files, without their names."""
    if path.is_dir():
        digests = sorted(sha256_of(file) for file in path.rglob("*") if file.is_file())
        return hashlib.sha256("\n".join(digests).encode()).hexdigest()
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
