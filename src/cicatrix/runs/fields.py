"""Fields of a run as arrays with their mesh, read from its VTU files one at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, overload

import meshio
import numpy as np

from ..core.errors import InputError
from ..core.optional import optional
from ..files.mesh_formats import read_mesh
from ..files.vtu import TimeStepFile, read_series
from .scratch import ScratchFolder


class FieldStep:
    """Mesh and data of one part at one time; its file is read at the first access to an array.

    Attributes
    ----------
    part : str
        Name of the part: ``body`` or ``wound``; of shapes a patient position such as ``upright``, or ``before-upright``.
    number : int
        Number of the step or cycle.
    time_days : float
        Simulated time [days].
    path : Path
        The VTU file.
    """

    def __init__(self, folder: Path, file: TimeStepFile, keeper: ScratchFolder | None = None) -> None:
        self.part, self.number, self.time_days = file.part, file.cycle, file.time_days
        self.path = folder / file.name
        self._keeper = keeper

    @cached_property
    def _mesh(self) -> meshio.Mesh:
        if not self.path.is_file():
            raise InputError(f"{self.path} is gone: give simulate a folder (out=...) to keep the files of a run")
        return read_mesh(self.path)

    @property
    def points(self) -> np.ndarray:
        """Nodes (n_points, 3) [mm]; a plane mesh lies at z = 0.

        In ``fields`` they are those of the unloaded shape (in an inverse problem, of the mesh as given), and adding
        ``point_data["displacement"]`` gives the loaded shape. In ``shapes`` they are those of the loaded shape.
        """
        return self._mesh.points

    @property
    def cells(self) -> np.ndarray:
        """Nodes of the cells (n_cells, n) int: triangles of 3 or 6 nodes, or tetrahedra of 4 or 10.

        The corners come first, then the midpoints of edges: of a triangle 01, 12, 20; of a tetrahedron 01, 12, 02, 03, 13, 23.
        """
        return self._mesh.cells[0].data

    @property
    def point_data(self) -> dict[str, np.ndarray]:
        """Data at the nodes by name, (n_points,) or (n_points, 3) each.

        ``displacement`` is in mm, in ``shapes`` from the shape before surgery. Names of other data end with the unit; data
        without a unit in the name are dimensionless. ``cells``, ``cytokine`` and ``collagen`` of a wound are relative to
        healthy tissue.
        """
        return {name: np.asarray(values) for name, values in self._mesh.point_data.items()}

    @property
    def cell_data(self) -> dict[str, np.ndarray]:
        """Data of the cells by name, (n_cells,) each, the mean over the cell; units as in :attr:`point_data`."""
        return {name: np.asarray(blocks[0]) for name, blocks in self._mesh.cell_data.items()}

    def to_pyvista(self) -> Any:
        """Return the mesh with its data as a PyVista ``UnstructuredGrid``.

        Raises
        ------
        InputError
            If PyVista is not installed.
        """
        return optional("pyvista", "to_pyvista").read(self.path)

    def __repr__(self) -> str:
        """Return part, number and time."""
        return f"<{self.part} {self.number} at {self.time_days:.6g} days: {self.path.name}>"


class FieldSeries(Sequence[FieldStep]):
    """Fields in the order of time; indexed, sliced and iterated over like a list.

    Parameters
    ----------
    folder : Path
        Folder of the VTU files and their series.
    step_files : sequence of TimeStepFile
        Part, number and time of each file.
    keeper : ScratchFolder, optional
        Temporary folder of the files, which exists as long as an object refers to it.
    """

    def __init__(self, folder: Path, step_files: Sequence[TimeStepFile], keeper: ScratchFolder | None = None) -> None:
        self._folder, self._step_files, self._keeper = folder, tuple(step_files), keeper

    @classmethod
    def of(cls, folder: Path, keeper: ScratchFolder | None = None) -> FieldSeries:
        """Return the fields of a folder, as listed in its series file; the sequence is empty if there is no such file."""
        return cls(folder, read_series(folder), keeper)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts, in the order of their first files."""
        return tuple(dict.fromkeys(step_file.part for step_file in self._step_files))

    @property
    def times_days(self) -> np.ndarray:
        """Simulated times (n,) [days]."""
        return np.array([step_file.time_days for step_file in self._step_files])

    def part(self, name: str) -> FieldSeries:
        """Return the fields of one part.

        Raises
        ------
        InputError
            If there is no part of this name.
        """
        if name not in self.parts:
            raise InputError(f"{name} is not a part of these fields; they have {', '.join(self.parts) or 'none'}")
        return FieldSeries(
            self._folder, [step_file for step_file in self._step_files if step_file.part == name], self._keeper
        )

    @overload
    def __getitem__(self, at: int) -> FieldStep: ...
    @overload
    def __getitem__(self, at: slice) -> FieldSeries: ...
    def __getitem__(self, at: int | slice) -> FieldStep | FieldSeries:
        """Return one step, whose file is not read yet, or the series of a slice."""
        if isinstance(at, slice):
            return FieldSeries(self._folder, self._step_files[at], self._keeper)
        return FieldStep(self._folder, self._step_files[at], self._keeper)

    def __iter__(self) -> Iterator[FieldStep]:
        return (FieldStep(self._folder, step_file, self._keeper) for step_file in self._step_files)

    def __len__(self) -> int:
        return len(self._step_files)

    def __repr__(self) -> str:
        """Return the number of steps, their parts and their times."""
        if not self._step_files:
            return "<no fields>"
        days = f"{self.times_days.min():.6g} to {self.times_days.max():.6g} days"
        parts = self.parts
        some = ", ".join(parts[:4]) + (f" and {len(parts) - 4} more parts" if len(parts) > 4 else "")
        return f"<{len(self)} steps of {some}, {days}>"
