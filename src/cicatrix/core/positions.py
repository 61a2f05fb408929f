"""Positions of a patient, and the direction of gravity in each."""

from __future__ import annotations

POSITIONS = {  # name in case files -> words on a page
    "prone": "lying face down",
    "supine": "lying on the back",
    "supine-arms-up": "lying on the back, arms up",
    "upright": "standing",
    "lateral": "lying on the other side",
}
_DOWN = {
    "prone": (0.0, -1.0, 0.0),
    "supine": (0.0, 1.0, 0.0),
    "supine-arms-up": (0.0, 1.0, 0.0),
    "upright": (0.0, 0.0, -1.0),
}
_TO_THE_OTHER_SIDE = {"left": (-1.0, 0.0, 0.0), "right": (1.0, 0.0, 0.0)}


def down(position: str, side: str) -> tuple[float, float, float]:
    """Return the unit vector of gravity in a position, LPS [1]; ``side`` is that of the treated breast.

    ``"lateral"`` is lying on the other side: gravity points from the treated breast to the other one. Arms that are raised
    change nothing here: gravity is as supine, and what they do to skin and muscle is not modelled.
    """
    return _TO_THE_OTHER_SIDE[side] if position == "lateral" else _DOWN[position]
