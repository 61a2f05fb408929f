"""Numerical parameters of a case's laws by key, such as ``law.0.mu_kPa``: list them, and replace them in a case."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..core.errors import InputError
from ..core.units import unit_factor
from .laws import LawTable, NamesALaw, key_of
from .table import Table


def parameters_of(case: NamesALaw) -> dict[str, float | None]:
    """Return the law parameters with respect to which a history can be differentiated: key -> value (None if not a number)."""
    found: dict[str, float | None] = {}
    for name in ("law", "growth"):
        found.update(_leaves(name, getattr(case, name)))
    return found


def known(case: NamesALaw, key: str) -> float | None:
    """Return the value of a parameter by its key; None if the value is not a number.

    Raises
    ------
    InputError
        If no law has such a parameter; the message names the most similar key, or all keys.
    """
    there = parameters_of(case)
    if key in there:
        return there[key]
    near = difflib.get_close_matches(key, there, n=1)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(there)}"
    raise InputError(f"{key} is not a parameter of a law that can be fitted; {hint}")


def replaced(case: NamesALaw, values: Mapping[str, Any]) -> NamesALaw:
    """Return the case with other values for known keys; the values may be traced by JAX, and are not checked here."""
    for key, value in values.items():
        case = _put(case, key.split("."), value)
    return case


def _leaves(at: str, value: Any) -> Iterator[tuple[str, float | None]]:
    if isinstance(value, Table):
        held = _held(value)
        for name in type(value).model_fields:
            if name in held:
                yield f"{at}.{name}", held[name]
            elif not _is_static(value, name):
                yield from _leaves(f"{at}.{name}", getattr(value, name))
    elif isinstance(value, tuple):
        for number, item in enumerate(value):
            yield from _leaves(f"{at}.{number}", item)
    elif isinstance(value, float):
        yield at, value


def _held(table: Table) -> dict[str, float | None]:
    """Return the defaults of parameters missing in a table: key -> value in the units of case files (None if not a number)."""
    fields = dataclasses.fields(table.made) if isinstance(table, LawTable) else ()
    out: dict[str, float | None] = {}
    for field in fields:
        is_unsaid = "symbol" in field.metadata and getattr(table, key_of(field), None) is None
        if is_unsaid and not field.metadata.get("static"):
            default = field.default if isinstance(field.default, float) else None
            out[key_of(field)] = default and default / unit_factor(field.metadata["typed"], field.metadata["unit"])
    return out


def _is_static(table: Table, name: str) -> bool:
    fields = dataclasses.fields(table.made) if isinstance(table, LawTable) else ()
    return any(field.metadata.get("static") and key_of(field) == name for field in fields)


def _put(tables: Any, names: Sequence[str], value: Any) -> Any:
    if not names:
        return value
    first, *rest = names
    if isinstance(tables, tuple):
        at = int(first)
        return (*tables[:at], _put(tables[at], rest, value), *tables[at + 1 :])
    return tables.unchecked(**{first: _put(getattr(tables, first), rest, value)})
