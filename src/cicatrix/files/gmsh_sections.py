"""Sections of a file of Gmsh: their numbers as text or bytes, numbered rows, and data of nodes and elements.

Source: Gmsh reference manual, "MSH file format" and "MSH file format version 2 (Legacy)".
"""

from __future__ import annotations

import re
from collections import defaultdict

import numpy as np

from ..core.errors import InputError

INT, REAL = "i4", "f8"
LARGEST = 2.0**52  # whole numbers up to here are exact in a text that is read as real numbers


def sections_of(content: bytes) -> dict[str, list[bytes]]:
    """Return the content of each section, from the line after its name to its end."""
    out: dict[str, list[bytes]] = defaultdict(list)
    at = 0
    while match := re.compile(rb"^\$(\w+)[ \t]*\r?\n", re.MULTILINE).search(content, at):
        name = match[1]
        end = content.find(b"$End" + name, match.end())
        if end < 0:
            raise InputError(f"its section ${name.decode()} has no end")
        out[name.decode()].append(content[match.end() : end])
        at = end + len(name) + 4
    return out


def section_text(sections: dict[str, list[bytes]], name: str) -> str:
    """Return the first section of a name as a text; an empty one if there is none."""
    return sections[name][0].decode("utf-8", "replace") if name in sections else ""


def format_of(sections: dict[str, list[bytes]]) -> tuple[str, bool, str]:
    """Return version, whether the file is binary, and the type of its sizes."""
    head = sections["MeshFormat"][0]
    version, form, size = head.split(maxsplit=3)[:3]
    if form == b"1" and head.partition(b"\n")[2][:4] != b"\1\0\0\0":
        raise InputError("its bytes are big-endian; save the mesh as text")
    missing = {"Nodes", "Elements"} - sections.keys()
    if missing:
        raise InputError(f"it has no section ${min(missing)}")
    if int(size) not in (4, 8):
        raise InputError(f"its numbers have {int(size)} bytes; 4 or 8 are read")
    return version.decode(), form == b"1", f"u{int(size)}"


def _bare(content: bytes) -> bytes:
    """Return a text with bare numbers: meshio 5.3 under NumPy 2 writes ``np.float64(1.0)`` for 1.0 in data."""
    return re.sub(rb"np\.\w+\(([^()]*)\)", rb"\1", content) if b"np." in content else content


class Numbers:
    """Numbers of a section, one after another, from text or from bytes."""

    def __init__(self, content: bytes, is_binary: bool) -> None:
        self._bytes = content if is_binary else None
        self._values = np.zeros(0) if is_binary else np.array(_bare(content).split(), float)
        self._at = 0

    def take(self, kind: str, n: int) -> np.ndarray:
        """Return the next n numbers of a type, as integers or floats."""
        kinds = np.dtype(kind)
        if n < 0:
            raise ValueError(f"a section counts {n} numbers")
        if self._bytes is None:
            out = self._values[self._at : self._at + n]
            self._at += n
        else:
            out = np.frombuffer(self._bytes[self._at : self._at + n * kinds.itemsize], kinds)
            self._at += n * kinds.itemsize
        if len(out) < n:
            raise ValueError(f"a section ends after {len(out)} of {n} numbers")
        return out.astype(float) if kinds.kind == "f" else _whole(out)

    def one(self, kind: str) -> int:
        """Return the next number, an integer."""
        return int(self.take(kind, 1)[0])

    @property
    def left(self) -> int:
        """Count of the numbers that are left, or of bytes."""
        return len(self._values if self._bytes is None else self._bytes) - self._at


def counted(content: bytes, is_binary: bool) -> tuple[int, Numbers]:
    """Return the count in the first line of a section of version 2, which is text, and the numbers after it."""
    line, _, rest = content.partition(b"\n")
    return int(line), Numbers(rest, is_binary)


def numbered_rows(content: bytes, n: int, width: int, is_binary: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers (n,) of nodes or elements, and values (n, width), of rows that hold both."""
    if not is_binary:
        table = Numbers(content, False).take(REAL, n * (1 + width)).reshape(n, 1 + width)
        return _whole(table[:, 0]), table[:, 1:]
    kind = np.dtype([("tag", "<i4"), ("value", "<f8", (width,))])
    if n < 0 or len(content) < n * kind.itemsize:
        raise ValueError(f"a section ends before its {n} rows")
    rows = np.frombuffer(content[: n * kind.itemsize], kind)
    return rows["tag"].astype(int), rows["value"].copy()


def _whole(values: np.ndarray) -> np.ndarray:
    """Return numbers as integers."""
    if not (np.abs(values) < LARGEST).all():
        raise ValueError("a section has a number that is no whole number of a node or an element")
    return values.astype(int)


class Index:
    """Rows by the numbers that a file gives its nodes or elements."""

    def __init__(self, tags: np.ndarray, what: str) -> None:
        self._order, self._what = np.argsort(tags, kind="stable"), what
        self._tags = tags[self._order]
        if (np.diff(self._tags) == 0).any():
            raise InputError(f"it has two {what}s with the number {self._tags[:-1][np.diff(self._tags) == 0][0]}")

    def of(self, tags: np.ndarray) -> np.ndarray:
        """Return the rows of numbers, in the shape of ``tags``."""
        place = np.minimum(np.searchsorted(self._tags, tags), max(len(self._tags) - 1, 0))
        wrong = tags[self._tags[place] != tags] if len(self._tags) else tags.ravel()
        if wrong.size:
            raise InputError(f"it names {self._what} {wrong[0]}, which it does not have")
        return self._order[place]


def data_of(
    sections: dict[str, list[bytes]], section: str, tags: list[np.ndarray], is_binary: bool, notes: list[str]
) -> dict[str, list[np.ndarray]]:
    """Return data by name, one array for each of the blocks of ``tags``; NaN where the file gives no value."""
    out: dict[str, list[np.ndarray]] = {}
    ends = np.cumsum([len(block) for block in tags])[:-1]
    index = Index(np.concatenate(tags), "node" if section == "NodeData" else "element") if section in sections else None
    for content in sections.get(section, []):
        name, numbers, values = _view(content, is_binary)
        whole = np.full((sum(map(len, tags)), values.shape[1]), np.nan)
        assert index is not None
        whole[index.of(numbers)] = values
        if name in out:
            notes.append(f"The file has `{name}` at several times; the last is used.")
        out[name] = np.split(whole[:, 0] if whole.shape[1] == 1 else whole, ends)
    return out


def _head(content: bytes) -> tuple[list[list[bytes]], bytes]:
    """Return the texts, real numbers and whole numbers before the values of a section of data, a line each, and the rest."""
    out: list[list[bytes]] = []
    for _ in range(3):
        count, _, content = content.partition(b"\n")
        *lines, content = content.split(b"\n", int(count))
        out.append([line.strip() for line in lines])
    return out, content


def _view(content: bytes, is_binary: bool) -> tuple[str, np.ndarray, np.ndarray]:
    """Return name, numbers of nodes or elements, and values (n, components) of a section of data."""
    (texts, _, whole), rest = _head(content)
    _, width, n = (int(number) for number in whole[:3])
    if not 1 <= width <= 9:
        raise ValueError(f"data have {width} components; 1, 3 or 9 are read")
    name = texts[0].decode("utf-8", "replace").strip('"') if texts else ""
    return name, *numbered_rows(rest, n, width, is_binary)
