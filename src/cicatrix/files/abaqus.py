"""Read meshes of Abaqus and CalculiX (``.inp``), with sets of nodes and elements and surfaces of elements.

Read are ``*NODE``, ``*ELEMENT``, ``*NSET``, ``*ELSET``, ``*SURFACE`` and ``*INCLUDE``; materials, loads and steps are left out.

Source: Abaqus Keywords Reference; CalculiX CrunchiX User's Manual, "Input deck format".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

from ..core.errors import InputError
from .numerals import without_underscore
from .opening import bytes_of
from .voxels import numbers_in

TYPES = (  # beginning of the name of an element type: name in meshio, number of nodes
    (r"C3D4", "tetra", 4),
    (r"C3D10", "tetra10", 10),
    (r"C3D8", "hexahedron", 8),
    (r"C3D20", "hexahedron20", 20),
    (r"C3D6", "wedge", 6),
    (r"C3D15", "wedge15", 15),
    (r"(S|M3D|R3D|SFM3D|CPS|CPE|CAX|DS)3(?!\d)", "triangle", 3),
    (r"(STRI65|(S|M3D|SFM3D|CPS|CPE|CAX|DS)6(?!\d))", "triangle6", 6),
    (r"(S|M3D|R3D|SFM3D|CPS|CPE|CAX)4(?!\d)", "quad", 4),
    (r"(S|M3D|SFM3D|CPS|CPE|CAX)8(?!\d)", "quad8", 8),
    (r"(T2D2|T3D2|B21|B31|R2D2)", "line", 2),
    (r"(T2D3|T3D3|B22|B32)", "line3", 3),
)
FACES = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}  # corners of the faces of a tetrahedron
GENERATING = ("NGEN", "NFILL", "NCOPY", "ELGEN", "ELCOPY", "SYSTEM", "NMAP")  # keywords that make or move nodes
LARGEST_SET = 100_000_000
DEPTH = 8  # files that include each other


class _Block(NamedTuple):
    """A keyword with its parameters, and the lines of data after it."""

    keyword: str
    parameters: dict[str, str]
    rows: list[list[str]]
    at: str
    """File and line of the keyword, for messages."""


@dataclass
class _Found:
    """What a file defines; names are in capitals, as Abaqus does not tell them apart."""

    nodes: dict[int, list[float]] = field(default_factory=dict)
    elements: dict[int, tuple[str, list[int]]] = field(default_factory=dict)
    """Type in meshio and nodes of each element."""
    node_sets: dict[str, list[int]] = field(default_factory=dict)
    element_sets: dict[str, list[int]] = field(default_factory=dict)
    surfaces: dict[str, list[int]] = field(default_factory=dict)
    """Corners of the faces of each surface."""
    written: dict[str, str] = field(default_factory=dict)
    """Each name as it is first written."""
    notes: list[str] = field(default_factory=list)

    def key(self, name: str) -> str:
        """Return a name in capitals, and remember how it is written."""
        name = name.strip().strip('"')
        self.written.setdefault(name.upper(), name)
        return name.upper()


def is_abaqus(head: bytes) -> bool:
    """Return whether a file that begins with ``head`` has a keyword of Abaqus in its first lines."""
    return re.match(rb"\s*(\*\*[^\n]*\n\s*)*\*[A-Za-z]", head) is not None


def read_abaqus(path: Path) -> meshio.Mesh:
    """Read a mesh; sets of nodes and corners of surfaces become point sets, sets of elements cell sets.

    Raises
    ------
    InputError
        If the file cannot be read; the message is about the file, without its name.
    """
    found, n_parts = _Found(), 0
    for block in _blocks(path, DEPTH):
        n_parts += block.keyword == "PART"
        if n_parts > 1:
            raise InputError(f"it has several parts, the second at {block.at}; a body is one part: export one part")
        if block.keyword in GENERATING:
            raise InputError(f"*{block.keyword} at {block.at} is not read; write out every node and element")
        if block.keyword in READERS:
            try:
                READERS[block.keyword](block, found)
            except (ValueError, IndexError, OverflowError) as error:
                raise InputError(f"*{block.keyword} at {block.at} is damaged: {error}") from None
    return _mesh(found)


# ---- lines to blocks


def _blocks(path: Path, depth: int) -> Iterator[_Block]:
    """Yield the blocks of a file, and of the files that it includes at their places."""
    block = None
    for number, line in _lines(path):
        if not line.startswith("*"):
            if block is not None:
                block.rows.append([part.strip() for part in line.split(",")])
            continue
        if block is not None:
            yield block
        block = _block(line, f"{path.name}:{number}")
        if block.keyword == "INCLUDE":
            if not depth:
                raise InputError(f"{block.at}: files include each other more than {DEPTH} deep")
            yield from _blocks(path.parent / block.parameters.get("INPUT", "").strip('"'), depth - 1)
            block = None
    if block is not None:
        yield block


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line that is no comment; keyword lines that end with a comma are joined with the next."""
    held = ""
    for number, line in enumerate(bytes_of(path).decode("utf-8-sig", "replace").splitlines(), 1):
        text = line.strip()
        if not text or text.startswith("**"):
            continue
        text = held + text
        held = text if text.startswith("*") and text.endswith(",") else ""
        if not held:
            yield number, text


def _block(line: str, at: str) -> _Block:
    keyword, *parts = line[1:].split(",")
    pairs = [part.partition("=") for part in parts]
    parameters = {key.strip().upper(): value.strip() for key, _, value in pairs}
    return _Block("".join(keyword.upper().split()), parameters, [], at)


# ---- blocks to nodes, elements and sets


def _whole(text: str) -> int:
    return int(without_underscore(text))


