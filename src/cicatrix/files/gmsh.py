"""Read meshes of Gmsh, versions 2 and 4.1, as text or binary, with physical groups and data of nodes and elements.

A physical group becomes a set of cells with its name; one without a name is called after its dimension and number, such as
``surface 1``. Source: Gmsh reference manual, "MSH file format" and "MSH file format version 2 (Legacy)".
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field

import meshio
import numpy as np

from ..core.errors import InputError
from .gmsh_sections import (
    INT,
    REAL,
    Index,
    Numbers,
    counted,
    data_of,
    format_of,
    numbered_rows,
    section_text,
    sections_of,
)

CELLS = {  # number in Gmsh: name in meshio, dimension, number of nodes
    **{1: ("line", 1, 2), 2: ("triangle", 2, 3), 3: ("quad", 2, 4), 4: ("tetra", 3, 4), 5: ("hexahedron", 3, 8)},
    **{6: ("wedge", 3, 6), 7: ("pyramid", 3, 5), 8: ("line3", 1, 3), 9: ("triangle6", 2, 6), 10: ("quad9", 2, 9)},
    **{11: ("tetra10", 3, 10), 12: ("hexahedron27", 3, 27), 15: ("vertex", 0, 1), 16: ("quad8", 2, 8)},
    **{17: ("hexahedron20", 3, 20), 18: ("wedge15", 3, 15), 19: ("pyramid13", 3, 13)},
}
DIMENSIONS = ("point", "curve", "surface", "volume")
VTK_ORDER = {"tetra10": [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]}  # Gmsh has the last two edges in another order


def is_gmsh(head: bytes) -> bool:
    """Return whether a file that begins with ``head`` is a mesh of Gmsh of a version that is read here."""
    return re.search(rb"^\$MeshFormat\s+(2|4\.1|4\s)", head, re.MULTILINE) is not None


def gmsh_mesh(content: bytes) -> meshio.Mesh:
    """Return the mesh in the content of a file.

    Raises
    ------
    InputError
        If the file has something that is not read; the message is about the file, without its name.
    ValueError, LookupError
        If the content is damaged.
    """
    found, sections = _Found(), sections_of(content)
    version, is_binary, size = format_of(sections)
    for line in section_text(sections, "PhysicalNames").splitlines()[1:]:
        match = re.match(r'\s*(\d)\s+(\d+)\s+"?(.*?)"?\s*$', line)
        if match:
            found.names[int(match[1]), int(match[2])] = match[3]
    read = _read_2 if version.startswith("2") else _read_4
    read(sections, is_binary, size, found)
    return _mesh(found, sections, is_binary)


@dataclass
class _Found:
    """What the sections of a file hold."""

    names: dict[tuple[int, int], str] = field(default_factory=dict)
    """Name of each physical group, by dimension and number."""
    tags: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    """Number of each node in the file (n,)."""
    points: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    cells: dict[int, list[np.ndarray]] = field(default_factory=lambda: defaultdict(list))
    """Cells by type: rows of the element's number and the numbers of its nodes."""
    groups: dict[int, list[tuple[int, np.ndarray]]] = field(default_factory=lambda: defaultdict(list))
    """Members of physical groups by type of cell: number of the group, rows of the cells."""

    def add(self, kind: int, rows: np.ndarray, physical: list[tuple[int, np.ndarray]]) -> None:
        """Add cells of a type, and which of them (indices) are in which group."""
        first = sum(len(block) for block in self.cells[kind])
        self.cells[kind].append(rows)
        self.groups[kind] += [(number, members + first) for number, members in physical]


# ---- version 2


def _read_2(sections: dict[str, list[bytes]], is_binary: bool, _: str, found: _Found) -> None:
    count, _line, rest = sections["Nodes"][0].partition(b"\n")
    found.tags, found.points = numbered_rows(rest, int(count), 3, is_binary)
    n, numbers = counted(sections["Elements"][0], is_binary)
    elements = _binary_2(n, numbers) if is_binary else _text_2(n, numbers)
    by_kind: dict[int, list[np.ndarray]] = defaultdict(list)
    for kind, rows in elements:
        by_kind[kind].append(rows)
    for kind, blocks in by_kind.items():
        table = np.vstack(blocks)
        _add_once(kind, table, found)


def _add_once(kind: int, table: np.ndarray, found: _Found) -> None:
    """Add cells from rows of number, group and nodes; version 2 repeats a cell for each of its groups."""
    nodes, groups = table[:, 2:], table[:, 1]
    _, first, same = np.unique(nodes, axis=0, return_index=True, return_inverse=True)
    repeated = len(first) < len(table) and len(np.unique(np.column_stack([same.ravel(), groups]), axis=0)) == len(table)
    kept = np.sort(first) if repeated else np.arange(len(table))
    place = np.searchsorted(kept, first)[same.ravel()] if repeated else kept
    physical = [(int(number), place[groups == number]) for number in np.unique(groups) if number]
    found.add(kind, table[kept][:, [0, *range(2, table.shape[1])]], physical)


