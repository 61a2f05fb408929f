"""Table of the outcomes that matter to surgeons, each with a published reference and a sentence.

None of them is a clinical grade.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..core.positions import POSITIONS
from .bodies import Shape
from .run_view import RunView

ML = 1e-3  # ml per mm^3
REFERENCES = {  # published clinical numbers; sources in docs/theory/clinic.md
    "closure": "cavity on planning CT: 47 to 30 ml within weeks 3 to 8, 21 ml in weeks 9 to 14, 9 ml later",
    "removed": "median resection 55 to 64 ml",
    "share": "84 % of women are very satisfied if less than 10 % of the breast is removed, 37 % if more",
    "volume": "after treatment the smaller breast has 87 % (78 to 93) of the other's volume",
    "nipple": "the positions of the two nipples differ by 12 ± 7 mm without surgery, by 37 ± 21 mm after treatment",
    "retraction": "the surfaces of the two breasts differ by 5.9 mm (4.2 to 8.0) after treatment",
    "dent": "no published range for one breast",
}


@dataclass(frozen=True)
class Line:
    """Row of the table: name, value, published reference and a sentence."""

    name: str
    value: str
    reference: str
    sentence: str


def lines_of(view: RunView, shapes: list[Shape]) -> list[Line]:
    """Return the table of a lumpectomy; empty for other runs."""
    if view.kind != "lumpectomy":
        return []
    return [*_removal(shapes), *_closure(view), *_shape(view)]


def _removal(shapes: list[Shape]) -> Iterator[Line]:
    first = next((shape for shape in shapes if shape.cavity.any()), None)
    if first is None:
        return
    sizes = np.abs(sizes_of(first))
    removed, total = float(sizes[first.cavity].sum()), float(sizes.sum())
    share = 100.0 * removed / total
    if first.is_solid:
        removed_ml = f"{removed * ML:.1f} ml"
        yield Line("Volume removed", removed_ml, REFERENCES["removed"], f"Surgery removes {removed_ml}.")
        what, whole = "breast", f"{total * ML:.0f} ml in the model"
    else:
        what, whole = "section", f"{total / 100.0:.1f} cm² of this section"
    reference = (
        REFERENCES["share"] if first.is_solid else "the clinical limit of 10 % refers to volume, not to a section"
    )
    sentence = f"That is {share:.1f} % of the {whole}."
    yield Line(f"Share of the {what}", f"{share:.1f} %", reference, sentence)


def sizes_of(shape: Shape) -> np.ndarray:
    """Return the signed area of each triangle [mm^2] or volume of each tetrahedron [mm^3] (m,)."""
    corners = shape.points[shape.cells]
    edges = corners[:, 1:] - corners[:, :1]
    if shape.is_solid:
        return np.linalg.det(edges) / 6.0
    return np.cross(edges[:, 0], edges[:, 1])[:, 2] / 2.0


def _closure(view: RunView) -> Iterator[Line]:
    asked = view.number("time_to_closure_days")
    closed = view.column("closed_fraction")
    if asked is not None and asked.value is not None:
        days = float(asked.value)
        yield Line(
            "Cavity closed after",
            f"{days:.0f} days",
            REFERENCES["closure"],
            f"New tissue has filled the cavity {days / 7:.0f} weeks after surgery.",
        )
    elif closed.size:
        days = view.column("time_days")[-1]
        open_share = 100.0 * (1.0 - closed[-1])
        sentence = f"On day {days:.0f}, the last of this run, {open_share:.0f} % of the cavity is still open."
        yield Line("Cavity still open", f"{open_share:.0f} %", REFERENCES["closure"], sentence)


def _shape(view: RunView) -> Iterator[Line]:
    for position in view.case_value("outcome", "positions", default=[]):
        where = POSITIONS.get(position, position)
        found = {name: _value(view, position, name) for name in WORDS}
        for name, value in found.items():
            if value is not None:
                title, unit, reference, words = WORDS[name]
                shown = f"{value:+.1f} {unit}" if name.startswith("volume") else f"{value:.1f} {unit}"
                when = "Healed" if view.is_closed else "At the last visit, with the cavity still open"
                yield Line(f"{title}, {where}", shown, REFERENCES[reference], words(value, f"{when}, {where}"))


def _value(view: RunView, position: str, name: str) -> float | None:
    asked = view.number(f"{position}.healed.{name}")
    return None if asked is None or asked.value is None else float(asked.value)


def _volume(value: float, when: str) -> str:
    if abs(value) < 0.5:
        return f"{when}, the breast has the same volume as before, within 0.5 %."
    more = "more" if value > 0 else "less"
    return f"{when}, the breast has {abs(value):.1f} % {more} volume than before."


def _dent(value: float, when: str) -> str:
    if value < 0.1:
        return f"{when}, the depth below the convex hull grew by less than 0.1 mm; in a section this measure can miss a dent."
    return f"{when}, the surface lies up to {value:.1f} mm deeper below its convex hull than before."


WORDS = {
    "volume_change_percent": ("Change of volume", "%", "volume", _volume),
    "nipple_displacement_mm": (
        "Displacement of the nipple",
        "mm",
        "nipple",
        lambda v, when: f"{when}, the nipple is {v:.1f} mm from where it was before surgery.",
    ),
    "surface_retraction_max_mm": (
        "Largest retraction of the skin",
        "mm",
        "retraction",
        lambda v, when: f"{when}, the skin lies up to {v:.1f} mm further in than before.",
    ),
    "surface_retraction_rms_mm": (
        "Distance between old and new skin (RMS)",
        "mm",
        "retraction",
        lambda v, where: f"{where}, the skin is {v:.1f} mm from its old surface (root mean square over the skin).",
    ),
    "concavity_depth_mm": ("Deepening of dents", "mm", "dent", _dent),
}
