"""Read meshes supplied by the user, check them, and convert them to arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import meshio
import numpy as np

from ..core.errors import InputError
from ..core.units import density_kg_m3, density_kg_mm3, mm_from
from ..geometry.tetrahedra import boundary, check, unmirrored
from .vtu import read_mesh, write_vtu

if TYPE_CHECKING:
    from ..geometry.meshing3d import BodyMesh

CELLS = {"tetra": 4, "tetra10": 10}
T = TypeVar("T")
SURFACES = ("vertex", "line", "line3", "triangle", "triangle6")  # other cells that mesh generators write


@dataclass(frozen=True)
class MeshedBody:
    """A body as read from its file.

    Parameters
    ----------
    points : (n, 3) array [mm]
        Nodes, in the file's order.
    tetrahedra : (m, 4) or (m, 10) int array
        Corners, then midpoints of edges.
    is_fixed : (n,) bool array
        Whether each node is constrained.
    displacement : (n, 3) array [mm]
        Prescribed displacement of constrained nodes; 0 at the others.
    is_sliding, is_pressurised : (n,) bool arrays
        Corners of boundary faces that slide along themselves, and of those that carry pressure.
    E, nu, density : (m,) arrays [kPa], [1], [kg/mm^3]
        Tissue of each tetrahedron.
    """

    points: np.ndarray
    tetrahedra: np.ndarray
    is_fixed: np.ndarray
    displacement: np.ndarray
    is_sliding: np.ndarray
    is_pressurised: np.ndarray
    E: np.ndarray
    nu: np.ndarray
    density: np.ndarray


def read_body(path: Path, unit: str, elastic: tuple[float, float] | None = None) -> MeshedBody:
    """Read a mesh of tetrahedra with its tissue; any format of meshio, such as VTU.

    Parameters
    ----------
    path : Path
        The file, with cell data ``youngs_modulus_kPa``, ``poisson_ratio``, ``density_kg_m3`` and point data ``fixed``, and
        optionally point data ``prescribed_displacement`` [mm], ``sliding`` and ``pressurised``.
    unit : {"mm", "cm", "m"}
        Unit of the coordinates.
    elastic : (float, float), optional
        Young's modulus [kPa] and Poisson's ratio of the whole body, used instead of those in the file.

    Raises
    ------
    InputError
        If the file is not such a mesh, or the mesh is not valid for a body; the message begins with the file's name.
    """
    return _read(path, lambda mesh: _body(mesh, unit, elastic))


def read_wound(path: Path, unit: str) -> tuple[TetrahedralMesh, np.ndarray]:
    """Read a mesh of tetrahedra with a wound; return it, and whether each tetrahedron belongs to the wound (m,) bool.

    The file has cell data ``wound`` and point data ``fixed``, both 0 or 1.

    Raises
    ------
    InputError
        If the file is not such a mesh, or the mesh is not valid for a body; the message begins with the file's name.
    """
    return _read(path, lambda mesh: _wound(mesh, unit))


def _read(path: Path, of: Callable[[meshio.Mesh], T]) -> T:
    """Read a mesh and convert it with the function ``of``; error messages begin with the file's name."""
    mesh = read_mesh(path)
    try:
        return of(mesh)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def write_body(path: Path, mesh: BodyMesh, E: np.ndarray, nu: np.ndarray, density: np.ndarray) -> None:
    """Write a file for ``read_body``: a mesh with E [kPa], nu [1] and density [kg/mm^3] of its tetrahedra (m,)."""
    tissue = {"youngs_modulus_kPa": E, "poisson_ratio": nu, "density_kg_m3": density_kg_m3(density)}
    is_fixed = np.isin(np.arange(len(mesh.nodes)), mesh.constrained_nodes)
    write_vtu(path, mesh.nodes, mesh.tetrahedra, {"fixed": is_fixed}, tissue)


class TetrahedralMesh(NamedTuple):
    """Tetrahedra of a file, and their constrained nodes."""

    points: np.ndarray
    """Nodes, in the file's order (n, 3) [mm]."""
    tetrahedra: np.ndarray
    """Corners, then midpoints of edges (m, 4) or (m, 10)."""
    is_fixed: np.ndarray
    """Whether each node is constrained (n,) bool."""
    kind: str
    """Name of the cell type in meshio."""


def _tetrahedral_mesh(mesh: meshio.Mesh, unit: str) -> TetrahedralMesh:
    kinds = {block.type for block in mesh.cells}
    wrong = sorted(kinds - CELLS.keys() - set(SURFACES))
    if wrong or len(kinds & CELLS.keys()) != 1:
        found = ", ".join(sorted(kinds)) or "no cells"
        raise InputError(f"the cells must be tetrahedra of 4 nodes, or of 10; the file has {found}")
    (kind,) = kinds & CELLS.keys()
    points = mm_from(np.asarray(mesh.points, float), unit)
    if points.shape[1:] != (3,):
        raise InputError("the nodes must have three coordinates")
    tetrahedra = unmirrored(points, np.vstack([block.data for block in mesh.cells if block.type == kind]).astype(int))
    if "fixed" not in mesh.point_data:
        raise InputError("point data `fixed` (1 where a node is fixed, else 0) are missing")
    return TetrahedralMesh(points, tetrahedra, _marked(mesh.point_data, "fixed", len(points)), kind)


