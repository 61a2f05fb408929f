"""Reading of signalling networks from two CSV files, one of species and one of reactions."""

from __future__ import annotations

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
from .tables import read_table

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
    states, (start, y_max, tau_h), assumed = _table(species, SPECIES, SPECIES[1:])
    links, (weight, n, ec50), assumed_of_links = _table(reactions, REACTIONS, REACTIONS[2:])
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
    notes = [*assumed, *assumed_of_links, *(f'Nothing acts on "{name}": it decays to 0.' for name in wiring.undriven)]
    slowest_h = float(hours_from_seconds(tau.max()))
    return NetworkModel(law, start, weight[wiring.input_reactions], y_max, slowest_h, True, tuple(notes))


def _table(
    path: Path, columns: Sequence[str], numbers: Sequence[str]
) -> tuple[list[Row], list[np.ndarray], Sequence[str]]:
    """Read a table: its rows, its columns ``numbers`` (n_rows,), and what was assumed on reading."""
    table = read_table(path, columns)
    table.require(columns)
    found = table.numbers(numbers)
    for row, name in enumerate(table.texts("id")):
        if not name:
            raise InputError(f"{path}: row {table.lines[row]} has no id")
        for key in (key for key in numbers if not np.isfinite(found[key][row])):
            raise table.fault(row, key, f'must be a number; "{name}" has none')
    return [dict(zip(table.names, row)) for row in table.rows], [found[key] for key in numbers], table.notes


def _rule(path: Path, number: int, row: Row) -> Any:
    try:
        return parse_rule(row["rule"])
    except InputError as error:
        raise InputError(f'{path}: reaction "{row["id"]}" {error}') from None
