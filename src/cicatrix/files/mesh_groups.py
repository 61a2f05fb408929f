"""Groups of a mesh by name: physical groups of Gmsh, sets and surfaces of Abaqus, pieces of a VTU file, references of Medit."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

import meshio
import numpy as np

from ..core.errors import InputError

TRIANGLES = ("triangle", "triangle6")
SHOWN = 12  # names in a message at most


@dataclass(frozen=True)
class Groups:
    """Nodes and tetrahedra of the groups of a mesh."""

    nodes: dict[str, np.ndarray]
    """Nodes of each group, those of its cells if the file does not list them."""
    tetrahedra: dict[str, np.ndarray]
    """Tetrahedra of each group that has some."""
    faces: dict[str, np.ndarray]
    """Corners of the triangles of each group that has some (k, 3)."""
    n_nodes: int

    def marked(self, names: Iterable[str], key: str) -> np.ndarray:
        """Return which nodes are in one of the groups (n_nodes,) bool; ``key`` is the key of the case that names them."""
        out = np.zeros(self.n_nodes, bool)
        for name in names:
            out[self._found(name, self.nodes, key)] = True
        return out

    def members(self, name: str, key: str) -> np.ndarray:
        """Return the tetrahedra of a group, as indices."""
        if name in self.nodes and name not in self.tetrahedra:
            raise InputError(f'{key} names "{name}", a group without tetrahedra; {self._listed(self.tetrahedra)}')
        return self._found(name, self.tetrahedra, key)

    def hint(self) -> str:
        """Return words on the groups of the file; an empty text if it has none."""
        return self._listed(self.nodes) if self.nodes else ""

    def _found(self, name: str, known: dict[str, np.ndarray], key: str) -> np.ndarray:
        if name in known:
            return known[name]
        by_lower = {other.lower(): other for other in known}
        near = difflib.get_close_matches(name.lower(), by_lower, n=1)
        hint = f'; did you mean "{by_lower[near[0]]}"?' if near else f"; {self._listed(known)}"
        raise InputError(f'{key} names "{name}", but the file has no such group{hint}')

    @staticmethod
    def _listed(known: dict[str, np.ndarray]) -> str:
        if not known:
            return "the file has no groups"
        names = [f'"{name}"' for name in known]
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        return f"the file has the groups {', '.join(names[:SHOWN])}{more}"


def groups_of(mesh: meshio.Mesh, kind: str) -> Groups:
    """Return the groups of a mesh whose tetrahedra are the blocks of type ``kind``."""
    nodes: dict[str, np.ndarray] = {}
    tetrahedra: dict[str, np.ndarray] = {}
    faces: dict[str, np.ndarray] = {}
    for name, sets in mesh.cell_sets.items():
        members = [np.asarray([] if one is None else one, int) for one in sets]
        used = [block.data[rows].ravel() for block, rows in zip(mesh.cells, members)]
        nodes[name] = np.unique(np.concatenate(used)).astype(int)
        triangles = [b.data[rows][:, :3] for b, rows in zip(mesh.cells, members) if b.type in TRIANGLES and rows.size]
        if triangles:
            faces[name] = np.vstack(triangles)
        blocks = [(rows, len(block)) for block, rows in zip(mesh.cells, members) if block.type == kind]
        starts = np.cumsum([0, *(n for _, n in blocks)])
        inside = np.concatenate([rows + start for (rows, _), start in zip(blocks, starts)])
        if inside.size:
            tetrahedra[name] = inside
    nodes |= {name: np.asarray(members, int) for name, members in mesh.point_sets.items()}
    return Groups(nodes, tetrahedra, faces, len(mesh.points))
