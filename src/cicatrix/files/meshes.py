"""Read meshes supplied by the user, check them, and convert them to arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import meshio
import numpy as np

from ..core.errors import InputError
from ..core.units import density_kg_m3, density_kg_mm3, mm_from
from ..geometry.tetrahedra import check, check_coordinates, unmirrored
from .mesh_formats import read_mesh
from .mesh_groups import Groups, groups_of
from .mesh_supports import check_faces, displacement_of, followed, marks, more_faces
from .mesh_tissue import Tissue, cell_data, refuse, tissue_of
from .vtu import write_vtu

if TYPE_CHECKING:
    from ..geometry.meshing3d import BodyMesh

CELLS = {"tetra": 4, "tetra10": 10}
T = TypeVar("T")
SURFACES = ("vertex", "line", "line3", "triangle", "triangle6")  # other cells that mesh generators write
COARSE = 1e-4  # rounding of coordinates over the mesh's extent that is told


@dataclass(frozen=True)
class ByGroup:
    """What a case gives to groups of the mesh, by their names; it goes before the data in the file."""

    fixed: tuple[str, ...] = ()
    sliding: tuple[str, ...] = ()
    pressurised: tuple[str, ...] = ()
    wound: tuple[str, ...] = ()
    displacement: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """Prescribed displacement of the nodes of a group, which are fixed there [mm]."""
    materials: Mapping[str, Tissue] = field(default_factory=dict)


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
    notes : tuple of str
        What was assumed about the file.
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
    notes: tuple[str, ...] = ()


def read_body(
    path: Path, unit: str, elastic: tuple[float, float] | None = None, by_group: ByGroup | None = None
) -> MeshedBody:
    """Read a mesh of tetrahedra with its tissue; the formats of :func:`.mesh_formats.read_mesh`, such as VTU.

    Parameters
    ----------
    path : Path
        The file, with cell data ``youngs_modulus_kPa``, ``poisson_ratio``, ``density_kg_m3`` and point data ``fixed``, and
        optionally point data ``prescribed_displacement`` [mm], ``sliding`` and ``pressurised``.
    unit : {"mm", "cm", "m"}
        Unit of the coordinates.
    elastic : (float, float), optional
        Young's modulus [kPa] and Poisson's ratio of the whole body, used instead of those in the file.
    by_group : ByGroup, optional
        Supports, loads and tissue of groups of the file, used instead of its data.

    Raises
    ------
    InputError
        If the file is not such a mesh, or the mesh is not valid for a body; the message begins with the file's name.
    """
    return _read(path, lambda mesh: _body(mesh, unit, elastic, by_group or ByGroup()))


def read_wound(path: Path, unit: str, by_group: ByGroup | None = None) -> tuple[TetrahedralMesh, np.ndarray]:
    """Read a mesh of tetrahedra with a wound; return it, and whether each tetrahedron belongs to the wound (m,) bool.

    The file has cell data ``wound`` and point data ``fixed``, both 0 or 1, or groups of cells and nodes that ``by_group`` names.

    Raises
    ------
    InputError
        If the file is not such a mesh, or the mesh is not valid for a body; the message begins with the file's name.
    """
    return _read(path, lambda mesh: _wound(mesh, unit, by_group or ByGroup()))


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
    groups: Groups
    notes: tuple[str, ...]


# ---- geometry and supports


def _tetrahedral_mesh(mesh: meshio.Mesh, unit: str, by_group: ByGroup) -> TetrahedralMesh:
    kind = _kind(mesh)
    points = mm_from(np.asarray(mesh.points, float), unit)
    if points.shape[1:] != (3,):
        raise InputError("the nodes must have three coordinates")
    check_coordinates(points)
    tetrahedra = np.vstack([block.data for block in mesh.cells if block.type == kind]).astype(int)
    wrong = tetrahedra[(tetrahedra < 0) | (tetrahedra >= len(points))]
    if wrong.size:
        raise InputError(f"a tetrahedron names node {wrong[0]}, but the nodes are 0 to {len(points) - 1}")
    tetrahedra = unmirrored(points, tetrahedra)
    groups, notes = groups_of(mesh, kind), [*(mesh.info or ()), *_rounding(mesh.points, unit)]
    is_moved = groups.marked(by_group.displacement, "body.displacement_mm")
    is_fixed = is_moved | marks(mesh, "fixed", groups, by_group.fixed, notes)
    if "fixed" not in mesh.point_data and not (by_group.fixed or by_group.displacement or by_group.sliding):
        hint = f'; name the group of fixed nodes, body.fixed = "NAME": {groups.hint()}' if groups.hint() else ""
        raise InputError(f"point data `fixed` (1 where a node is fixed, else 0) are missing{hint}")
    return TetrahedralMesh(points, tetrahedra, is_fixed, kind, groups, tuple(notes))


def _kind(mesh: meshio.Mesh) -> str:
    """Return the type of the tetrahedra, the only cells with a volume that the mesh may have."""
    counts: dict[str, int] = {}
    for block in mesh.cells:
        counts[block.type] = counts.get(block.type, 0) + len(block)
    kinds = {kind for kind, n in counts.items() if n}
    wrong, solid = kinds - CELLS.keys() - set(SURFACES), kinds & CELLS.keys()
    if not wrong and len(solid) == 1:
        return min(solid)
    found = ", ".join(sorted(kinds)) or "no cells"
    if kinds and kinds <= {*SURFACES, "quad", "quad8", "quad9"}:
        remedy = "it is a surface without a volume: fill it with tetrahedra, in Gmsh for instance"
    elif wrong and solid:
        first = min(wrong)
        remedy = f"divide those of type {first} ({counts[first]}) into tetrahedra"
    else:
        remedy = "make all cells of one type" if solid else "mesh the body with tetrahedra"
    raise InputError(f"the cells must be tetrahedra of 4 nodes, or of 10; the file has {found}: {remedy}")


def _rounding(points: np.ndarray, unit: str) -> list[str]:
    """Return a note if the file's own number type rounds the coordinates much."""
    points = np.asarray(points)
    if points.dtype != np.float32 or not points.size or not np.isfinite(points).all():
        return []
    step = float(np.spacing(np.abs(points).max()))
    if step <= COARSE * float(np.ptp(points.astype(float), axis=0).max()):
        return []
    coarse = float(mm_from(np.array(step), unit))
    return [f"The coordinates are in single precision: this far from the origin they are rounded to {coarse:.2g} mm."]


