"""Checks of a run for reviewers: conservation, inverted elements, convergence of the solver, quality of the mesh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..geometry.tetrahedra import dihedral_angles
from .bodies import Shape
from .cosmesis import sizes_of
from .run_view import RunView

MAX_DRIFT = 0.02  # largest relative drift of open plus filled size; sites on the border count on one side


@dataclass(frozen=True)
class Check:
    """Result of one quality check: the measured value, its limit, and whether the value is within the limit.

    Parameters
    ----------
    name, value, limit : str
        Name of the check, measured value, and limit.
    holds : bool or None
        Whether the value is within the limit; None if there is no limit.
    """

    name: str
    value: str
    limit: str
    holds: bool | None


def checks_of(view: RunView, shapes: list[Shape]) -> list[Check]:
    """Perform all quality checks for which the run's folder has the data."""
    return [*_conserved(view), *_cells(view), *_solver(view), *_mesh(shapes)]


def _conserved(view: RunView) -> Iterator[Check]:
    """Check that open cavity and tissue together keep their size in the reference configuration."""
    pairs = (("open_area_mm2", "tissue_area_mm2"), ("open_volume_mm3", "tissue_volume_mm3"))
    for left, right in pairs:
        open_size, tissue = view.column(left), view.column(right)
        if open_size.size and open_size[0] > 0 and tissue.size:
            drift = float(np.abs((open_size + tissue) - (open_size[0] + tissue[0])).max() / open_size[0])
            name = "open cavity and tissue together change by at most"
            yield Check(
                name, f"{100 * drift:.2f} % of the cavity", f"at most {100 * MAX_DRIFT:g} %", drift <= MAX_DRIFT
            )


def _cells(view: RunView) -> Iterator[Check]:
    clamped = view.column("clamped_cells")
    if clamped.size:
        name = "largest number of cells per row of the history whose division probability was limited to 1"
        yield Check(name, f"{clamped.max():.0f}", "", None)
    closed = view.column("closed_fraction")
    if closed.size > 1:
        back = float(max(0.0, -np.diff(closed).min()))
        yield Check("closed fraction falls by at most", f"{back:.2g}", "0 for the automaton", back == 0.0 or None)
    cells = view.column("cells_total")
    if cells.size:
        yield Check(
            "cells in the whole body at the end, relative to the start", f"{cells[-1] / cells[0]:.4f}", "", None
        )


def _solver(view: RunView) -> Iterator[Check]:
    iterations = view.column("newton_iterations")
    if iterations.size:
        yield Check(
            "Newton iterations per row of the history", f"{iterations.min():.0f} to {iterations.max():.0f}", "", None
        )
    hard = [note for note in view.manifest.get("notes", []) if "iterations;" in note]
    yield Check("solves for which plain Newton iterations were not enough", str(len(hard)), "", None)


def _mesh(shapes: list[Shape]) -> Iterator[Check]:
    if not shapes:
        return
    first = shapes[0]
    kind = "tetrahedra" if first.is_solid else "triangles"
    yield Check("elements", f"{len(first.cells)} {kind}, {len(first.points)} corners", "", None)
    least = least_angle(first)
    yield Check(
        "smallest angle in an element, in the first shape",
        f"{least:.1f}°",
        "8° or more for tetrahedra",
        least >= 8.0 or None,
    )
    upright = np.sign(sizes_of(first))
    turned = sum(int(np.count_nonzero((sizes_of(shape) * upright)[shape.present] <= 0.0)) for shape in shapes)
    name = "inverted elements, sum over all shapes"
    yield Check(name, str(turned), "0", turned == 0)


def least_angle(shape: Shape) -> float:
    """Return the smallest angle between faces of tetrahedra or between sides of triangles [degrees]."""
    if shape.is_solid:
        return float(dihedral_angles(shape.points, shape.cells).min())
    corners = shape.points[shape.cells]
    along, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = np.sum(along * back, axis=2) / (np.linalg.norm(along, axis=2) * np.linalg.norm(back, axis=2))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).min())
