"""Read unstructured grids in the XML format of VTK: ``.vtu`` with one or several pieces, and ``.pvtu``, which names its pieces.

Source: VTK User's Guide, "XML File Formats", https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html
"""

from __future__ import annotations

import binascii
import lzma
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import meshio
import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..core.errors import InputError
from .opening import bytes_of

CELLS = {  # number in VTK: name in meshio, number of nodes
    **{1: ("vertex", 1), 3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4), 10: ("tetra", 4), 12: ("hexahedron", 8)},
    **{13: ("wedge", 6), 14: ("pyramid", 5), 21: ("line3", 3), 22: ("triangle6", 6), 23: ("quad8", 8)},
    **{24: ("tetra10", 10), 25: ("hexahedron20", 20), 26: ("wedge15", 15), 27: ("pyramid13", 13)},
    **{28: ("quad9", 9), 29: ("hexahedron27", 27)},
}
TYPES = {
    **{f"Int{bits}": f"i{bits // 8}" for bits in (8, 16, 32, 64)},
    **{f"UInt{bits}": f"u{bits // 8}" for bits in (8, 16, 32, 64)},
    **{"Float32": "f4", "Float64": "f8"},
}
COMPRESSORS = {"vtkZLibDataCompressor": zlib.decompressobj, "vtkLZMADataCompressor": lzma.LZMADecompressor}
MOST_NODES, MOST_COMPONENTS = 27, 16  # of a cell, of a value
ROUNDING = 1e-7  # distance over the extent of the grid below which nodes of two pieces are one, as in single precision
GHOST = "vtkGhostType"  # cell data whose first bit marks a copy of a cell that belongs to another piece


class Piece(NamedTuple):
    """A part of a grid: its nodes, cells and data."""

    points: np.ndarray
    """Nodes (n, 3), in the type of the file."""
    nodes: np.ndarray
    """Nodes of all cells, one cell after another."""
    ends: np.ndarray
    """Where the nodes of each cell end in ``nodes`` (m,)."""
    types: np.ndarray
    """Type of each cell, a number of VTK (m,)."""
    point_data: dict[str, np.ndarray]
    cell_data: dict[str, np.ndarray]


def is_vtk_xml(head: bytes) -> bool:
    """Return whether a file that begins with ``head`` has VTK's XML format."""
    return b"<VTKFile" in head


def read_vtk_xml(path: Path) -> meshio.Mesh:
    """Read a ``.vtu`` or ``.pvtu`` file; the pieces are joined at nodes of equal coordinates, which is said in ``info``.

    Raises
    ------
    InputError
        If the file cannot be read; the message is about the file, without its name.
    """
    pieces = list(_pieces(path))
    if not pieces:
        raise InputError("the grid has no <Piece>")
    grids = [piece for piece in pieces if len(piece.points)] or pieces[:1]
    return _mesh(grids[0], []) if len(grids) == 1 else _joined(grids)


# ---- pieces to a mesh


def _mesh(piece: Piece, notes: list[str]) -> meshio.Mesh:
    """Return a piece as a mesh with one block of cells for each type."""
    starts = np.concatenate([[0], piece.ends[:-1]]).astype(int)
    if piece.ends.size and ((np.diff(piece.ends, prepend=0) < 0).any() or piece.ends[-1] > piece.nodes.size):
        raise InputError("the offsets of the cells do not fit their connectivity")
    cells, data = [], {name: [] for name in piece.cell_data}
    for number in dict.fromkeys(piece.types.tolist()):
        if number not in CELLS:
            raise InputError(f"cells of VTK's type {number} are not read; save the mesh with tetrahedra only")
        kind, size = CELLS[number]
        rows = np.flatnonzero(piece.types == number)
        if (piece.ends[rows] - starts[rows] != size).any():
            raise InputError(f"a cell of type {kind} has another number of nodes than {size}")
        cells.append((kind, piece.nodes[starts[rows, None] + np.arange(size)]))
        for name, values in piece.cell_data.items():
            data[name].append(values[rows])
    used = np.concatenate([np.zeros(1, int), *(nodes.ravel() for _, nodes in cells)])
    if used.min() < 0 or used.max() >= max(len(piece.points), 1):
        raise InputError(
            f"a cell names node {max(used.max(), -used.min())}, but the file has {len(piece.points)} nodes"
        )
    return meshio.Mesh(piece.points, cells, point_data=piece.point_data, cell_data=data, info=notes)