def _wound(mesh: meshio.Mesh, unit: str) -> tuple[TetrahedralMesh, np.ndarray]:
    solid = _tetrahedral_mesh(mesh, unit)
    check(solid.points, solid.tetrahedra, solid.is_fixed, np.zeros_like(solid.is_fixed))
    marked = _cell_data(mesh, "wound", solid.kind)
    _refuse(~np.isin(marked, (0, 1)), "wound must be 0 or 1", marked)
    if marked.all() or not marked.any():
        raise InputError("cell data `wound` must be 1 in some tetrahedra, those of the wound, and 0 in others")
    return solid, marked == 1


def _body(mesh: meshio.Mesh, unit: str, elastic: tuple[float, float] | None) -> MeshedBody:
    points, tetrahedra, is_fixed, kind = _tetrahedral_mesh(mesh, unit)
    is_sliding, is_pressurised = (_marked(mesh.point_data, name, len(points)) for name in ("sliding", "pressurised"))
    check(points, tetrahedra, is_fixed, is_sliding)
    _check_faces("sliding", is_sliding, tetrahedra)
    _check_faces("pressurised", is_pressurised, tetrahedra)
    displacement = _displacement(mesh.point_data, is_fixed)
    density = _cell_data(mesh, "density_kg_m3", kind)
    if elastic is None:
        E, nu = (_cell_data(mesh, name, kind) for name in ("youngs_modulus_kPa", "poisson_ratio"))
    else:
        E, nu = (np.full(len(density), value) for value in elastic)
    _refuse(E <= 0.0, "youngs_modulus_kPa must be above 0", E)
    _refuse((nu < 0.0) | (nu >= 0.5), "poisson_ratio must be at least 0 and below 0.5", nu)
    _refuse(density <= 0.0, "density_kg_m3 must be above 0", density)
    return MeshedBody(
        points, tetrahedra, is_fixed, displacement, is_sliding, is_pressurised, E, nu, density_kg_mm3(density)
    )


def _marked(point_data: Mapping[str, np.ndarray], name: str, n: int) -> np.ndarray:
    """Return whether the point data ``name`` mark each of n nodes by 1 (n,) bool; all False if the file lacks these data."""
    values = np.asarray(point_data.get(name, np.zeros(n)))
    if values.size != n or not np.isin(values, (0, 1)).all():
        raise InputError(f"point data `{name}` must be 0 or 1")
    return values.reshape(n) == 1


def _displacement(point_data: Mapping[str, np.ndarray], is_fixed: np.ndarray) -> np.ndarray:
    """Read the prescribed displacement of nodes (n, 3) [mm]."""
    name = "prescribed_displacement"
    values = np.asarray(point_data.get(name, np.zeros((len(is_fixed), 3))), float)
    if values.shape != (len(is_fixed), 3):
        raise InputError(f"point data `{name}` must have three components [mm]")
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise InputError(f"point data `{name}` must be finite numbers; node {bad[0]} has {values[bad[0]].tolist()}")
    loose = np.flatnonzero(values.any(axis=1) & ~is_fixed)
    if loose.size:
        raise InputError(
            f"point data `{name}` move {loose.size} nodes that are not fixed, the first is node {loose[0]}: set `fixed` = 1 there"
        )
    return values


def _check_faces(name: str, is_marked: np.ndarray, tetrahedra: np.ndarray) -> None:
    """Refuse marked nodes that belong to no boundary face with three marked corners."""
    faces = boundary(tetrahedra[:, :4])
    lonely = is_marked.copy()
    lonely[faces[is_marked[faces].all(axis=1)]] = False
    lonely[np.setdiff1d(np.arange(len(lonely)), tetrahedra[:, :4])] = False  # marks of midpoints are ignored
    if lonely.any():
        raise InputError(
            f"point data `{name}` mark {np.count_nonzero(lonely)} nodes that are on no boundary face with all three corners "
            f"marked, the first is node {np.flatnonzero(lonely)[0]}: mark whole faces"
        )


def _cell_data(mesh: meshio.Mesh, name: str, kind: str) -> np.ndarray:
    if name not in mesh.cell_data:
        raise InputError(f"cell data `{name}` are missing")
    blocks = [values for values, block in zip(mesh.cell_data[name], mesh.cells) if block.type == kind]
    values = np.concatenate([np.asarray(block, float).reshape(len(block), -1)[:, 0] for block in blocks])
    _refuse(~np.isfinite(values), f"{name} must be a finite number", values)
    return values


def _refuse(is_wrong: np.ndarray, sentence: str, values: np.ndarray) -> None:
    wrong = np.flatnonzero(is_wrong)
    if wrong.size:
        raise InputError(f"cell data {sentence}; got {values[wrong[0]]:g} at cell {wrong[0]}")
