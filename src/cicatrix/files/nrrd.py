"""NRRD images, with their voxels attached or in files beside the header.

Source: G. Kindlmann, Definition of NRRD file format, teem.sourceforge.net/nrrd/format.html.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from .grid import Grid, Stored, check_size
from .numerals import without_underscore
from .streams import Source, opened
from .voxels import decoded, from_files, numbered, numbers_in

MARK = b"NRRD000"
LONGEST_HEADER = 1 << 24  # letters
TYPES = {
    "i1": ("signed char", "int8", "int8_t"),
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "i8": ("longlong", "long long", "long long int", "signed long long", "signed long long int", "int64", "int64_t"),
    "u8": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"),
    "f4": ("float",),
    "f8": ("double",),
}
ENCODINGS = {
    "raw": "raw", "gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2",
    "ascii": "text", "text": "text", "txt": "text", "hex": "hex",
}  # fmt: skip
SPACES = {  # signs from the space's directions to LPS; other spaces are not the patient's
    "left-posterior-superior": (1.0, 1.0, 1.0), "lps": (1.0, 1.0, 1.0),
    "right-anterior-superior": (-1.0, -1.0, 1.0), "ras": (-1.0, -1.0, 1.0),
    "left-anterior-superior": (1.0, -1.0, 1.0), "las": (1.0, -1.0, 1.0),
}  # fmt: skip
MM = {"mm", "millimeter", "millimeters", "millimetre", "millimetres", ""}


def is_nrrd(head: bytes) -> bool:
    """Return whether a file begins with the mark of NRRD."""
    return head.startswith(MARK)


def read_nrrd(path: Path, *, layers: bool = False) -> Stored:
    """Read a volume from a ``.nrrd`` file, or from a ``.nhdr`` file and those that it names.

    Parameters
    ----------
    path : Path
        The file.
    layers : bool
        Whether a voxel may have several values, as in a segmentation whose segments overlap.

    Raises
    ------
    InputError
        If the header contradicts itself or the format, or the voxels are cut short, damaged, too many or beyond their type.
    """
    with opened(path) as source:
        fields, pairs = _header(source)
        sizes, others, size, grid = _layout(fields, layers)
        components = int(np.prod([float(sizes[axis]) for axis in others]))
        if components == 1:
            return Stored(_values(path, source, fields, size[::-1]), grid, pairs)
        check_size((*size[:2], size[2] * components))
        values = _values(path, source, fields, tuple(sizes[::-1]))
        last = [len(sizes) - 1 - axis for axis in others]  # array axes run backwards
        return Stored(np.moveaxis(values, last, range(-len(last), 0)).reshape(*size[::-1], components), grid, pairs)


def nrrd_header(path: Path) -> tuple[tuple[int, int, int], Grid]:
    """Return the numbers of voxels along x, y, z, and where they lie; voxels are not read. InputError as :func:`read_nrrd`."""
    with opened(path) as source:
        _, _, size, grid = _layout(_header(source)[0], layers=False)
        return size, grid


def _layout(fields: dict[str, str], layers: bool) -> tuple[list[int], list[int], tuple[int, int, int], Grid]:
    """Return the sizes of all axes, the axes that are not in space, the numbers of voxels along x, y, z, and where they lie."""
    sizes = _whole_numbers(fields, "sizes")
    domain = _domain(fields, len(sizes))
    others = [axis for axis in range(len(sizes)) if axis not in domain]
    components = int(np.prod([float(sizes[axis]) for axis in others]))
    size = check_size(tuple(sizes[axis] for axis in domain), 1 if layers else components)
    return sizes, others, size, _grid(fields, domain)


def _header(source: Source) -> tuple[dict[str, str], dict[str, str]]:
    """Return the fields by their names in lower case, and the key-value pairs; the header ends at an empty line."""
    fields, pairs, line, length = {}, {}, source.line(), 0
    while line:
        line = source.line()
        length += len(line)
        if length > LONGEST_HEADER:
            raise InputError(f"the NRRD header has more than {LONGEST_HEADER >> 20} MB; convert the image again")
        key, colon, value = line.partition(":")
        if line.startswith("#") or not colon:
            continue
        if value.startswith("="):
            pairs[key] = value[1:]
        elif key.lower().strip() in ("data file", "datafile") and value.strip().startswith("LIST"):
            return fields | {"data file": "\n".join(["LIST", *_list(source)])}, pairs
        else:
            name, value = key.lower().strip().replace("datafile", "data file"), value.strip()
            if fields.get(name, value) != value:
                raise InputError(
                    f'the NRRD header gives "{name[:60]}" twice, as "{fields[name][:60]}" and as "{value[:60]}"'
                )
            fields[name] = value
    return fields, pairs


def _list(source: Source) -> Iterator[str]:
    while line := source.line():
        yield line


def _field(fields: dict[str, str], name: str) -> str:
    if name not in fields:
        raise InputError(f'the NRRD header has no field "{name}"; convert the image again')
    return fields[name]


def _whole_numbers(fields: dict[str, str], name: str) -> list[int]:
    text = _field(fields, name)
    try:
        numbers = [int(without_underscore(word)) for word in text.split()]
    except ValueError:
        raise InputError(f'the NRRD field "{name}" must have whole numbers; got "{text[:60]}"') from None
    if name == "sizes" and str(len(numbers)) != fields.get("dimension", "").strip():
        raise InputError(
            f'the NRRD header\'s dimension "{fields.get("dimension")}" is not that of its {len(numbers)} sizes'
        )
    return numbers


def _domain(fields: dict[str, str], rank: int) -> list[int]:
    """Return the axes of the file that lie in space; others, such as colours, hold several values per voxel."""
    kinds = fields.get("kinds", "").split()
    directions = _vectors(fields.get("space directions", ""))
    if "space directions" in fields and len(directions) != rank:
        raise InputError(
            f"the NRRD header has {len(directions)} space directions for {rank} axes; convert the image again"
        )
    unknown = [axis for axis, direction in zip("xyz", directions) if direction is None]
    if rank <= 3 and unknown:
        raise InputError(f"the NRRD header gives no direction of the axis {unknown[0]} (none); convert the image again")
    if rank <= 3 or (not directions and len(kinds) != rank):
        return list(range(rank))
    if directions:
        return [axis for axis in range(rank) if directions[axis] is not None]
    return [axis for axis in range(rank) if kinds[axis] in ("domain", "space", "time", "???", "none")]


def _vectors(text: str) -> list[np.ndarray | None]:
    """Return vectors written as (1,0,0) (0,1,0) none."""
    try:
        return [
            None if word == "none" else np.array(numbers_in(word.strip("()").split(",")))
            for word in re.findall(r"\([^)]*\)|none", text)
        ]
    except ValueError:
        raise InputError(f'the NRRD header has a vector that is not numbers: "{text[:60]}"') from None


def _grid(fields: dict[str, str], domain: list[int]) -> Grid:
    """Return where the voxels lie; the directions are unknown unless the space is the patient's."""
    units = [unit for unit in re.findall(r'"([^"]*)"', fields.get("space units", "")) if unit.lower() not in MM]
    vectors = [vector for vector in _vectors(fields.get("space directions", "")) if vector is not None]
    if not vectors:
        return Grid(_spacings(fields, domain), None, None)
    if any(len(vector) != 3 for vector in vectors):
        raise InputError("the NRRD header's space directions must have three numbers each; convert the image again")
    matrix = np.array(vectors).T
    edges = np.linalg.norm(matrix, axis=0)
    sx, sy, sz = edges.tolist()
    signs = SPACES.get(fields.get("space", "").lower())
    origins = [vector for vector in _vectors(fields.get("space origin", "")) if vector is not None and len(vector) == 3]
    origin = None
    if origins and signs:
        ox, oy, oz = (origins[0] * signs).tolist()
        origin = (ox, oy, oz)
    with np.errstate(invalid="ignore", divide="ignore"):  # the judge of the grid refuses what is not a number
        directions = None if signs is None else np.array(signs)[:, None] * matrix / edges
    return Grid((sx, sy, sz), origin, directions, unit=units[0] if units else "mm")


