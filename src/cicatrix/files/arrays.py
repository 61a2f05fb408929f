"""Reading of NumPy files (.npy), such as masks of a lattice."""

from __future__ import annotations

import io
from pathlib import Path
from tokenize import TokenError

import numpy as np

from ..core.errors import InputError
from .opening import bytes_of

MAGIC, ZIP = b"\x93NUMPY", b"PK"
HEADERS = {1: np.lib.format.read_array_header_1_0, 2: np.lib.format.read_array_header_2_0}
HEADERS[3] = HEADERS[2]  # the same form, in UTF-8, which only names of fields need


def read_array(path: Path, key: str) -> np.ndarray:
    """Read one array from a .npy file; objects are refused, because reading them can run any code.

    Parameters
    ----------
    path : Path
        The file.
    key : str
        Key of the case that names it, for messages.

    Raises
    ------
    InputError
        If the file is not a regular one, is an archive (.npz) or another format, holds objects, or is cut short.
    """
    try:
        content = bytes_of(path)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None
    if content.startswith(ZIP):
        raise InputError(f"{key}: {path.name} is an archive of arrays (.npz); save the one array with numpy.save")
    if not content.startswith(MAGIC):
        raise InputError(f"{key}: {path.name} is not a NumPy file (.npy); save the array with numpy.save")
    shape, in_columns, kind, start = _header(content, path, key)
    if kind.hasobject or kind.names:
        raise InputError(
            f"{key}: {path.name} holds objects or named fields; save an array of numbers or of true and false"
        )
    n, found = int(np.prod(shape, dtype=object)), len(content) - start
    if n * kind.itemsize != found:
        raise InputError(
            f"{key}: {path.name} is cut short or damaged: its header asks for {n * kind.itemsize} bytes and {found} follow"
        )
    values = np.frombuffer(content, kind, n, start).reshape(shape, order="F" if in_columns else "C")
    return values.astype(kind.newbyteorder("="), order="C")


def _header(content: bytes, path: Path, key: str) -> tuple[tuple[int, ...], bool, np.dtype, int]:
    """Return shape, whether columns come first, type, and where the values begin."""
    stream = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(stream)[0]
        shape, in_columns, kind = HEADERS[version](stream)
    except (ValueError, KeyError, TypeError, SyntaxError, EOFError, RecursionError, MemoryError, TokenError):
        raise InputError(f"{key}: {path.name} has a damaged header; save the array again with numpy.save") from None
    return shape, in_columns, kind, stream.tell()
