"""Meshes of a user's own: read, checked, and turned into arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np

from ..core.errors import InputError
from ..core.units import density_kg_m3, density_kg_mm3, mm_from
from ..geometry.meshing3d import BodyMesh
from ..geometry.tetrahedra import check, unmirrored
from .fields import write_vtu

CELLS = {"tetra": 4, "tetra10": 10}
SURFACES = ("vertex", "line", "line3", "triangle", "triangle6")  # what mesh generators write beside the tetrahedra


@dataclass(frozen=True)
class MeshedBody:
    """A body as its file gives it.

    Parameters
    ----------
    points : (n, 3) array [mm]
        Nodes, in the file's order.
    tetrahedra : (m, 4) or (m, 10) int array
        Corners, then middles of edges.
    is_fixed : (n,) bool array
        Nodes that are held.
    E, nu, density : (m,) arrays [kPa], [1], [kg/mm^3]
        Tissue of each tetrahedron.
    """

    points: np.ndarray
    tetrahedra: np.ndarray
    is_fixed: np.ndarray
    E: np.ndarray
    nu: np.ndarray
    density: np.ndarray


def read_body(path: Path, unit: str) -> MeshedBody:
    """Read a mesh of tetrahedra with its tissue; any format of meshio, such as VTU.

    Parameters
    ----------
    path : Path
        The file, with cell data ``youngs_modulus_kPa``, ``poisson_ratio``, ``density_kg_m3`` and point data ``fixed``.
    unit : {"mm", "cm", "m"}
        Unit of its coordinates.

    Raises
    ------
    InputError
        If the file is no such mesh, or no body can have it; the sentence begins with the file's name.
    """
    try:
        mesh = meshio.read(path)
    except (meshio.ReadError, OSError, ValueError, KeyError, SystemExit) as error:
        raise InputError(f"{path.name} cannot be read as a mesh: {str(error) or type(error).__name__}") from None
    try:
        return _body(mesh, unit)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def write_body(path: Path, mesh: BodyMesh, E: np.ndarray, nu: np.ndarray, density: np.ndarray) -> None:
    """Write what ``read_body`` reads: a mesh with E [kPa], nu [1] and density [kg/mm^3] of its tetrahedra (m,)."""
    tissue = {"youngs_modulus_kPa": E, "poisson_ratio": nu, "density_kg_m3": density_kg_m3(density)}
    is_fixed = np.isin(np.arange(len(mesh.nodes)), mesh.held_nodes)
    write_vtu(path, mesh.nodes, mesh.tetrahedra, {"fixed": is_fixed}, tissue)


def _body(mesh: meshio.Mesh, unit: str) -> MeshedBody:
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
    is_fixed = _fixed(mesh.point_data, len(points))
    check(points, tetrahedra, is_fixed)
    data = {name: _cell_data(mesh, name, kind) for name in ("youngs_modulus_kPa", "poisson_ratio", "density_kg_m3")}
    E, nu, density = data.values()
    _refuse(E <= 0.0, "youngs_modulus_kPa must be above 0", E)
    _refuse((nu < 0.0) | (nu >= 0.5), "poisson_ratio must be at least 0 and below 0.5", nu)
    _refuse(density < 0.0, "density_kg_m3 must be at least 0", density)
    return MeshedBody(points, tetrahedra, is_fixed, E, nu, density_kg_mm3(density))


def _fixed(point_data: Mapping[str, np.ndarray], n: int) -> np.ndarray:
    if "fixed" not in point_data:
        raise InputError("point data `fixed` (1 where a node is held, else 0) are missing")
    values = np.asarray(point_data["fixed"]).reshape(n, -1)[:, 0]
    if not np.isin(values, (0, 1)).all():
        raise InputError("point data `fixed` must be 0 or 1")
    return values == 1


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
