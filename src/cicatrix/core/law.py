"""What every constitutive or rate law shares: named, range-checked, differentiable parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .errors import InputError

jax.config.update("jax_enable_x64", True)  # every law in double precision


def param(
    unit: str,
    symbol: str,
    *,
    low: float = -np.inf,
    high: float = np.inf,
    above: float | None = None,
    default: Any = dataclasses.MISSING,
    typed: str | None = None,
    static: bool = False,
) -> Any:
    """Declare a parameter of a law: its unit, symbol and range, closed unless it is to be ``above`` a number.

    The value is a number or an array of one number per point; ``static`` ones are numbers, and not differentiable. A case
    file's key is the field's name and the unit that is ``typed`` there ("h" of a time in s, "deg" of an angle in rad), that
    of the law if nothing is said.
    """
    bounds = {"low": low if above is None else above, "high": high, "is_open": above is not None}
    metadata = {"unit": unit, "symbol": symbol, "typed": typed or unit, **bounds}
    return _declared(metadata, default, static=static)


def count(symbol: str, *, low: int, high: int, default: int) -> Any:
    """Declare a whole number that says how finely a law integrates: not differentiable, the same at all points."""
    metadata = {"unit": "1", "symbol": symbol, "low": low, "high": high, "is_open": False, "typed": "1"}
    return _declared(metadata, default, static=True)


def choice(types: Mapping[str, type], *, default: Any = dataclasses.MISSING) -> Any:
    """Declare a part of a law that may be of several types; a case file names one by ``type`` in an inline table."""
    return _declared({"types": dict(types)}, default)


def _declared(metadata: dict[str, Any], default: Any, *, static: bool = False) -> Any:
    given = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(static=static, metadata=metadata, **given)


class Law(eqx.Module):
    """A frozen, differentiable record of parameters; refuses values outside their range.

    Raises
    ------
    InputError
        If a parameter is NaN or outside the range that its ``param`` names.
    """

    def __check_init__(self):
        for field in dataclasses.fields(self):
            if "symbol" in field.metadata:
                _check_range(type(self).__name__, field, getattr(self, field.name))


def _check_range(law: str, field: dataclasses.Field, value: Any) -> None:
    if isinstance(value, tuple):
        for one in value:
            _check_range(law, field, one)
        return
    if isinstance(value, jax.core.Tracer) or not isinstance(value, (int, float, np.ndarray, jax.Array)):
        return  # inside a transformation: checked when the law was made
    said, smallest, largest = field.metadata, np.min(value), np.max(value)
    is_inside = smallest > said["low"] if said["is_open"] else smallest >= said["low"]
    if not (is_inside and largest <= said["high"]):
        unit = "" if said["unit"] == "1" else f" {said['unit']}"
        found = f"{smallest:g}" if smallest == largest else f"{smallest:g} .. {largest:g}"
        raise InputError(
            f"{law}.{field.name} ({said['symbol']}) must lie in {'(' if said['is_open'] else '['}{said['low']:g}, "
            f"{said['high']:g}]{unit}; got {found}."
        )
