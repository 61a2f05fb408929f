"""What a reviewer checks first: is anything lost, is any element inside out, did the solver converge, how good is the mesh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..geometry.tetrahedra import dihedral_angles
from .account import Account
from .bodies import Shape
from .cosmesis import sizes_of

LOST = 0.02  # of the cavity that open and new tissue may not account for: sites on its border belong to one side or the other


@dataclass(frozen=True)
class Check:
    """A measure with its limit.

    Parameters
    ----------
    name, value, limit : str
        What, how much, how much it may be.
    holds : bool or None
        None where there is no limit.
    """

    name: str
    value: str
    limit: str
    holds: bool | None


def checks_of(account: Account, shapes: list[Shape]) -> list[Check]:
    """All that can be checked from the files of a run."""
    return [*_conserved(account), *_cells(account), *_solver(account), *_mesh(shapes)]


def _conserved(account: Account) -> Iterator[Check]:
    """Open cavity and tissue together keep their size in the reference."""
    pairs = (("open_area_mm2", "tissue_area_mm2"), ("open_volume_mm3", "tissue_volume_mm3"))
    for left, right in pairs:
        open_size, tissue = account.column(left), account.column(right)
        if open_size.size and open_size[0] > 0 and tissue.size:
            drift = float(np.abs((open_size + tissue) - (open_size[0] + tissue[0])).max() / open_size[0])
            name = "open cavity and tissue together change by at most"
            yield Check(name, f"{100 * drift:.2f} % of the cavity", f"at most {100 * LOST:g} %", drift <= LOST)


def _cells(account: Account) -> Iterator[Check]:
    clamped = account.column("clamped_cells")
    if clamped.size:
        name = "cells whose probability to divide was cut to 1, at most in a row of the history"
        yield Check(name, f"{clamped.max():.0f}", "", None)
    closed = account.column("closed_fraction")
    if closed.size > 1:
        back = float(max(0.0, -np.diff(closed).min()))
        yield Check("closed share falls by at most", f"{back:.2g}", "0 for the automaton", back == 0.0 or None)
    cells = account.column("cells_total")
    if cells.size:
        yield Check(
            "cells of the whole body at the end over those at the start", f"{cells[-1] / cells[0]:.4f}", "", None
        )


def _solver(account: Account) -> Iterator[Check]:
    iterations = account.column("newton_iterations")
    if iterations.size:
        yield Check(
            "Newton iterations per row of the history", f"{iterations.min():.0f} to {iterations.max():.0f}", "", None
        )
    hard = [note for note in account.manifest.get("notes", []) if "iterations;" in note]
    yield Check("solves that needed more than a plain Newton run", str(len(hard)), "", None)


def _mesh(shapes: list[Shape]) -> Iterator[Check]:
    if not shapes:
        return
    first = shapes[0]
    kind = "tetrahedra" if first.is_solid else "triangles"
    yield Check("elements", f"{len(first.cells)} {kind}, {len(first.points)} corners", "", None)
    least = least_angle(first)
    yield Check(
        "least angle of an element, as first loaded", f"{least:.1f}°", "8° or more for tetrahedra", least >= 8.0 or None
    )
    upright = np.sign(sizes_of(first))
    turned = sum(int(np.count_nonzero((sizes_of(shape) * upright)[shape.present] <= 0.0)) for shape in shapes)
    name = "elements turned inside out, over all shapes"
    yield Check(name, str(turned), "0", turned == 0)


def least_angle(shape: Shape) -> float:
    """Least angle between faces of tetrahedra, or between sides of triangles [degrees]."""
    if shape.is_solid:
        return float(dihedral_angles(shape.points, shape.cells).min())
    corners = shape.points[shape.cells]
    along, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cosine = np.sum(along * back, axis=2) / (np.linalg.norm(along, axis=2) * np.linalg.norm(back, axis=2))
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).min())