# ---- wound and body


def _wound(mesh: meshio.Mesh, unit: str, by_group: ByGroup) -> tuple[TetrahedralMesh, np.ndarray]:
    solid = _tetrahedral_mesh(mesh, unit, by_group)
    check(solid.points, solid.tetrahedra, solid.is_fixed, np.zeros_like(solid.is_fixed))
    is_fixed, _, notes = followed(solid.is_fixed, solid.tetrahedra, np.zeros_like(solid.points))
    solid = solid._replace(is_fixed=is_fixed, notes=(*solid.notes, *notes))
    if by_group.wound:
        marked = np.zeros(len(solid.tetrahedra))
        for name in by_group.wound:
            marked[solid.groups.members(name, "body.wound")] = 1
    else:
        hint = (
            f'; name the group of the wound, body.wound = "NAME": {solid.groups.hint()}' if solid.groups.hint() else ""
        )
        marked = cell_data(mesh, "wound", solid.kind)
        if marked is None:
            raise InputError(f"cell data `wound` are missing{hint}")
    refuse(~np.isin(marked, (0, 1)), "wound must be 0 or 1", marked)
    if marked.all() or not marked.any():
        raise InputError("cell data `wound` must be 1 in some tetrahedra, those of the wound, and 0 in others")
    return solid, marked == 1


def _body(mesh: meshio.Mesh, unit: str, elastic: tuple[float, float] | None, by_group: ByGroup) -> MeshedBody:
    solid = _tetrahedral_mesh(mesh, unit, by_group)
    notes = list(solid.notes)
    is_sliding = marks(mesh, "sliding", solid.groups, by_group.sliding, notes)
    is_pressurised = marks(mesh, "pressurised", solid.groups, by_group.pressurised, notes)
    check(solid.points, solid.tetrahedra, solid.is_fixed, is_sliding)
    for name, names, is_marked in (
        ("sliding", by_group.sliding, is_sliding),
        ("pressurised", by_group.pressurised, is_pressurised),
    ):
        subject = f"the groups of body.{name}" if names else f"point data `{name}`"
        check_faces(subject, is_marked, solid.tetrahedra)
        notes += more_faces(f"body.{name}", names, solid.groups, solid.tetrahedra)
    displacement = displacement_of(mesh, solid.is_fixed, solid.groups, by_group.displacement)
    is_fixed, displacement, more = followed(solid.is_fixed, solid.tetrahedra, displacement)
    if is_fixed[solid.tetrahedra[:, :4]].all():
        more.append("All nodes are fixed, so that the body keeps the shape that it is given: fix its supports alone.")
    E, nu, density = tissue_of(mesh, solid.kind, solid.groups, by_group.materials, elastic)
    return MeshedBody(
        *(solid.points, solid.tetrahedra, is_fixed, displacement, is_sliding, is_pressurised),
        *(E, nu, density_kg_mm3(density)),
        (*notes, *more),
    )