def _text_2(n: int, numbers: Numbers) -> Iterator[tuple[int, np.ndarray]]:
    """Yield type and (number, group, nodes) of each element of a text, runs of equal elements together."""
    values = numbers.take(INT, numbers.left)
    at, window = 0, 1024
    while n > 0:
        if at + 3 > len(values):
            raise ValueError(f"{n} elements are missing")
        kind, n_tags = int(values[at + 1]), int(values[at + 2])
        if n_tags < 0:
            raise ValueError(f"an element has {n_tags} tags")
        width = 3 + n_tags + _cell(kind)[2]
        rows = values[at : at + len(values[at:]) // width * width].reshape(-1, width)[: min(n, window)]
        same = (rows[:, 1] == kind) & (rows[:, 2] == n_tags)
        run = len(same) if same.all() else int(same.argmin())
        if not run:
            raise ValueError(f"{n} elements are missing")
        group = rows[:run, 3] if n_tags else np.zeros(run, int)
        yield kind, np.column_stack([rows[:run, 0], group, rows[:run, 3 + n_tags :]])
        at, n = at + run * width, n - run
        window = 2 * window if run == window else 1024


def _binary_2(n: int, numbers: Numbers) -> Iterator[tuple[int, np.ndarray]]:
    """Yield type and (number, group, nodes) of each block of elements of a binary file."""
    while n > 0:
        kind, count, n_tags = (numbers.one(INT) for _ in range(3))
        width = 1 + n_tags + _cell(kind)[2]
        rows = numbers.take(INT, count * width).reshape(count, width)
        group = rows[:, 1] if n_tags else np.zeros(count, int)
        yield kind, np.column_stack([rows[:, 0], group, rows[:, 1 + n_tags :]])
        if count < 1:
            raise ValueError("a block of elements is empty")
        n -= count


# ---- version 4.1


def _read_4(sections: dict[str, list[bytes]], is_binary: bool, size: str, found: _Found) -> None:
    physical = _entities(sections, is_binary, size)
    numbers = Numbers(sections["Nodes"][0], is_binary)
    n_blocks, n_nodes, _, _ = numbers.take(size, 4).tolist()
    tags, points = [np.zeros(0, int)], [np.zeros((0, 3))]
    for _ in range(n_blocks):
        dimension, _, is_parametric = numbers.take(INT, 3).tolist()
        n = numbers.one(size)
        tags.append(numbers.take(size, n))
        width = 3 + (dimension if is_parametric else 0)
        points.append(numbers.take(REAL, n * width).reshape(n, width)[:, :3])
    found.tags, found.points = np.concatenate(tags), np.vstack(points)
    if len(found.tags) != n_nodes:
        raise ValueError(f"it has {len(found.tags)} of {n_nodes} nodes")
    numbers = Numbers(sections["Elements"][0], is_binary)
    for _ in range(numbers.take(size, 4)[0]):
        dimension, entity, kind = numbers.take(INT, 3).tolist()
        n = numbers.one(size)
        width = 1 + _cell(kind)[2]
        rows = numbers.take(size, n * width).reshape(n, width)
        found.add(kind, rows, [(number, np.arange(n)) for number in physical.get((dimension, entity), [])])


def _entities(sections: dict[str, list[bytes]], is_binary: bool, size: str) -> dict[tuple[int, int], list[int]]:
    """Return the numbers of the physical groups of each entity, by dimension and number of the entity."""
    out: dict[tuple[int, int], list[int]] = {}
    if "Entities" not in sections:
        return out
    numbers = Numbers(sections["Entities"][0], is_binary)
    for dimension, n in enumerate(numbers.take(size, 4).tolist()):
        for _ in range(n):
            entity = numbers.one(INT)
            numbers.take(REAL, 3 if dimension == 0 else 6)  # the box around it
            out[dimension, entity] = [abs(number) for number in numbers.take(INT, numbers.one(size)).tolist()]
            if dimension:
                numbers.take(INT, numbers.one(size))  # the entities around it
    return out


# ---- the mesh


def _cell(kind: int) -> tuple[str, int, int]:
    if kind not in CELLS:
        raise InputError(f"elements of Gmsh's type {kind} are not read; save tetrahedra of 4 or 10 nodes")
    return CELLS[kind]


def _mesh(found: _Found, sections: dict[str, list[bytes]], is_binary: bool) -> meshio.Mesh:
    tables = {kind: np.vstack(blocks) for kind, blocks in found.cells.items()}
    index = Index(found.tags, "node")
    cells = []
    for kind, table in tables.items():
        name = _cell(kind)[0]
        nodes = index.of(table[:, 1:])
        cells.append((name, nodes[:, VTK_ORDER[name]] if name in VTK_ORDER else nodes))
    notes: list[str] = []
    point_data = data_of(sections, "NodeData", [found.tags], is_binary, notes)
    cell_data = data_of(sections, "ElementData", [table[:, 0] for table in tables.values()], is_binary, notes)
    return meshio.Mesh(
        found.points,
        cells,
        point_data={name: blocks[0] for name, blocks in point_data.items()},
        cell_data=cell_data,
        cell_sets=_sets(found),
        info=notes,
    )


def _sets(found: _Found) -> dict[str, list[np.ndarray]]:
    """Return the cells of each physical group, one array for each type of cell."""
    out: dict[str, list[np.ndarray]] = {}
    for place, kind in enumerate(found.cells):
        for number, members in found.groups[kind]:
            dimension = _cell(kind)[1]
            name = found.names.get((dimension, number)) or f"{DIMENSIONS[dimension]} {number}"
            blocks = out.setdefault(name, [np.zeros(0, int) for _ in found.cells])
            blocks[place] = np.union1d(blocks[place], members)
    return out
