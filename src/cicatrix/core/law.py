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
    default: Any = dataclasses.MISSING,
    typed: str | None = None,
    static: bool = False,
) -> Any:
    """Declare a parameter of a law: its unit, symbol and closed range.

    The value is a number or an array of one number per point; ``static`` ones are numbers, and not differentiable. A case
    file's key is the field's name and the unit that is ``typed`` there ("h" of a time in s, "deg" of an angle in rad), that
    of the law if nothing is said.
    """
    metadata = {"unit": unit, "symbol": symbol, "low": low, "high": high, "typed": typed or unit}
    given = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(static=static, metadata=metadata, **given)


def count(symbol: str, *, low: int, high: int, default: int) -> Any:
    """Declare a whole number that says how finely a law integrates: not differentiable, the same at all points."""
    metadata = {"unit": "1", "symbol": symbol, "low": low, "high": high, "typed": "1"}
    return eqx.field(static=True, metadata=metadata, default=default)


def choice(types: Mapping[str, type], *, default: Any = dataclasses.MISSING) -> Any:
    """Declare a part of a law that may be of several types; a case file names one by ``type`` in an inline table."""
    metadata = {"types": dict(types)}
    return (
        eqx.field(metadata=metadata)
        if default is dataclasses.MISSING
        else eqx.field(metadata=metadata, default=default)
    )


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
    low, high = field.metadata["low"], field.metadata["high"]
    smallest, largest = np.min(value), np.max(value)
    if not (low <= smallest and largest <= high):
        raise InputError(
            f"{law}.{field.name} ({field.metadata['symbol']}) must lie in [{low:g}, {high:g}] {field.metadata['unit']}; "
            f"got {smallest:g} .. {largest:g}."
        )
