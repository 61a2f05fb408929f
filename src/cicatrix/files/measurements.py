"""Tables of measured stretches and stresses: known columns, and what to do with the columns of others."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..core.errors import InputError
from .tables import missing_column, read_table

STRETCHES = ("lambda_x", "lambda_y", "lambda_z")
STRESSES = ("sigma_x_kPa", "sigma_y_kPa", "sigma_z_kPa", "sigma_xy_kPa")
COLUMNS = ("time_h", *STRETCHES, "shear", *STRESSES)

CONVERSIONS = {  # what a known column begins with: pairs of (pattern of a column found, how to make the known one of it)
    "time": (
        (r"^t(ime)?\W*_?(s|sec|second)s?\b|^seconds?$", "divide {found} by 3600"),
        (r"^t(ime)?\W*_?(min|minute)s?\b|^minutes?$", "divide {found} by 60"),
        (r"^t(ime)?\W*_?(d|day)s?\b|^days?$", "multiply {found} by 24"),
        (r"^t(ime)?\W*_?(ms|millisecond)s?\b", "divide {found} by 3.6e6"),
        (r"^t(ime)?$", "rename {found}, in hours"),
    ),
    "lambda": (
        (r"strain.*(%|percent|pct)|^eps.*(%|percent|pct)", "take 1 + {found} / 100"),
        (r"strain|^eps|^e_?[xyz]?$|^e_[xyz]", "take 1 + {found}"),
        (r"stretch|^lambda|^l_?[xyz]?$", "rename {found}, which must be 1 at rest and not percent"),
        (r"displace|^u_?[xyz]|elongation|length|extension", "take the length over the length at rest"),
    ),
    "sigma": (
        (
            r"nominal|engineering|piola|pk1|^p_?[xyz]",
            "take {found} * {stretch}: Cauchy stress of incompressible tissue is nominal stress times stretch",
        ),
        (r"(stress|sigma).*mpa", "multiply {found} by 1000"),
        (r"(stress|sigma).*(?<![km])pa", "divide {found} by 1000"),
        (r"stress|sigma", "rename {found}, which must be Cauchy stress in kPa"),
        (r"force|^f_?[xyz]|load", "take {found} * {stretch} over the area at rest"),
    ),
}


class Measurements(NamedTuple):
    """Columns that were measured on a specimen, as read."""

    columns: Mapping[str, np.ndarray]
    """Known columns (n,), :data:`COLUMNS`; a missing value is NaN."""
    lines: tuple[int, ...] = ()
    """Row of the file for each measurement; without a file they are counted from 1."""
    others: tuple[str, ...] = ()
    """Names of the columns that are not known."""
    notes: tuple[str, ...] = ()
    """What was assumed on reading, in sentences."""

    def row(self, index: int) -> int:
        """Return the number of a row, as a text editor counts."""
        return self.lines[index] if self.lines else index + 1

    def missing(self, name: str) -> InputError:
        """Return the error for a time, stretch or stress that is not there: what is similar, or of what it can be computed."""
        there = (*self.columns, *self.others)
        for pattern, words in CONVERSIONS[name.partition("_")[0]]:
            stretch = name.replace("sigma", "lambda").removesuffix("_kPa")
            for found in (other for other in self.others if re.search(pattern, other.lower())):
                how = words.format(found=f'"{found}"', stretch=stretch)
                return InputError(f"column {name} is missing: {how}; there are {', '.join(filter(None, there))}")
        return InputError(missing_column(name, there))


def read_measurements(path: Path) -> Measurements:
    """Read a table such as a run's ``history.csv``: the known columns that it has.

    Raises
    ------
    InputError
        As :func:`.tables.read_table`, or if a known column holds something that is no number.
    """
    table = read_table(path, COLUMNS)
    columns = table.numbers([name for name in COLUMNS if name in table.names])
    others = tuple(name for name in table.names if name not in COLUMNS)
    return Measurements(columns, table.lines, others, table.notes)
