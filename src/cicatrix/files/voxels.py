"""Voxels decoded from bytes, as formats with a text header store them: raw, packed or written as text, here or in other files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from .numerals import without_underscore
from .streams import MOST_LINES, Source, opened


def decoded(
    source: Source, encoding: str, kind: np.dtype, shape: tuple[int, ...], skip: int = 0, skip_lines: int = 0
) -> np.ndarray:
    """Read the voxels (nz, ny, nx) up to the end of their file.

    Parameters
    ----------
    source : Source
        Stands where the voxels begin.
    encoding : str
        raw, gzip, zlib, bzip2, text or hex.
    kind : dtype
        Type and order of bytes in which they are stored; they are returned in this machine's.
    skip, skip_lines : int
        Bytes, counted once unpacked, and before them lines to leave out; -1 bytes: the voxels are the last ones.

    Raises
    ------
    InputError
        If they are cut short, damaged, more than the header says or beyond their type.
    """
    if not 0 <= skip_lines <= MOST_LINES:
        raise InputError(f"the header asks to leave out {skip_lines:,} lines; it must be 0 to {MOST_LINES:,}")
    for _ in range(skip_lines):
        source.line()
    source = source.unpacked(encoding)
    n_bytes = int(np.prod(shape)) * kind.itemsize
    if encoding == "text":
        return _from_text(source, kind, shape)
    if encoding == "hex":
        data = _from_hex(source, n_bytes)
    elif skip < 0:
        data = source.last(n_bytes)
    else:
        source.skip(skip)
        data = source.read(n_bytes)
        source.finish()
    return np.frombuffer(data, kind).reshape(shape).astype(kind.newbyteorder("="), copy=False)


def numbers_in(words: Iterable[str]) -> list[float]:
    """Return the numbers that words of a file write (ValueError if a word is none)."""
    return [float(without_underscore(word)) for word in words]


def from_files(
    folder: Path,
    names: Sequence[str],
    encoding: str,
    kind: np.dtype,
    shape: tuple[int, ...],
    skip: int = 0,
    skip_lines: int = 0,
) -> np.ndarray:
    """Read voxels (nz, ny, nx) that lie in one or several files, each with as many slices.

    Raises
    ------
    InputError
        As :func:`decoded`, or if a file is missing or the slices cannot be shared out.
    """
    if missing := [name for name in names if not _is_there(folder / name)]:
        raise InputError(
            f"{len(missing)} of the {len(names)} files that hold the voxels, as the header says, are missing"
        )
    if not names or shape[0] % len(names):
        raise InputError(f"the header names {len(names)} files for {shape[0]} slices; convert the image again")
    parts = []
    for name in names:
        with opened(folder / name, as_is=True) as source:
            parts.append(decoded(source, encoding, kind, (shape[0] // len(names), *shape[1:]), skip, skip_lines))
    return np.concatenate(parts) if len(parts) > 1 else parts[0]


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # a name too long, or with a NUL character
        return False


def numbered(pattern: str, words: Sequence[str]) -> list[str]:
    """Return names such as slice%03d.raw with the numbers from the first to the last, in steps.

    Raises
    ------
    InputError
        If the pattern takes no number, or the numbers are not whole or a step is 0.
    """
    try:
        first, last, step = (int(word) for word in words)
        numbers = range(first, last + (1 if step > 0 else -1), step)
        return [pattern % number for number in numbers[:100_000]]
    except (ValueError, TypeError):
        raise InputError(
            f'the header names files by "{pattern[:60]}" without first, last and step; convert again'
        ) from None


def _from_text(source: Source, kind: np.dtype, shape: tuple[int, ...]) -> np.ndarray:
    """Return voxels written as numbers; each must fit in its type."""
    n = int(np.prod(shape))
    words = source.rest(32 * n + 4096).decode("ascii", "replace").split()
    try:
        numbers = np.array(numbers_in(words))
    except ValueError:
        raise InputError("a voxel is not a number; convert the image again") from None
    if len(numbers) != n:
        raise InputError(f"the file has {len(numbers)} voxels, but its header says {n}; copy it again from its source")
    limits = np.iinfo(kind) if kind.kind in "iu" else None
    if limits and not ((numbers >= limits.min) & (numbers <= limits.max) & (numbers == np.rint(numbers))).all():
        raise InputError(
            f"a voxel is no whole number from {limits.min} to {limits.max}, as its type in the header demands; "
            "convert the image again"
        )
    with np.errstate(over="ignore"):  # what becomes infinite is refused when the whole image is checked
        return numbers.astype(kind.newbyteorder("=")).reshape(shape)


def _from_hex(source: Source, n_bytes: int) -> bytearray:
    try:
        data = bytearray.fromhex(source.rest(3 * n_bytes + 4096).decode("ascii"))
    except ValueError:
        raise InputError("the voxels are not hexadecimal digits; convert the image again") from None
    if len(data) != n_bytes:
        raise InputError(f"the file has {len(data)} bytes of voxels, but its header says {n_bytes}; copy it again")
    return data
