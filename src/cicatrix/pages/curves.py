"""Curves of a run: its history as columns with names and units, and the clinic's points beside a closing cavity."""

from __future__ import annotations

from typing import Any

import numpy as np

from .account import Account

TIMES = (
    "time_days",
    "time_h",
    "time_s",
    "step",
    "cycle",
    "seconds",
)  # what a history is drawn over, the first that it has
UNITS = {  # ends of columns' names, longest first
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


def curves_of(account: Account) -> dict[str, Any] | None:
    """Columns of the history that are numbers, by what they are drawn over; None without two rows."""
    columns = {name: values for name, values in account.results.history.items() if values.dtype.kind in "if"}
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
    """A column's name without its unit, and the unit; "1" for numbers without one."""
    for tail, unit in UNITS.items():
        if name.endswith(f"_{tail}"):
            return name.removesuffix(f"_{tail}").replace("_", " "), unit
    return name.replace("_", " "), "1"


def closing_of(account: Account) -> dict[str, Any] | None:
    """How the cavity closes: open share over days [%], with the clinic's points; None for other runs."""
    closed, days = account.column("closed_fraction"), account.column("time_days")
    if account.kind != "lumpectomy" or closed.size == 0:
        return None
    sizes = [name for name in ("open_volume_mm3", "open_area_mm2") if account.column(name).size]
    size = account.column(sizes[0]) if sizes else np.zeros(0)
    return {
        "days": days.astype(float),
        "percent": 100.0 * (1.0 - closed),
        "size": size.astype(float),
        "sizeName": sizes[0] if sizes else "",
        "clinic": CLINIC,
    }
