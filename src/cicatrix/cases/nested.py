"""Functions for the nested tables of a case file: copy them, set the value at a dotted key, find the values that name files."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from .paths import input_path
from .sentences import dotted

DEEPEST = 50  # tables and lists within each other
LEAST, MOST = -(2**63), 2**63 - 1  # whole numbers of TOML


def copied(value: Any, at: tuple[str | int, ...] = ()) -> Any:
    """Copy nested tables and lists, so that the copy may be changed; arrays and numbers of NumPy become Python's own.

    ``at``: the keys that lead to the value.

    Raises
    ------
    InputError
        If they nest too deep, or a whole number has more than the 64 bits that TOML has.
    """
    if len(at) > DEEPEST:
        raise InputError(f"{dotted(at[:3])}...: tables and lists may nest {DEEPEST} deep at most")
    if isinstance(value, Mapping):
        return {key: copied(item, (*at, key)) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [copied(item, (*at, number)) for number, item in enumerate(value)]
    if isinstance(value, int) and not LEAST <= value <= MOST:
        words = "must be between -2^63 and 2^63 - 1, as whole numbers in TOML are"
        raise InputError(f"{dotted(at)} {words}; got one of {value.bit_length()} bits")
    return value.tolist() if hasattr(value, "tolist") else value


def names_of(key: str) -> list[str]:
    """Split a dotted key at its dots; an index in brackets, as in ``law[0].mu_kPa``, is the same as in ``law.0.mu_kPa``."""
    return [part.strip() for part in re.sub(r"\[(\d+)\]", r".\1", key).split(".")]


def put(tables: dict[str, Any], names: Sequence[str], value: Any, subject: str) -> None:
    """Set the value at a dotted key, given as its names, and create missing tables on its path; None removes the key.

    Raises
    ------
    InputError
        If a key before the last one is not a table, or an index is out of range; the message begins with ``subject``.
    """
    for depth, name in enumerate(names[:-1]):
        if name in tables and isinstance(tables[name], list):
            return _put_in_list(tables[name], names[depth:], value, subject)
        if value is None and name not in tables:
            return None  # there is nothing to remove
        tables = tables.setdefault(name, {})
        if not isinstance(tables, dict):
            raise InputError(f"{subject}: {'.'.join(names[: depth + 1])} is not a table")
    if value is None:
        tables.pop(names[-1], None)
    else:
        tables[names[-1]] = value
    return None


def _put_in_list(items: list[Any], names: Sequence[str], value: Any, subject: str) -> None:
    """Set a value within a list: ``names`` has the list's name, the item's index from 0 and, if any, the keys inside the item."""
    name, number, *below = names
    if not number.isdecimal() or len(number) > 9 or int(number) >= len(items):
        raise InputError(f"{subject}: {name} is a list; name one of 0 to {len(items) - 1}, such as {name}.0")
    if not below and value is None:
        del items[int(number)]
    elif not below:
        items[int(number)] = value
    elif isinstance(items[int(number)], dict):
        put(items[int(number)], below, value, subject)
    else:
        raise InputError(f"{subject}: {name}.{number} is not a table")


def files_in(tables: dict[str, Any], names: Sequence[str]) -> dict[str, tuple[dict[str, Any], str]]:
    """Return the table and key of each value that names a file, by dotted name; missing values are left out."""
    out = {}
    for name in names:
        *path, key = name.split(".")
        within: Any = tables
        for part in path:
            within = within.get(part) if isinstance(within, dict) else None
        if isinstance(within, dict) and key in within:
            out[name] = within, key
    return out


def locate(tables: dict[str, Any], files: Sequence[str], folder: Path) -> list[str]:
    """Resolve in place the paths at the dotted keys ``files``; return one sentence for each file that does not exist."""
    faults = []
    for name, (table, key) in files_in(tables, files).items():
        if isinstance(table[key], (str, Path)):
            try:
                table[key] = input_path(str(table[key]), folder)
            except InputError as error:
                table[key] = Path(table[key])  # the missing file is the only fault to report here
                faults.append(f"{name} {error}")
    return faults
