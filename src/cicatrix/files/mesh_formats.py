"""Read a mesh in any format: the content says which reader; what has no reader of its own is given to meshio."""

from __future__ import annotations

import io
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import meshio
import numpy as np

from ..core.errors import InputError
from .abaqus import is_abaqus, read_abaqus
from .gmsh import DIMENSIONS, gmsh_mesh, is_gmsh
from .opening import bytes_of, regular_file
from .vtk_xml import is_vtk_xml, read_vtk_xml

HEAD = 4096  # bytes by which a format is told
READ = "VTU and PVTU, legacy VTK, Gmsh (.msh), Abaqus (.inp) and Medit (.mesh)"
SIGNS = {  # first bytes of formats that hold no mesh of tetrahedra, or that are not read; what to do
    b"<febio_spec": "it is a file of FEBio, which is not read; export the mesh from FEBio Studio as VTK",
    b"ISO-10303-21": "it is a geometry in STEP format without a mesh; mesh it with tetrahedra, in Gmsh for instance",
    b"\x89PNG": "it is a picture",
    b"\x1f\x8b\x08": "it is compressed by gzip; unpack it first",
    b"PK\x03\x04": "it is a ZIP archive; unpack it first",
}
PACKAGES = {"h5py": "h5py", "netCDF4": "netCDF4"}  # modules that meshio needs for some formats: package to install


def read_mesh(path: Path) -> meshio.Mesh:
    """Read a mesh with its data and groups.

    Returns
    -------
    meshio.Mesh
        Groups of nodes are in ``point_sets`` (indices of nodes), groups of cells in ``cell_sets`` (indices in each block of
        cells); ``info`` is a list of notes on what was assumed.

    Raises
    ------
    InputError
        If the file cannot be read as a mesh; the message begins with the file's name.
    """
    with regular_file(path).open("rb") as stream:
        head = stream.read(HEAD)
    try:
        return _read(path, head)
    except InputError as error:
        raise InputError(f"{path.name} cannot be read as a mesh: {error}") from None
    except (ValueError, LookupError, ArithmeticError, MemoryError, RecursionError) as error:
        raise InputError(f"{path.name} cannot be read as a mesh: its content is damaged, {error}") from None


def _read(path: Path, head: bytes) -> meshio.Mesh:
    for sign, words in SIGNS.items():
        if sign in head[: 512 if len(sign) > 4 else len(sign)]:
            raise InputError(words)
    if not head.strip():
        raise InputError("it is empty")
    if is_vtk_xml(head) or path.suffix.lower() in (".vtu", ".pvtu"):
        return read_vtk_xml(path)
    if is_gmsh(head):
        return gmsh_mesh(bytes_of(path))
    if path.suffix.lower() == ".inp" or is_abaqus(head):
        return read_abaqus(path)
    return _by_meshio(path, "vtk" if head.startswith(b"# vtk DataFile") else None)


def _by_meshio(path: Path, form: str | None) -> meshio.Mesh:
    if form is None and path.suffix.lower() not in meshio.extension_to_filetypes:
        raise InputError(f"its content is no format that is known; read are {READ}")
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()), warnings.catch_warnings(action="ignore"):
            mesh = meshio.read(path, form)  # it prints errors and then exits, and tries formats until one does not fail
    except ModuleNotFoundError as error:
        raise InputError(_package(path, error.name or "")) from None
    except (Exception, SystemExit) as error:
        raise InputError(_words(error)) from None
    mesh.cell_sets |= _groups_by_number(mesh)
    mesh.info = []
    return mesh


def _package(path: Path, module: str) -> str:
    name = PACKAGES.get(module.partition(".")[0], module)
    return f"files that end in {path.suffix} need the package {name}: pip install {name}, or save the mesh as VTU"


def _words(error: BaseException) -> str:
    """Return the first line of what meshio says."""
    said = str(error).strip().splitlines()
    number = isinstance(error, SystemExit) or not said or said[0].isdecimal()
    return "its content does not have the format of its name" if number else f"it is damaged, {said[0]}"


def _groups_by_number(mesh: meshio.Mesh) -> dict[str, list[np.ndarray]]:
    """Return the groups of cells that have numbers, as ``surface 1``; in Medit they are references."""
    out: dict[str, list[np.ndarray]] = {}
    for blocks in (mesh.cell_data[name] for name in mesh.cell_data if name.endswith(":ref")):
        for place, (block, values) in enumerate(zip(mesh.cells, blocks, strict=True)):
            for number in np.unique(values):
                sets = out.setdefault(f"{DIMENSIONS[block.dim]} {number}", [np.zeros(0, int) for _ in mesh.cells])
                sets[place] = np.flatnonzero(np.asarray(values) == number)
    return out
