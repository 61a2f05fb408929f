"""Reading of signalling networks from two CSV files, one of species and one of reactions."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..biology.network import HillNetwork, Inhibition
from ..biology.network_model import NetworkModel
from ..biology.rules import parse_rule
from ..biology.wiring import Wiring
from ..core.errors import InputError
from ..core.units import hours_from_seconds, seconds_from_hours
from .text import text_of

SPECIES = ("id", "y_init", "y_max", "tau_h")
REACTIONS = ("id", "rule", "weight", "n", "ec50")
Row = dict[str, str]


def read_network(species: Path, reactions: Path, inhibition: Inhibition = "complement") -> NetworkModel:
    """Read a network of normalised Hill functions; other columns than those below, such as ``source``, are ignored.

    Parameters
    ----------
    species : Path
        Columns ``id``, ``y_init``, ``y_max`` [1], ``tau_h`` [h].
    reactions : Path
        Columns ``id``, ``rule`` (``TGFB & !smad7 => smad3``), ``weight``, ``n``, ``ec50`` [1].
    inhibition : str
        "complement" or "weighted", as in :class:`.HillNetwork`.
    """
    states, links = _table(species, SPECIES), _table(reactions, REACTIONS)
    start, y_max, tau_h = (_numbers(species, states, key) for key in SPECIES[1:])
    weight, n, ec50 = (_numbers(reactions, links, key) for key in REACTIONS[2:])
    for key, is_good, words in (("y_init", start >= 0.0, "at least 0"), ("tau_h", tau_h > 0.0, "above 0")):
        for row in (row for row, good in zip(states, is_good) if not good):
            raise InputError(f'{species}: species "{row["id"]}": {key} must be {words}; got {row[key]}')
    rules = tuple(_rule(reactions, number, row) for number, row in enumerate(links))
    tau = seconds_from_hours(tau_h)
    try:
        wiring = Wiring(tuple(row["id"] for row in states), tuple(row["id"] for row in links), rules)
        law = HillNetwork(wiring, y_max, tau, weight, n, ec50, inhibition)
    except InputError as error:
        path = species if str(error).startswith("species") else reactions
        raise InputError(f"{path}: {error}") from None
    notes = [f'Nothing acts on "{name}": it decays to 0.' for name in wiring.undriven]
    slowest_h = float(hours_from_seconds(tau.max()))
    return NetworkModel(law, start, weight[wiring.input_reactions], y_max, slowest_h, True, tuple(notes))


def _table(path: Path, columns: Sequence[str]) -> list[Row]:
    """Read the rows of a CSV file, without empty lines."""
    rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text_of(path)))]
    lines = [(number, row) for number, row in enumerate(rows, 1) if any(row)]
    if not lines:
        raise InputError(f"{path} is empty: it must start with a row of column names, {', '.join(columns)}")
    head = lines[0][1]
    missing = [name for name in columns if name not in head]
    if missing:
        raise InputError(f"{path}: column {missing[0]} is missing; there are {', '.join(head)}")
    if len(lines) < 2:
        raise InputError(f"{path} has no rows below its column names")
    for number, row in lines[1:]:
        if len(row) != len(head):
            raise InputError(f"{path}: row {number} must have {len(head)} columns, like the first row; got {len(row)}")
        if not row[head.index("id")]:
            raise InputError(f"{path}: row {number} has no id")
    return [dict(zip(head, row)) for _, row in lines[1:]]


def _numbers(path: Path, rows: list[Row], key: str) -> np.ndarray:
    return np.array([_number(path, row, key) for row in rows])


def _number(path: Path, row: Row, key: str) -> float:
    try:
        value = float(row[key])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f'{path}: "{row["id"]}": {key} must be a number; got "{row[key]}"')
    return value


def _rule(path: Path, number: int, row: Row) -> Any:
    try:
        return parse_rule(row["rule"])
    except InputError as error:
        raise InputError(f'{path}: reaction "{row["id"]}" {error}') from None
