"""Fields on triangles and tetrahedra for ParaView: one VTU per part and cycle, and a series file with times in days."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np

from ..core.errors import InputError
from .atomic import replacing, write_bytes

SERIES = "series.pvd"
CELL_TYPES = {3: "triangle", 6: "triangle6", 4: "tetra", 10: "tetra10"}
NAME = re.compile(r"(?P<part>.+)-(?P<cycle>\d{4,})\.vtu")


@dataclass(frozen=True)
class TimeStepFile:
    """One file of the series: part of the model, cycle and time [days]."""

    part: str
    cycle: int
    time_days: float

    @property
    def name(self) -> str:
        """Name of the VTU file."""
        return f"{self.part}-{self.cycle:04d}.vtu"


def write_vtu(
    path: Path,
    points: np.ndarray,
    cells: np.ndarray,
    point_data: Mapping[str, np.ndarray] | None = None,
    cell_data: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a mesh of triangles or tetrahedra with data as a VTU file, atomically.

    Parameters
    ----------
    path : Path
        File name, which ends in ``.vtu``.
    points : (n_points, 2) or (n_points, 3) array [mm]
        Nodes; a plane mesh lies at z = 0.
    cells : (n_cells, 3, 6, 4 or 10) array of int
        Corners of triangles counter-clockwise, then the midpoints of edges 01, 12, 20; corners of tetrahedra, then the midpoints
        of edges 01, 12, 02, 03, 13, 23.
    point_data, cell_data : mapping of str to array
        One row per node or cell; rows of length 2 get a third component 0, booleans become 0 and 1.

    Raises
    ------
    ValueError
        If a cell has another number of nodes, or data have the wrong number of rows.
    """
    cells = np.asarray(cells)
    if cells.ndim != 2 or cells.shape[1] not in CELL_TYPES:
        raise ValueError(f"cells must be (n, 3), (n, 6), (n, 4) or (n, 10); got {cells.shape}")
    mesh = meshio.Mesh(
        _spatial(np.asarray(points, float)),
        [(CELL_TYPES[cells.shape[1]], cells)],
        point_data={name: _plain(values) for name, values in (point_data or {}).items()},
        cell_data={name: [_plain(values)] for name, values in (cell_data or {}).items()},
    )
    with replacing(path) as temporary:
        mesh.write(temporary, file_format="vtu", binary=True, compression="zlib")


def write_series(folder: Path, step_files: list[TimeStepFile]) -> None:
    """Write the series file that ParaView opens, with the file and time of every time step; each part has a number."""
    parts = sorted({step_file.part for step_file in step_files})
    ordered = sorted(step_files, key=lambda step_file: (step_file.time_days, step_file.part, step_file.cycle))
    rows = [
        f'    <DataSet timestep="{step_file.time_days!r}" group="" part="{parts.index(step_file.part)}"'
        f" name={quoteattr(step_file.part)} file={quoteattr(step_file.name)}/>"
        for step_file in ordered
    ]
    head = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">']
    lines = [*head, "  <Collection>", *rows, "  </Collection>", "</VTKFile>", ""]
    write_bytes(folder / SERIES, "\n".join(lines).encode())


def read_series(folder: Path) -> list[TimeStepFile]:
    """Read the time steps of a series; an empty list if there is no series yet.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    path = folder / SERIES
    if not path.is_file():
        return []
    step_files = []
    try:
        rows = list(ElementTree.parse(path).iter("DataSet"))
    except (ElementTree.ParseError, OSError, ValueError):
        raise InputError(f"{path} is damaged: it is not a series of VTU files") from None
    for row in rows:
        match = NAME.fullmatch(row.get("file", ""))
        if match:
            step_files.append(TimeStepFile(match["part"], int(match["cycle"]), float(row.get("timestep", "nan"))))
    return step_files


def _spatial(values: np.ndarray) -> np.ndarray:
    """Append a zero to rows of two numbers, as VTK requires three coordinates."""
    return np.pad(values, ((0, 0), (0, 1))) if values.shape[1] == 2 else values


def _plain(values: np.ndarray) -> np.ndarray:
    values = np.ascontiguousarray(values)
    values = values.astype(np.uint8) if values.dtype == bool else values
    return _spatial(values) if values.ndim == 2 else values
