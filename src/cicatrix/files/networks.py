"""Reading of signalling networks from two CSV files, one of species and one of reactions, ours or those of Netflux."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..biology.network import HillNetwork, Inhibition
from ..biology.network_model import NetworkModel
from ..biology.rules import Rule, parse_rule
from ..biology.wiring import Wiring
from ..core.errors import InputError
from ..core.units import hours_from_seconds, unit_factor
from .netflux import SPELLINGS, TAU, TAUS, in_our_names, refuse_workbook
from .tables import read_table

SPECIES = ("id", "y_init", "y_max", TAU)
REACTIONS = ("id", "rule", "weight", "n", "ec50")
Row = dict[str, str]


def read_network(
    species: Path,
    reactions: Path,
    inhibition: Inhibition | None = None,
    time_unit: str | None = None,
    *,
    may_assume: bool = False,
) -> NetworkModel:
    """Read a network of normalised Hill functions; other columns than those below, such as ``source``, are ignored.

    The columns may be spelt as in the sheets of the program Netflux (``ID``, ``Yinit``, ``Ymax``, ``tau``, ``Rule``, ``EC50``),
    which may also have a title above them and headings without an id between their rows.

    Parameters
    ----------
    species : Path
        Columns ``id``, ``y_init``, ``y_max`` [1], and ``tau_h`` [h], ``tau_min``, ``tau_s``, ``tau_d`` or ``tau``.
    reactions : Path
        Columns ``id``, ``rule`` (``TGFB & !smad7 => smad3``), ``weight``, ``n``, ``ec50`` [1].
    inhibition : str, optional
        "complement" or "weighted", as in :class:`.HillNetwork`. By default "complement"; "weighted" where the column ``tau``
        says that the sheets are those of Netflux.
    time_unit : str, optional
        Unit of the column ``tau``: "s", "min", "h" or "d".
    may_assume : bool
        Whether the column ``tau`` is in hours, with a note, where its unit is not given; else it is refused.

    Raises
    ------
    InputError
        If a file is not valid; the message names the file, the row and the error.
    """
    states, (start, y_max, tau), assumed = _table(species, SPECIES, SPECIES[1:])
    links, (weight, n, ec50), assumed_of_links = _table(reactions, REACTIONS, REACTIONS[2:])
    tau_key = _tau_key(list(states[0]))
    if tau_key == TAU and time_unit is None and not may_assume:
        raise InputError(f"{species}: the column tau states no unit: name it tau_h, tau_min, tau_s or tau_d")
    for key, is_good, words in (("y_init", start >= 0.0, "at least 0"), (tau_key, tau > 0.0, "above 0")):
        for row in (row for row, good in zip(states, is_good) if not good):
            raise InputError(f'{species}: species "{row["id"]}": {key} must be {words}; got {row[key]}')
    rules = tuple(_rule(reactions, number, row) for number, row in enumerate(links))
    seconds = tau * unit_factor(TAUS.get(tau_key) or time_unit or "h", "s")
    kind = inhibition or ("weighted" if tau_key == TAU else "complement")
    try:
        wiring = Wiring(tuple(row["id"] for row in states), tuple(row["id"] for row in links), rules)
        law = HillNetwork(wiring, y_max, seconds, weight, n, ec50, kind)
    except InputError as error:
        path = species if str(error).startswith("species") else reactions
        raise InputError(f"{path}: {error}") from None
    notes = [*assumed, *assumed_of_links, *_notes(law, start)]
    if tau_key == TAU:
        notes += _assumed(law, inhibition, time_unit)
    slowest_h = float(hours_from_seconds(seconds.max()))
    return NetworkModel(law, start, weight[wiring.input_reactions], y_max, slowest_h, True, tuple(notes))


def _notes(law: HillNetwork, start: np.ndarray) -> Iterator[str]:
    """Yield notes on what a network may not have been meant to be."""
    for name in law.wiring.undriven:
        yield f'Nothing acts on "{name}": it decays to 0.'
    for one, other, rule in law.wiring.repeated:
        yield f'Reactions "{one}" and "{other}" have the same rule, {rule}: each of them counts, joined by OR.'
    for name in law.saturating(np.maximum(law.y_max, start)):
        yield (
            f'"{name}" can exceed 1: a reaction with EC50^n above 1/2 then counts it as 1, as the program Netflux does.'
        )


def _assumed(law: HillNetwork, inhibition: Inhibition | None, time_unit: str | None) -> Iterator[str]:
    """Yield notes on what was assumed because the column ``tau`` is one of Netflux."""
    if time_unit is None:
        yield "The column tau states no unit: its time constants were taken as hours; network.time_unit sets another unit."
    if inhibition is None and np.any((law.wiring.n_negated > 0) & (law.weight < 1.0)):
        yield (
            "The column tau is one of Netflux: NOT is w - act, as in that program; "
            'network.inhibition = "complement" makes it 1 - act.'
        )


def _table(
    path: Path, columns: Sequence[str], numbers: Sequence[str]
) -> tuple[list[Row], list[np.ndarray], Sequence[str]]:
    """Read a table without headings between its rows: the rows, the columns ``numbers`` (n_rows,), and what was assumed."""
    refuse_workbook(path)
    table = in_our_names(read_table(path, ["tau_h" if column == TAU else column for column in columns], SPELLINGS))
    numbers = [_tau_key(table.names) if key == TAU else key for key in numbers]
    table.require([column for column in columns if column != TAU])
    found = table.numbers(numbers)
    for row, name in enumerate(table.texts("id")):
        if not name:
            raise InputError(f"{path}: row {table.lines[row]} has no id")
        for key in (key for key in numbers if not np.isfinite(found[key][row])):
            raise table.fault(row, key, f'must be a number; "{name}" has none')
    return [dict(zip(table.names, row)) for row in table.rows], [found[key] for key in numbers], table.notes


def _tau_key(names: Sequence[str]) -> str:
    """Return the column of time constants: one whose name states the unit, or ``tau``; by default ``tau_h``."""
    return next((key for key in (*TAUS, TAU) if key in names), "tau_h")


def _rule(path: Path, number: int, row: Row) -> Rule:
    try:
        return parse_rule(row["rule"])
    except InputError as error:
        raise InputError(f'{path}: reaction "{row["id"]}" {error}') from None
