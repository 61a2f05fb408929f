"""Triangles of a run's bodies for drawing on a page: at every visit, in every position, whole and cut open."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.units import weeks_from_days
from ..files.mesh_formats import read_mesh
from ..files.vtu import TimeStepFile, read_series
from ..geometry.tetrahedra import owned_boundary
from .cutting import Piece, clipped, face
from .packing import packed
from .run_view import RunView

MAX_VISITS = 12  # largest number of visits per position on a page
CUT_PERCENT = 99.9  # upper percentile of a colour scale if the largest values are far above the others
PRESENT = 0.5  # elements filled with tissue to less than this fraction are drawn as a hole
BEFORE = "before-"
NAMES = {  # field to colour a body by -> its label on the page, its unit
    "displacement": ("displacement since before surgery", "mm"),
    "shift": ("displacement from the reference shape", "mm"),
    "strain_energy_density_kPa": ("strain energy density", "kPa"),
    "filled_fraction": ("fraction filled with tissue", "1"),
    "collagen_fraction": ("collagen, healthy = 1", "1"),
    "cells_fraction": ("cells, healthy = 1", "1"),
}
HIDDEN = ("cavity",)
UNITS = {"kPa": "kPa", "mm": "mm", "mm3": "mm³", "uJ": "µJ", "deg": "°"}


@dataclass(frozen=True, eq=False)
class Shape:
    """Shape of a body in one position at one time.

    Parameters
    ----------
    position : str
        Upright, supine, prone, or "as loaded".
    label : str
        Name of the time, such as "before surgery" or "week 2".
    days : float
        Days after surgery; negative: before surgery.
    points : (n, 3) array [mm]
        Corners of the elements.
    cells : (m, 3 or 4) array
        Triangles of a section, tetrahedra of a solid.
    at_points, in_cells : dict of str to (n,) and (m,) array
        Fields at points and in elements by which the body can be coloured.
    """

    position: str
    label: str
    days: float
    points: np.ndarray
    cells: np.ndarray
    at_points: dict[str, np.ndarray]
    in_cells: dict[str, np.ndarray]

    @property
    def is_solid(self) -> bool:
        """Whether the elements are tetrahedra (triangles otherwise)."""
        return self.cells.shape[1] == 4

    @property
    def present(self) -> np.ndarray:
        """Elements filled with tissue to at least :data:`PRESENT` (m,) bool."""
        return self.in_cells.get("filled_fraction", np.ones(len(self.cells))) >= PRESENT

    @property
    def cavity(self) -> np.ndarray:
        """Elements that surgery removes (m,) bool."""
        return self.in_cells.get("cavity", np.zeros(len(self.cells))).astype(bool)


def shapes_of(view: RunView) -> list[Shape]:
    """Read the shapes at visits, sorted by patient position and time; in a run without visits, those of the saved fields."""
    step_files = read_series(view.folder / "shapes")
    if step_files:
        last = max(step_file.cycle for step_file in step_files)
        asked = view.case_value("outcome", "positions", default=[])
        ordered = sorted(_thinned(step_files), key=lambda step_file: _place(step_file, asked))
        return [_read(view.folder / "shapes", step_file, *_visit(view, step_file, last)) for step_file in ordered]
    step_files = read_series(view.folder / "fields")
    where = view.case_value("coupling", "healing_position", default="as loaded")
    return [_read(view.folder / "fields", f, where, _moment(view, f)) for f in _thinned(step_files)]


def _thinned(step_files: list[TimeStepFile]) -> list[TimeStepFile]:
    """Select at most :data:`MAX_VISITS` evenly spaced time steps of each part, including the first and the last."""
    chosen: list[TimeStepFile] = []
    for part in dict.fromkeys(step_file.part for step_file in step_files):
        own = sorted((f for f in step_files if f.part == part), key=lambda f: f.cycle)
        rows = np.unique(np.rint(np.linspace(0, len(own) - 1, min(len(own), MAX_VISITS))).astype(int))
        chosen += [own[row] for row in rows]
    return chosen


def _place(step_file: TimeStepFile, asked: list[str]) -> tuple[int, str, bool, int]:
    """Return the sort key of a file: the patient position, in the order ``asked`` of the case, then the time."""
    position = step_file.part.removeprefix(BEFORE)
    number = asked.index(position) if position in asked else len(asked)
    return number, position, not step_file.part.startswith(BEFORE), step_file.cycle


def _visit(view: RunView, step_file: TimeStepFile, last: int) -> tuple[str, str]:
    if step_file.part.startswith(BEFORE):
        return step_file.part.removeprefix(BEFORE), "before surgery"
    if step_file.cycle == 0:
        return step_file.part, "after surgery"
    if step_file.cycle == last and view.is_finished and view.is_closed:
        return step_file.part, "healed"
    return step_file.part, f"week {weeks_from_days(step_file.time_days):.3g}"


def _moment(view: RunView, step_file: TimeStepFile) -> str:
    if view.kind == "lumpectomy" and step_file.cycle == 0:
        return "after surgery"
    return f"day {step_file.time_days:.4g}" if step_file.time_days else "at the start"


def _read(folder: Path, step_file: TimeStepFile, position: str, label: str) -> Shape:
    mesh = read_mesh(folder / step_file.name)
    corners = 4 if mesh.cells[0].type.startswith("tetra") else 3
    used, renumbered = np.unique(mesh.cells[0].data[:, :corners], return_inverse=True)
    data = {name: np.asarray(values)[used] for name, values in mesh.point_data.items()}
    points, shift = mesh.points[used], data.pop("displacement", None)
    at_points = {name: values for name, values in data.items() if values.ndim == 1}
    if shift is not None:
        since_surgery = folder.name == "shapes"
        at_points["displacement" if since_surgery else "shift"] = np.linalg.norm(shift, axis=1)
        points = points if since_surgery else points + shift
    in_cells = {name: values[0] for name, values in mesh.cell_data.items() if values[0].ndim == 1}
    days = -1.0 if step_file.part.startswith(BEFORE) else step_file.time_days
    return Shape(position, label, days, points, renumbered.reshape(-1, corners), at_points, in_cells)


def scene(shapes: list[Shape], view: RunView) -> dict[str, Any]:
    """Return the data for drawing the shapes: triangles, values per point and per triangle, and colour ranges."""
    height = _height(shapes[0])
    return {
        "dimension": 3 if shapes[0].is_solid else 2,
        "isDownward": not shapes[0].is_solid and view.case_value("image", "plane") == "axial",
        "axes": _axes(shapes[0], view),
        "side": view.case_value("image", "side", default="left"),
        "colours": _colours(shapes),
        "shapes": [_drawn(shape, height) for shape in shapes],
    }


def _axes(shape: Shape, view: RunView) -> list[str]:
    if view.kind != "lumpectomy":
        return ["x", "y", "z"]
    names = ["left", "posterior", "superior"]
    if shape.is_solid or view.case_value("image", "plane") == "axial":
        return names
    return names[1:] + names[:1]


def _height(shape: Shape) -> np.ndarray:
    """Return the signed distance of the corners from the cutting plane (k,) [mm], negative on the medial side.

    The plane is the sagittal plane through the centre of the cavity, or through the median of the points if there is no cavity.
    """
    x = shape.points[:, 0]
    middle = x[shape.cells[shape.cavity]].mean() if shape.cavity.any() else np.median(x)
    return (x - middle) * (1.0 if middle >= 0.0 else -1.0)


def _drawn(shape: Shape, height: np.ndarray) -> dict[str, Any]:
    whole = _whole(shape)
    surfaces = {"whole": whole} | ({"cut": _cut(shape, height)} if shape.is_solid else {})
    return {
        "position": shape.position,
        "label": shape.label,
        "days": shape.days,
        "surfaces": {name: _surface(shape, piece) for name, piece in surfaces.items()},
        "outline": None if shape.is_solid else packed(np.searchsorted(whole.ends[:, 0], _outline(shape))),
    }


def _whole(shape: Shape) -> Piece:
    if shape.is_solid:
        triangles, owner = owned_boundary(shape.cells)
    else:
        owner = np.flatnonzero(shape.present)
        triangles = shape.cells[owner]
    return clipped(triangles, owner, np.zeros(len(shape.points)))


def _cut(shape: Shape, height: np.ndarray) -> Piece:
    """Return the medial part of a solid: its surface, the walls of its cavity and the face of the cut."""
    rows = np.flatnonzero(shape.present)
    triangles, owner = owned_boundary(shape.cells[rows])
    across = np.array([1.0 if height[np.argmax(shape.points[:, 0])] > 0.0 else -1.0, 0.0, 0.0])
    return clipped(triangles, rows[owner], height).joined(
        face(shape.cells, shape.present, height, shape.points, across)
    )


def _surface(shape: Shape, piece: Piece) -> dict[str, Any]:
    return {
        "points": packed(piece.at(shape.points)),
        "triangles": packed(piece.triangles),
        "atPoints": {name: packed(piece.at(values.astype(float))) for name, values in _shown(shape.at_points)},
        "inCells": {name: packed(values[piece.owner].astype(float)) for name, values in _shown(shape.in_cells)},
    }


def _shown(values: dict[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    return ((name, array) for name, array in values.items() if name not in HIDDEN)


def _outline(shape: Shape) -> np.ndarray:
    """Return the outer edges of a section, with its cavity counted as filled (n, 2)."""
    edges = np.sort(shape.cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return unique[count == 1]


def _colours(shapes: list[Shape]) -> list[dict[str, Any]]:
    """Return the fields to colour by, with label, unit and a range common to all shapes.

    For a field at points, the range is taken over the outer surface.
    """
    found: dict[str, list[np.ndarray]] = {}
    for shape in shapes:
        seen = np.unique(owned_boundary(shape.cells)[0]) if shape.is_solid else slice(None)
        of_points = {name: values[seen] for name, values in shape.at_points.items()}
        of_cells = {name: values[shape.present] for name, values in shape.in_cells.items()}
        for name, array in (*_shown(of_points), *_shown(of_cells)):
            found.setdefault(name, []).append(array)
    colours = []
    for name, arrays in found.items():
        label, unit = NAMES.get(name, _words(name))
        values = np.concatenate(arrays).astype(float)
        low, high = np.nanpercentile(values, (0.1, CUT_PERCENT))
        high = high if np.nanmax(values) > 1.05 * high else np.nanmax(values)
        limits = [min(0.0, low), max(high, min(0.0, low) + 1e-9)]
        colours.append({"name": name, "label": label, "unit": unit, "range": limits})
    order = [*NAMES, *sorted(found)]
    return sorted(colours, key=lambda colour: order.index(colour["name"]))


def _words(name: str) -> tuple[str, str]:
    """Split a field's name into words and unit."""
    stem, _, tail = name.rpartition("_")
    return (stem.replace("_", " "), UNITS[tail]) if tail in UNITS and stem else (name.replace("_", " "), "1")