def _joined(pieces: list[Piece]) -> meshio.Mesh:
    """Join pieces at nodes of equal coordinates; each becomes a set of cells, ``piece 1`` and so on."""
    pieces = [_without_ghosts(piece) for piece in pieces]
    points = np.vstack([piece.points for piece in pieces])
    order, new = _equal_nodes(points, np.repeat(np.arange(len(pieces)), [len(piece.points) for piece in pieces]))
    first_node = np.cumsum([0, *(len(piece.points) for piece in pieces)])
    first_entry = np.cumsum([0, *(piece.nodes.size for piece in pieces)])
    point_data = _together([piece.point_data for piece in pieces])
    notes = [
        f"The file has {len(pieces)} pieces: they are joined at {len(points) - len(order)} nodes of equal coordinates."
    ]
    for name, values in point_data.items():
        differ = (values != values[order][new]) & ~((values != values) & (values[order][new] != values[order][new]))
        if differ.any():
            notes.append(f"Point data `{name}` differ between pieces at nodes that they share; the first piece counts.")
    whole = Piece(
        points[order],
        new[np.concatenate([piece.nodes + start for piece, start in zip(pieces, first_node)])],
        np.concatenate([piece.ends + start for piece, start in zip(pieces, first_entry)]),
        np.concatenate([piece.types for piece in pieces]),
        {name: values[order] for name, values in point_data.items()},
        _together([piece.cell_data for piece in pieces]),
    )
    mesh = _mesh(whole, notes)
    owner = np.repeat(np.arange(len(pieces)), [len(piece.types) for piece in pieces])
    blocks = [owner[whole.types == number] for number in dict.fromkeys(whole.types.tolist())]
    mesh.cell_sets = {f"piece {k + 1}": [np.flatnonzero(block == k) for block in blocks] for k in range(len(pieces))}
    return mesh


def _equal_nodes(points: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes that stay (k,), the first of those that are equal but for rounding, and which of them each node is (n,).

    ``owner`` (n,) is the piece of each node; nodes of one piece are not equal.
    """
    extent = float(np.ptp(points, axis=0).max(initial=0.0)) if len(points) else 0.0
    one, other = cKDTree(points).query_pairs(ROUNDING * extent, output_type="ndarray").T
    apart = owner[one] != owner[other]
    links = sp.coo_array((np.ones(apart.sum()), (one[apart], other[apart])), (len(points),) * 2)
    _, number = connected_components(links, directed=False)
    _, first = np.unique(number, return_index=True)
    order = np.sort(first)
    return order, np.searchsorted(order, first)[number]


def _without_ghosts(piece: Piece) -> Piece:
    """Drop the copies of cells that belong to another piece."""
    if GHOST not in piece.cell_data:
        return piece
    kept = np.asarray(piece.cell_data[GHOST]).astype(int) & 1 == 0
    sizes = np.diff(piece.ends, prepend=0)
    data = {name: values[kept] for name, values in piece.cell_data.items()}
    own = piece._replace(
        nodes=piece.nodes[np.repeat(kept, sizes)], ends=np.cumsum(sizes[kept]), types=piece.types[kept]
    )
    return own._replace(cell_data=data)


def _together(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Concatenate the data that all pieces have."""
    shared = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in shared}


# ---- XML to pieces


def _pieces(path: Path) -> Iterator[Piece]:
    file = _file(bytes_of(path))
    if file.root.get("type") == "PUnstructuredGrid":
        for piece in file.root.iter("Piece"):
            source = path.parent / piece.get("Source", "")
            try:
                yield from _file(bytes_of(source)).pieces()
            except InputError as error:
                raise InputError(f"its piece {source.name}: {error}") from None
        return
    yield from file.pieces()


def _file(content: bytes) -> _File:
    """Split a file into its XML and the appended data."""
    found = re.search(rb"<AppendedData[^>]*>", content)
    head, blob, encoding = content, b"", "raw"
    if found:
        head = content[: found.start()] + b"</VTKFile>"
        end = content.rfind(b"</AppendedData>")
        start = content.find(b"_", found.end()) + 1
        blob, encoding = content[start : end if end > start else None], "base64" if b"base64" in found[0] else "raw"
    try:
        root = ElementTree.fromstring(head)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"its XML is damaged: {error}") from None
    kind = root.get("type")
    if root.tag != "VTKFile" or kind not in ("UnstructuredGrid", "PUnstructuredGrid"):
        raise InputError(f"it holds {kind or root.tag}; a mesh of tetrahedra is an UnstructuredGrid")
    return _File(root, blob, encoding)