def _spacings(fields: dict[str, str], domain: list[int]) -> tuple[float, float, float]:
    words = fields.get("spacings", "").split()
    try:
        sx, sy, sz = numbers_in(words[axis] for axis in domain)
    except (ValueError, IndexError):
        raise InputError(
            'the NRRD header gives no size of a voxel ("space directions" or "spacings"); convert the image again'
        ) from None
    return sx, sy, sz


def _values(path: Path, source: Source, fields: dict[str, str], shape: tuple[int, ...]) -> np.ndarray:
    """Return the voxels, by default (nz, ny, nx)."""
    name, encoding = _field(fields, "type").lower(), ENCODINGS.get(_field(fields, "encoding").lower())
    kind = next((kind for kind, names in TYPES.items() if name in names), None)
    if kind is None or encoding is None:
        raise InputError(
            f'the NRRD header\'s type "{name}" or encoding "{fields["encoding"]}" is unknown; save the image as int16, raw'
        )
    order = fields.get("endian", "").lower()
    if kind[1] != "1" and encoding not in ("text", "hex") and order not in ("little", "big"):
        raise InputError('the NRRD header does not give the order of bytes ("endian: little"); convert the image again')
    stored = np.dtype((">" if order == "big" else "<") + kind)
    lines, skipped = (
        _whole_numbers(fields, f"{what} skip")[0] if fields.get(f"{what} skip") else 0 for what in ("line", "byte")
    )
    if skipped < -1:
        raise InputError(f'the NRRD field "byte skip" is {skipped}; it must be a number of bytes, or -1')
    if "data file" not in fields:
        return decoded(source, encoding, stored, shape, skipped, lines)
    return from_files(path.parent, _names(fields["data file"]), encoding, stored, shape, skipped, lines)


def _names(text: str) -> list[str]:
    """Return the names of the files that hold the voxels: one, a list, or a pattern with its numbers."""
    words = text.split()
    if words[:1] == ["LIST"]:
        return text.splitlines()[1:]
    return numbered(words[0], words[1:4]) if len(words) >= 4 and "%" in words[0] else [text]
