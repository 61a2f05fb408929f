"""Names of columns in the sheets of the program Netflux, and what it means by them.

A Netflux model is a workbook with the sheets "species" (module, ID, name, Yinit, Ymax, tau) and "reactions" (module, ID, Rule,
Weight, n, EC50), each below a row with a title. Its NOT is w - act.

Source: Clark et al., PLOS Computational Biology 21:e1012864 (2025), and the program's own code.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..core.errors import InputError
from .opening import regular_file
from .tables import CsvTable

TAU = "tau"  # time constant in a unit that the sheet does not state
TAUS = {f"tau_{unit}": unit for unit in ("h", "s", "min", "d")}
NAMES = {
    "id": ("id", "speciesid", "reactionid"),
    "y_init": ("yinit", "y0", "yinitial"),
    "y_max": ("ymax",),
    TAU: ("tau",),
    **{name: (name.replace("_", ""),) for name in TAUS},
    "rule": ("rule", "reactionrule"),
    "weight": ("weight", "w"),
    "n": ("n",),
    "ec50": ("ec50",),
}
SPELLINGS = ("ID", "Yinit", "Y0", "Ymax", *TAUS, TAU, "Rule", "Weight", "EC50")  # by which the row of names is known
OURS = {plain: name for name, plains in NAMES.items() for plain in plains}
WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # first bytes of .xlsx and .xls files


def in_our_names(table: CsvTable) -> CsvTable:
    """Return a table with its columns in our spelling, and without headings: rows whose only cell is no id."""
    names = our_names(table.names)
    at = names.index("id") if "id" in names else None
    kept = [n for n, row in enumerate(table.rows) if at is None or row[at] or sum(map(bool, row)) != 1]
    return replace(
        table,
        names=tuple(names),
        rows=tuple(table.rows[n] for n in kept),
        lines=tuple(table.lines[n] for n in kept),
    )


def our_names(names: Sequence[str]) -> list[str]:
    """Return the columns' names in our spelling, whatever their case, spaces and underscores; other names stay as they are."""
    found = [OURS.get(re.sub(r"[^a-z0-9]", "", name.lower()), name) for name in names]
    return [
        name if ours != name and (ours in names or ours in found[:k]) else ours
        for k, (name, ours) in enumerate(zip(names, found))
    ]


def refuse_workbook(path: Path) -> None:
    """Check that a file is not a workbook of a spreadsheet program.

    Raises
    ------
    InputError
        If it is; the message says how to save it.
    """
    regular_file(path)
    with path.open("rb") as stream:
        if stream.read(4) in WORKBOOKS:
            raise InputError(
                f"{path} is a spreadsheet workbook: save its sheets, species and reactions, as two CSV files"
            )
