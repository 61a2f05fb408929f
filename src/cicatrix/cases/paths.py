"""Paths of inputs, relative to the case file or in the folder of shared image data."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from ..core.errors import InputError
from ..files.opening import file_or_folder

DATA_PREFIX = "data:"
DATA_VARIABLE = "CICATRIX_DATA"
BACKSLASH = "in \"...\" a backslash starts an escape: write '...', or / in a path"


def input_path(text: str, folder: Path) -> Path:
    """Return the absolute path of an input that a case file in ``folder`` names.

    Parameters
    ----------
    text : str
        A path relative to ``folder``, an absolute path, or ``data:NAME`` in the shared data.
    folder : Path
        Folder of the case file.

    Raises
    ------
    InputError
        If there is no such file or folder, or it is a device or a pipe; the caller puts the key before the message.
    """
    if not text.removeprefix(DATA_PREFIX).strip():
        raise InputError("must name a file or folder; got an empty text")
    if found := re.search(r"[\x00-\x1f\x7f]", text):
        raise InputError(f"names {text!r}, with the control character U+{ord(found[0]):04X}; {BACKSLASH}")
    path = _named(text, folder)
    if not _may_exist(path):
        hint = "; folders are separated by /" if "\\" in text and os.sep == "/" else ""
        raise InputError(f"names {path}, but there is no such file or folder{hint}")
    try:
        return file_or_folder(path).resolve()
    except InputError as error:
        raise InputError(f"cannot be used: {error}") from None


def _named(text: str, folder: Path) -> Path:
    """Return the path that a text names, with ~ replaced by the folder of the user."""
    if text.startswith(DATA_PREFIX):
        return data_folder(folder) / text.removeprefix(DATA_PREFIX)
    try:
        return folder / Path(text).expanduser()
    except RuntimeError:
        raise InputError(f"names {text}, but there is no such user: name the folder in place of ~") from None


def _may_exist(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # such as a name that is too long; why is told when it is opened
        return True


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False


def data_folder(start: Path | None = None) -> Path:
    """Return the folder of shared image data: ``CICATRIX_DATA``, or ``../shared/data`` beside a project's root.

    Parameters
    ----------
    start : Path, optional
        The project's root is searched upwards from here, then from the working directory, then from this module.

    Raises
    ------
    InputError
        If there is no such folder; the caller puts the subject before the message.
    """
    named = os.environ.get(DATA_VARIABLE)
    if named:
        if not _is_folder(Path(named)):
            raise InputError(f"needs the image data, but {DATA_VARIABLE} names {named}, which is not a folder")
        return Path(named).resolve()
    for root in _project_roots([start or Path(), Path(), Path(__file__).parent]):
        if (root.parent / "shared" / "data").is_dir():
            return root.parent / "shared" / "data"
    raise InputError(f"needs the image data: set {DATA_VARIABLE} to its folder, or put it in ../shared/data")


def _project_roots(starts: list[Path]) -> Iterator[Path]:
    for start in starts:
        here = start.resolve()
        yield from (folder for folder in (here, *here.parents) if (folder / "pyproject.toml").is_file())