def _node(block: _Block, found: _Found) -> None:
    added = []
    for row in block.rows:
        number = _whole(row[0])
        found.nodes[number] = numbers_in(text or "0" for text in [*row[1:4], "", ""][:3])
        added.append(number)
    if "NSET" in block.parameters:
        found.node_sets.setdefault(found.key(block.parameters["NSET"]), []).extend(added)


def _element(block: _Block, found: _Found) -> None:
    name = block.parameters.get("TYPE", "").upper()
    known = [(kind, size) for pattern, kind, size in TYPES if re.match(pattern + r"(?!\d)", name)]
    if not known:
        raise InputError(f"elements of type {name or '(none)'} at {block.at} are not read; use C3D4 or C3D10")
    (kind, size), *_ = known
    numbers = [_whole(text) for row in block.rows for text in row if text]
    if len(numbers) % (size + 1):
        raise ValueError(f"each element of type {name} needs its number and {size} nodes")
    rows = [numbers[at : at + size + 1] for at in range(0, len(numbers), size + 1)]
    found.elements |= {row[0]: (kind, row[1:]) for row in rows}
    if "ELSET" in block.parameters:
        found.element_sets.setdefault(found.key(block.parameters["ELSET"]), []).extend(row[0] for row in rows)


def _members(block: _Block, sets: Mapping[str, list[int]]) -> list[int]:
    """Return the numbers in a set: given one by one, from first to last, or by the names of other sets."""
    if "GENERATE" in block.parameters:
        spans = [[_whole(text) for text in row if text] for row in block.rows]
        ranges = [range(first, last + 1, *(step or [1])) for first, last, *step in spans]
        if sum(map(len, ranges)) > LARGEST_SET:
            raise ValueError(f"it generates more than {LARGEST_SET} members")
        return [number for numbers in ranges for number in numbers]
    out: list[int] = []
    for text in (text for row in block.rows for text in row if text):
        name = text.strip('"').rpartition(".")[2].upper()
        if not re.fullmatch(r"[+-]?\d+", name) and name not in sets:
            raise ValueError(f"there is no set {text}")
        out += sets[name] if name in sets else [int(name)]
    return out


def _nset(block: _Block, found: _Found) -> None:
    name = found.key(block.parameters.get("NSET", ""))
    members = found.node_sets.setdefault(name, [])
    if "ELSET" in block.parameters:
        elements = found.element_sets.get(found.key(block.parameters["ELSET"]), [])
        members += [node for element in elements if element in found.elements for node in found.elements[element][1]]
    else:
        members += _members(block, found.node_sets)


def _elset(block: _Block, found: _Found) -> None:
    found.element_sets.setdefault(found.key(block.parameters.get("ELSET", "")), []).extend(
        _members(block, found.element_sets)
    )


def _surface(block: _Block, found: _Found) -> None:
    """Read a surface of faces of tetrahedra, or of nodes; other surfaces are left out."""
    name = found.key(block.parameters.get("NAME", ""))
    if block.parameters.get("TYPE", "ELEMENT").upper() == "NODE":
        rows = [row[:1] for row in block.rows]
        found.node_sets.setdefault(name, []).extend(_members(block._replace(rows=rows), found.node_sets))
        return
    corners = found.surfaces.setdefault(name, [])
    for row in block.rows:
        face = FACES.get(row[1].upper() if len(row) > 1 else "")
        for number in _members(block._replace(rows=[row[:1]]), found.element_sets):
            kind, nodes = found.elements.get(number, ("", []))
            if face and kind.startswith("tetra"):
                corners += [nodes[k] for k in face]


def _instance(block: _Block, found: _Found) -> None:
    if any(float(text) for row in block.rows for text in row if text):
        found.notes.append(f"*INSTANCE at {block.at} moves the part; the part is taken where its nodes are.")


READERS = {
    "NODE": _node,
    "ELEMENT": _element,
    "NSET": _nset,
    "ELSET": _elset,
    "SURFACE": _surface,
    "INSTANCE": _instance,
}


# ---- the mesh


def _mesh(found: _Found) -> meshio.Mesh:
    if not found.nodes or not found.elements:
        raise InputError(f"it has no *{'ELEMENT' if found.nodes else 'NODE'}")
    place = {number: k for k, number in enumerate(found.nodes)}
    kinds = list(dict.fromkeys(kind for kind, _ in found.elements.values()))
    rows: dict[str, list[list[int]]] = {kind: [] for kind in kinds}
    where: dict[int, tuple[int, int]] = {}  # block and row of each element
    for number, (kind, nodes) in found.elements.items():
        unknown = [node for node in nodes if node not in place]
        if unknown:
            raise InputError(f"element {number} names node {unknown[0]}, which it does not have")
        where[number] = kinds.index(kind), len(rows[kind])
        rows[kind].append([place[node] for node in nodes])
    at_nodes = {
        found.written[name]: np.unique(np.array([place[n] for n in members if n in place], int))
        for name, members in (found.surfaces | found.node_sets).items()
    }
    in_cells = {
        found.written[name]: [
            np.unique([where[e][1] for e in members if e in where and where[e][0] == k]).astype(int)
            for k in range(len(kinds))
        ]
        for name, members in found.element_sets.items()
    }
    for sets, known, what in ((found.node_sets, place, "nodes"), (found.element_sets, where, "elements")):
        for name, members in sets.items():
            if absent := [number for number in members if number not in known]:
                words = f"{len(absent)} {what} that the file does not have, such as {absent[0]}"
                found.notes.append(f'The set "{found.written[name]}" names {words}; they are left out.')
    cells = [(kind, np.array(rows[kind])) for kind in kinds]
    return meshio.Mesh(
        np.array(list(found.nodes.values())), cells, point_sets=at_nodes, cell_sets=in_cells, info=found.notes
    )
