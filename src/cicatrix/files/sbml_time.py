"""The unit of time of an SBML model."""

from __future__ import annotations

import math
from typing import Any

from ..core.units import unit_factor


def seconds_of(model: Any, asked: str | None) -> tuple[float, list[str]]:
    """Return the seconds of a model's unit of time, and notes.

    Parameters
    ----------
    model : libsbml.Model
        The model.
    asked : str, optional
        The unit that the case gives: it holds before that of the file; by default the unit that the file states (Level 3:
        ``timeUnits``; Level 1 and 2: the unit ``time``, which is the second unless the file defines another), else the second.
    """
    stated = _stated(model)
    if asked is None:
        named = f'"{model.getTimeUnits()}", which is no time' if model.getTimeUnits() else "no unit of time"
        return (1.0, [f"The file states {named}; seconds are taken."]) if stated is None else (stated, [])
    seconds = unit_factor(asked, "s")
    if stated is not None and model.getLevel() > 2 and abs(stated - seconds) > 1e-9 * seconds:
        return seconds, [
            f"The file states a unit of time of {stated:g} s; network.time_unit = {asked} is taken instead."
        ]
    return seconds, []


def _stated(model: Any) -> float | None:
    """Return the seconds of the unit that a file states; None if it states none, or one that is not of time."""
    name = model.getTimeUnits() if model.getLevel() > 2 else "time"
    unit = model.getUnitDefinition(name)
    if unit is None:
        return 1.0 if name == "second" or model.getLevel() < 3 else None
    parts = [unit.getUnit(k) for k in range(unit.getNumUnits())]
    of_time = sum(one.getExponentAsDouble() for one in parts if one.isSecond())
    if of_time != 1.0 or not all(one.isSecond() or one.isDimensionless() for one in parts):
        return None
    return math.prod(float(one.getMultiplier() * 10.0 ** one.getScale()) ** one.getExponentAsDouble() for one in parts)
