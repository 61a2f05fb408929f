"""Curves of a run: the columns of its history with names and units, and the closing cavity with clinical points."""

from __future__ import annotations

from typing import Any

import numpy as np

from .run_view import RunView

TIMES = (
    "time_days",
    "time_h",
    "time_s",
    "step",
    "cycle",
    "seconds",
)  # candidates for the horizontal axis; the first one in the history is used
UNITS = {  # suffix of a column's name -> unit; longest suffix first
    "g_per_mm3": "g/mm³",
    "per_mm3": "1/mm³",
    "percent": "%",
    "days": "days",
    "kPa": "kPa",
    "MPa": "MPa",
    "mm2": "mm²",
    "mm3": "mm³",
    "mm": "mm",
    "um": "µm",
    "uJ": "µJ",
    "pN": "pN",
    "h": "h",
    "s": "s",
}
CLINIC = {"days": [23, 32, 39, 45], "percent": [100, 60, 48, 40]}  # cavity on MRI; docs/theory/clinic.md


def curves_of(view: RunView) -> dict[str, Any] | None:
    """Return the numeric columns of the history and the name of the horizontal axis; None with fewer than two rows."""
    columns = {name: values for name, values in view.results.history.items() if values.dtype.kind in "if"}
    over = next((name for name in TIMES if name in columns), None)
    if over is None or columns[over].size < 2:
        return None
    return {
        "over": over,
        "columns": [
            {"name": name, "label": words(name)[0], "unit": words(name)[1], "values": values.astype(float)}
            for name, values in columns.items()
        ],
    }


def words(name: str) -> tuple[str, str]:
    """Split a column's name into words and unit; the unit is "1" for pure numbers."""
    for tail, unit in UNITS.items():
        if name.endswith(f"_{tail}"):
            return name.removesuffix(f"_{tail}").replace("_", " "), unit
    return name.replace("_", " "), "1"


def closing_of(view: RunView) -> dict[str, Any] | None:
    """Return the open fraction of the cavity over time [%, days] with the clinical points; None if the run has no cavity."""
    closed, days = view.column("closed_fraction"), view.column("time_days")
    if view.kind != "lumpectomy" or closed.size == 0:
        return None
    sizes = [name for name in ("open_volume_mm3", "open_area_mm2") if view.column(name).size]
    size = view.column(sizes[0]) if sizes else np.zeros(0)
    return {
        "days": days.astype(float),
        "percent": 100.0 * (1.0 - closed),
        "size": size.astype(float),
        "sizeName": sizes[0] if sizes else "",
        "clinic": CLINIC,
    }
