"""Bodies of a run as triangles that a page can draw: every visit, every position, whole and cut open."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.units import weeks_from_days
from ..files.vtu import Frame, read_mesh, read_series
from ..geometry.tetrahedra import owned_boundary
from .account import Account
from .cutting import Piece, clipped, face
from .packing import packed

MOST_MOMENTS = 12  # per position that a page is given
CUT_PERCENT = 99.9  # of values that a scale spans, where the highest are far above the others
PRESENT = 0.5  # an element with less tissue than this share is drawn as a hole
BEFORE = "before-"
NAMES = {  # of what a body can be coloured by: what the page says, unit
    "displacement": ("moved since before surgery", "mm"),
    "shift": ("moved since the reference shape", "mm"),
    "strain_energy_density_kPa": ("strain energy density", "kPa"),
    "filled_fraction": ("share that is filled with tissue", "1"),
    "collagen_fraction": ("collagen, healthy = 1", "1"),
    "cells_fraction": ("cells, healthy = 1", "1"),
}
HIDDEN = ("cavity",)
UNITS = {"kPa": "kPa", "mm": "mm", "mm3": "mm³", "uJ": "µJ", "deg": "°"}


@dataclass(frozen=True, eq=False)
class Shape:
    """A body in a position at a moment.

    Parameters
    ----------
    position : str
        Upright, supine, prone, or "as loaded".
    label : str
        The moment in words.
    days : float
        After surgery; below 0 for before it.
    points : (n, 3) array [mm]
        Corners of elements.
    cells : (m, 3 or 4) array
        Triangles of a section, tetrahedra of a solid.
    at_points, in_cells : dict of str to (n,) and (m,) array
        What it can be coloured by.
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
        """Tetrahedra rather than triangles."""
        return self.cells.shape[1] == 4

    @property
    def present(self) -> np.ndarray:
        """Elements that hold tissue (m,) bool."""
        return self.in_cells.get("filled_fraction", np.ones(len(self.cells))) >= PRESENT

    @property
    def cavity(self) -> np.ndarray:
        """Elements that surgery takes out (m,) bool."""
        return self.in_cells.get("cavity", np.zeros(len(self.cells))).astype(bool)


def shapes_of(account: Account) -> list[Shape]:
    """Shapes at the visits, in order of position and time; of a run without them, the states that it went through."""
    frames = read_series(account.folder / "shapes")
    if frames:
        last = max(frame.cycle for frame in frames)
        asked = account.asked("outcome", "positions", default=[])
        ordered = sorted(_thinned(frames), key=lambda frame: _place(frame, asked))
        return [_read(account.folder / "shapes", frame, *_visit(account, frame, last)) for frame in ordered]
    frames = read_series(account.folder / "fields")
    where = account.asked("coupling", "healing_position", default="as loaded")
    return [_read(account.folder / "fields", f, where, _moment(account, f)) for f in _thinned(frames)]


def _thinned(frames: list[Frame]) -> list[Frame]:
    """Evenly spaced frames of each part in time, the first and the last among them."""
    chosen: list[Frame] = []
    for part in dict.fromkeys(frame.part for frame in frames):
        own = sorted((f for f in frames if f.part == part), key=lambda f: f.cycle)
        rows = np.unique(np.rint(np.linspace(0, len(own) - 1, min(len(own), MOST_MOMENTS))).astype(int))
        chosen += [own[row] for row in rows]
    return chosen


def _place(frame: Frame, asked: list[str]) -> tuple[int, str, bool, int]:
    """Positions in the order of the case, then time."""
    position = frame.part.removeprefix(BEFORE)
    number = asked.index(position) if position in asked else len(asked)
    return number, position, not frame.part.startswith(BEFORE), frame.cycle


def _visit(account: Account, frame: Frame, last: int) -> tuple[str, str]:
    if frame.part.startswith(BEFORE):
        return frame.part.removeprefix(BEFORE), "before surgery"
    if frame.cycle == 0:
        return frame.part, "after surgery"
    if frame.cycle == last and account.is_finished and account.is_closed:
        return frame.part, "healed"
    return frame.part, f"week {weeks_from_days(frame.time_days):.3g}"


def _moment(account: Account, frame: Frame) -> str:
    if account.kind == "lumpectomy" and frame.cycle == 0:
        return "after surgery"
    return f"day {frame.time_days:.4g}" if frame.time_days else "at the start"


def _read(folder: Path, frame: Frame, position: str, label: str) -> Shape:
    mesh = read_mesh(folder / frame.file)
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
    days = -1.0 if frame.part.startswith(BEFORE) else frame.time_days
    return Shape(position, label, days, points, renumbered.reshape(-1, corners), at_points, in_cells)


def scene(shapes: list[Shape], account: Account) -> dict[str, Any]:
    """What a page needs to draw them: triangles, colours per point and per triangle, and the range of each colour."""
    height = _height(shapes[0])
    return {
        "dimension": 3 if shapes[0].is_solid else 2,
        "isDownward": not shapes[0].is_solid and account.asked("image", "plane") == "axial",
        "axes": _axes(shapes[0], account),
        "side": account.asked("image", "side", default="left"),
        "colours": _colours(shapes),
        "shapes": [_drawn(shape, height) for shape in shapes],
    }


def _axes(shape: Shape, account: Account) -> list[str]:
    if account.kind != "lumpectomy":
        return ["x", "y", "z"]
    names = ["left", "posterior", "superior"]
    if shape.is_solid or account.asked("image", "plane") == "axial":
        return names
    return names[1:] + names[:1]


def _height(shape: Shape) -> np.ndarray:
    """Distance of corners from the sagittal plane through the cavity, or the middle; below 0 on its medial side (k,) [mm]."""
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
    """What is left of a solid on the medial side, with the walls of its cavity and the face of the cut."""
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
    """Edges around a section, its cavity filled (n, 2)."""
    edges = np.sort(shape.cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return unique[count == 1]


def _colours(shapes: list[Shape]) -> list[dict[str, Any]]:
    """What can be coloured, and from where to where: over all shapes alike; what points have, by those of the outer surface."""
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
    """A column's name as words, and its unit."""
    stem, _, tail = name.rpartition("_")
    return (stem.replace("_", " "), UNITS[tail]) if tail in UNITS and stem else (name.replace("_", " "), "1")
