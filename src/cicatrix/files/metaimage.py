"""MetaImage files, with their voxels attached (.mha) or in files beside the header (.mhd).

Source: ITK, MetaIO documentation, itk.org/Wiki/ITK/MetaIO/Documentation.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.errors import InputError
from .grid import Grid, Stored, check_size, scaled
from .streams import Source, opened
from .voxels import decoded, from_files, numbered, numbers_in

KEYS = (
    b"ObjectType",
    b"NDims",
    b"Comment",
    b"DimSize",
    b"ObjectSubType",
    b"TransformType",
)  # with which a header begins
TYPES = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2", "MET_INT": "i4", "MET_UINT": "u4",
    "MET_LONG": "i4", "MET_ULONG": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4", "MET_DOUBLE": "f8",
}  # fmt: skip
MOST_LINES = 1000


def is_metaimage(head: bytes) -> bool:
    """Return whether a file begins with a key of a MetaImage header."""
    return any(head.startswith(key) and b"=" in head[:80] for key in KEYS)


def read_metaimage(path: Path) -> Stored:
    """Read a volume from a ``.mha`` file, or from a ``.mhd`` file and those that it names.

    Raises
    ------
    InputError
        If the header contradicts itself or the format, or the voxels are cut short, damaged, too many or beyond their type.
    """
    with opened(path) as source:
        header = _header(source)
        size, grid = _described(header)
        kind, encoding, skip = _storage(header)
        names = _names(header["ElementDataFile"], source)
        if names is None:
            values = decoded(source, encoding, kind, size[::-1], skip)
        else:
            values = from_files(path.parent, names, encoding, kind, size[::-1], skip)
    slope, intercept = (
        _numbers(header, f"ElementToIntensityFunction{part}", 1, default)[0]
        for part, default in (("Slope", 1.0), ("Offset", 0.0))
    )
    return Stored(scaled(values, slope, intercept), grid)


def metaimage_header(path: Path) -> tuple[tuple[int, int, int], Grid]:
    """Return the numbers of voxels along x, y, z, and where they lie; no voxel is read. InputError as :func:`read_metaimage`."""
    with opened(path) as source:
        return _described(_header(source))


def _described(header: dict[str, str]) -> tuple[tuple[int, int, int], Grid]:
    rank = int(_numbers(header, "NDims", 1)[0])
    channels = int(_numbers(header, "ElementNumberOfChannels", 1, 1)[0])
    size = check_size(tuple(int(n) for n in _numbers(header, "DimSize", rank)), channels)
    return size, _grid(header, rank)


def _header(source: Source) -> dict[str, str]:
    """Return the values by their keys; the last key says where the voxels are."""
    header: dict[str, str] = {}
    for _ in range(MOST_LINES):
        key, value = (part.strip() for part in source.line().partition("=")[::2])
        if key and header.get(key, value) != value:
            raise InputError(
                f'the MetaImage header gives {key[:60]} twice, as "{header[key][:60]}" and as "{value[:60]}"'
            )
        header[key] = value
        if key == "ElementDataFile":
            return header
    raise InputError("the MetaImage header does not say where the voxels are (ElementDataFile = LOCAL)")


def _numbers(header: dict[str, str], key: str, n: int, default: float | None = None) -> list[float]:
    """Return the ``n`` numbers of a key."""
    if key not in header and default is not None:
        return [float(default)] * n
    try:
        numbers = numbers_in(header.get(key, "").split())
    except ValueError:
        numbers = []
    if len(numbers) != n or (key in ("NDims", "DimSize") and not all(0 < x < 2**31 and x == int(x) for x in numbers)):
        raise InputError(f'the MetaImage header needs {n} numbers as {key}; got "{header.get(key, "")[:60]}"')
    return numbers


def _given(header: dict[str, str], *keys: str) -> str | None:
    """Return the first of keys with the same meaning that the header has."""
    return next((key for key in keys if key in header), None)


def _grid(header: dict[str, str], rank: int) -> Grid:
    """Return where the voxels lie; lengths are in mm, positions and directions in LPS, one row per axis of the file."""
    edges = _given(header, "ElementSpacing", "ElementSize")
    if edges is None:
        raise InputError("the MetaImage header gives no size of a voxel (ElementSpacing)")
    sx, sy, sz = _numbers(header, edges, rank)[:3]
    origin, turn = (
        _given(header, "Offset", "Position", "Origin"),
        _given(header, "TransformMatrix", "Rotation", "Orientation"),
    )
    place = None if origin is None else _numbers(header, origin, rank)
    rows = None if turn is None else np.array(_numbers(header, turn, rank * rank)).reshape(rank, rank)[:3, :3]
    return Grid(
        (sx, sy, sz), None if place is None else (place[0], place[1], place[2]), None if rows is None else rows.T
    )


def _storage(header: dict[str, str]) -> tuple[np.dtype, str, int]:
    """Return how voxels are stored: type with its order of bytes, encoding, and bytes before them."""
    element = header.get("ElementType", "")
    if element not in TYPES:
        raise InputError(
            f'the MetaImage header\'s ElementType "{element[:60]}" is unknown; save the image as MET_SHORT'
        )
    is_big, is_packed, is_text = (
        any(header.get(key, default).lower() == word for key in keys)
        for keys, word, default in (
            (("BinaryDataByteOrderMSB", "ElementByteOrderMSB"), "true", "false"),
            (("CompressedData",), "true", "false"),
            (("BinaryData",), "false", "true"),
        )
    )
    kind = np.dtype((">" if is_big else "<") + TYPES[element])
    skip = _numbers(header, "HeaderSize", 1, 0)[0]
    if not (-1 <= skip < 2**63 and skip == int(skip)):
        raise InputError(f"the MetaImage header's HeaderSize is {skip:g}; it must be a whole number of bytes, or -1")
    return kind, "zlib" if is_packed else "text" if is_text else "raw", int(skip)


def _names(text: str, source: Source) -> list[str] | None:
    """Return the names of the files that hold the voxels; None if these follow the header."""
    words = text.split()
    if text.upper() == "LOCAL":
        return None
    if words[:1] == ["LIST"]:
        names = []
        while line := source.line():
            names.append(line)
        return names
    return numbered(words[0], words[1:4]) if len(words) >= 4 and "%" in words[0] else [text]
