"""The numbers a surgeon asks for: each with what the clinic knows of it, and a plain sentence. No clinical class is claimed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .account import Account
from .bodies import Shape

ML = 1e-3  # of a mm^3
POSITIONS = {"upright": "standing", "supine": "lying on the back", "prone": "lying face down"}
REFERENCES = {  # numbers of the clinic, as docs/theory/clinic.md gathers them
    "closure": "cavity on images: 47 ml in weeks 3 to 8, 30 ml in weeks 9 to 14, 21 ml and then 9 ml later",
    "removed": "median resection 55 to 64 ml",
    "share": "below 10 % of the breast 84 % of women are very satisfied, above it 37 %",
    "volume": "after treatment the smaller breast has 87 % (78 to 93) of the other's volume",
    "nipple": "both nipples differ in place by 12 ± 7 mm in women never operated on, by 37 ± 21 mm after treatment",
    "retraction": "after treatment the two sides' surfaces differ by 5.9 mm (4.2 to 8.0)",
    "dent": "no published range for one breast",
}


@dataclass(frozen=True)
class Line:
    """A row of the table."""

    name: str
    value: str
    reference: str
    sentence: str


def lines_of(account: Account, shapes: list[Shape]) -> list[Line]:
    """The table of a lumpectomy; empty for other runs."""
    if account.kind != "lumpectomy":
        return []
    return [*_removal(shapes), *_closure(account), *_shape(account)]


def _removal(shapes: list[Shape]) -> Iterator[Line]:
    first = next((shape for shape in shapes if shape.cavity.any()), None)
    if first is None:
        return
    sizes = np.abs(sizes_of(first))
    removed, total = float(sizes[first.cavity].sum()), float(sizes.sum())
    share = 100.0 * removed / total
    if first.is_solid:
        told = f"{removed * ML:.1f} ml"
        yield Line("Volume removed", told, REFERENCES["removed"], f"Surgery takes out {told}.")
        what, whole = "breast", f"{total * ML:.0f} ml that are modelled"
    else:
        what, whole = "section", f"{total / 100.0:.1f} cm² of this section"
    reference = (
        REFERENCES["share"] if first.is_solid else "the clinic's limit of 10 % is one of volume, not of a section"
    )
    sentence = f"That is {share:.1f} % of the {whole}."
    yield Line(f"Share of the {what}", f"{share:.1f} %", reference, sentence)


def sizes_of(shape: Shape) -> np.ndarray:
    """Area of each triangle [mm^2], or volume of each tetrahedron [mm^3] (m,), with the sign of its orientation."""
    corners = shape.points[shape.cells]
    edges = corners[:, 1:] - corners[:, :1]
    if shape.is_solid:
        return np.linalg.det(edges) / 6.0
    return np.cross(edges[:, 0], edges[:, 1])[:, 2] / 2.0


def _closure(account: Account) -> Iterator[Line]:
    asked = account.number("time_to_closure_days")
    closed = account.column("closed_fraction")
    if asked is not None and asked.value is not None:
        days = float(asked.value)
        yield Line(
            "Cavity closed after",
            f"{days:.0f} days",
            REFERENCES["closure"],
            f"New tissue has filled the cavity {days / 7:.0f} weeks after surgery.",
        )
    elif closed.size:
        days = account.column("time_days")[-1]
        open_share = 100.0 * (1.0 - closed[-1])
        sentence = f"On day {days:.0f}, the last of this run, {open_share:.0f} % of the cavity are still open."
        yield Line("Cavity still open", f"{open_share:.0f} %", REFERENCES["closure"], sentence)


def _shape(account: Account) -> Iterator[Line]:
    for position in account.asked("outcome", "positions", default=[]):
        where = POSITIONS.get(position, position)
        found = {name: _value(account, position, name) for name in WORDS}
        for name, value in found.items():
            if value is not None:
                title, unit, reference, words = WORDS[name]
                shown = f"{value:+.1f} {unit}" if name.startswith("volume") else f"{value:.1f} {unit}"
                when = "Healed" if account.is_closed else "At the last visit, the cavity still open"
                yield Line(f"{title}, {where}", shown, REFERENCES[reference], words(value, f"{when}, {where}"))


def _value(account: Account, position: str, name: str) -> float | None:
    asked = account.number(f"{position}.healed.{name}")
    return None if asked is None or asked.value is None else float(asked.value)


def _volume(value: float, when: str) -> str:
    if abs(value) < 0.5:
        return f"{when}, the breast has the volume it had before, within half a percent."
    more = "more" if value > 0 else "less"
    return f"{when}, the breast has {abs(value):.1f} % {more} volume than before."


def _dent(value: float, when: str) -> str:
    if value < 0.1:
        return f"{when}, no dent is seen that was not there before."
    return f"{when}, the deepest dent is {value:.1f} mm deeper than before."


WORDS = {
    "volume_change_percent": ("Change of volume", "%", "volume", _volume),
    "nipple_displacement_mm": (
        "Nipple has moved",
        "mm",
        "nipple",
        lambda v, when: f"{when}, the nipple is {v:.1f} mm from where it was before surgery.",
    ),
    "surface_retraction_max_mm": (
        "Skin drawn in, at most",
        "mm",
        "retraction",
        lambda v, when: f"{when}, the skin lies {v:.1f} mm further in than before where it is worst.",
    ),
    "surface_retraction_rms_mm": (
        "Skin off its old place, in the mean",
        "mm",
        "retraction",
        lambda v, where: (
            f"Over all the skin the new surface is {v:.1f} mm off the old one, {where} (root mean square)."
        ),
    ),
    "concavity_depth_mm": ("Deepest dent", "mm", "dent", _dent),
}