@dataclass(frozen=True)
class _File:
    """XML of a file, and its appended data with their encoding."""

    root: ElementTree.Element
    blob: bytes
    encoding: str

    def pieces(self) -> Iterator[Piece]:
        """Yield the pieces of the grid."""
        for piece in self.root.iter("Piece"):
            n_points, n_cells = (_count(piece.get(f"NumberOf{what}", "")) for what in ("Points", "Cells"))
            cells = self._arrays(piece, "Cells", None, MOST_NODES * n_cells)
            missing = {"connectivity", "offsets", "types"} - cells.keys()
            points = list(self._arrays(piece, "Points", n_points, 3 * n_points).values())
            if missing or not points:
                raise InputError(f"a piece lacks {', '.join(sorted(missing)) or 'points'}")
            nodes, ends, types = (cells[name].ravel() for name in ("connectivity", "offsets", "types"))
            if len(ends) != n_cells or len(types) != n_cells:
                raise InputError(
                    f"a piece should have {n_cells} cells, but has {len(types)} types and {len(ends)} offsets"
                )
            yield Piece(
                points[0].reshape(n_points, -1),
                *(nodes.astype(int), ends.astype(int), types.astype(int)),
                self._arrays(piece, "PointData", n_points, MOST_COMPONENTS * n_points),
                self._arrays(piece, "CellData", n_cells, MOST_COMPONENTS * n_cells),
            )

    def _arrays(self, piece: ElementTree.Element, part: str, n: int | None, most: int) -> dict[str, np.ndarray]:
        """Return the arrays of a part of a piece by name, of ``most`` numbers each; those of texts are left out."""
        found = [
            array for place in piece.findall(part) for array in place.findall("DataArray") if array.get("type") in TYPES
        ]
        return {array.get("Name", ""): self._array(array, n, most) for array in found}

    def _array(self, element: ElementTree.Element, n: int | None, most: int) -> np.ndarray:
        """Return an array (n,) or (n, components); without ``n`` it has as many rows as the file gives."""
        name = element.get("Name", "")
        try:
            values = self._values(element, most)
        except (ValueError, OverflowError, zlib.error, lzma.LZMAError, EOFError) as error:
            raise InputError(f"its array `{name}` is damaged: {error}") from None
        width = _count(element.get("NumberOfComponents") or "1") or 1
        if n is not None and values.size != n * width:
            raise InputError(f"its array `{name}` should have {n} x {width} values, but has {values.size}")
        return values.reshape(-1, width) if width > 1 else values

    def _values(self, element: ElementTree.Element, most: int) -> np.ndarray:
        kind = np.dtype(TYPES[element.get("type", "")])
        form = element.get("format", "ascii")
        if form == "ascii":
            return np.array((element.text or "").split(), kind)
        if form == "binary":
            stream = _Stream("".join((element.text or "").split()).encode(), 0, "base64")
        else:
            stream = _Stream(self.blob, _count(element.get("offset", "")), self.encoding)
        return np.frombuffer(self._unpacked(stream, most * kind.itemsize), kind.newbyteorder(self._order)).astype(kind)

    @property
    def _order(self) -> str:
        return ">" if self.root.get("byte_order") == "BigEndian" else "<"

    def _unpacked(self, stream: _Stream, most: int) -> bytes:
        """Return the bytes of an array: after its length, or in compressed blocks after their sizes; ``most`` bytes at most."""
        header = np.dtype(TYPES.get(self.root.get("header_type", "UInt32"), "u4")).newbyteorder(self._order)

        def sizes(n: int) -> list[int]:
            return np.frombuffer(stream.first(n * header.itemsize), header).tolist()

        (n,) = sizes(1)
        name = self.root.get("compressor")
        if not name:
            return stream.first(header.itemsize + n)[header.itemsize :]
        if name not in COMPRESSORS:
            raise InputError(f"its data are compressed by {name}; save it with zlib or without compression")
        _, block, last, *packed = sizes(3 + n) if n else (0, 0, 0)
        if n and (n - 1) * block + (last or block) > most:
            raise ValueError(f"it unpacks to more than the {most} bytes that it can have")
        at, end, out = header.itemsize * (3 + n), header.itemsize * (3 + n) + sum(packed), []
        data = stream.first(end) if n else b""
        for number, size in enumerate(packed, 1):
            whole = last if number == n and last else block
            out.append(_inflated(name, data[at : at + size], whole))
            at += size
        return b"".join(out)


def _inflated(compressor: str, data: bytes, size: int) -> bytes:
    """Decompress a block to ``size`` bytes, and no further."""
    out = COMPRESSORS[compressor]().decompress(data, size)
    if len(out) != size:
        raise ValueError(f"a compressed block has {len(out)} bytes for {size}")
    return out


class _Stream(NamedTuple):
    """Bytes that begin at an offset of a blob, which is raw or in base64."""

    blob: bytes
    offset: int
    encoding: str

    def first(self, n: int) -> bytes:
        """Return the first n bytes.

        In base64 an array is one text, or two, the first of which is its header and ends with ``=``.
        """
        out = self.blob[self.offset : self.offset + n] if self.encoding == "raw" else self._decoded(n)
        if len(out) < n:
            raise ValueError(f"it ends after {len(out)} of {n} bytes")
        return out

    def _decoded(self, n: int) -> bytes:
        text = self.blob[self.offset : self.offset + 4 * (n // 3 + 4)]
        parts = re.findall(rb"[^=]+={0,2}", text)
        return b"".join(binascii.a2b_base64(part[: len(part) // 4 * 4]) for part in parts)[:n]


def _count(text: str) -> int:
    """Return a whole number that is not negative."""
    if not text.strip().isdecimal():
        raise InputError(f"its XML has {text!r} where a number of nodes, cells or bytes is needed")
    return int(text)
