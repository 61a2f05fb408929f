"""Base class of constitutive and rate laws, whose parameters have units and ranges and are differentiable."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .errors import InputError
from .precision import use_double_precision

use_double_precision()


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
    """Declare a parameter of a law: its unit, symbol and range.

    The range is closed, [low, high], or open below, (above, high], if ``above`` is given. The value is a number or an array
    with one value per point; a ``static`` parameter is a single number and not differentiable. In a case file the parameter has
    the unit ``typed`` (such as "h" for a time in s, "deg" for an angle in rad), by default the law's own unit; its key is the
    field's name followed by that unit, as in ``tau_h``.
    """
    bounds = {"low": low if above is None else above, "high": high, "is_open": above is not None}
    metadata = {"unit": unit, "symbol": symbol, "typed": typed or unit, **bounds}
    return _declared(metadata, default, static=static)


def count(symbol: str, *, low: int, high: int, default: int) -> Any:
    """Declare an integer resolution parameter, such as a number of quadrature points: static, the same at all points."""
    metadata = {"unit": "1", "symbol": symbol, "low": low, "high": high, "is_open": False, "typed": "1"}
    return _declared(metadata, default, static=True)


def choice(types: Mapping[str, type], *, default: Any = dataclasses.MISSING) -> Any:
    """Declare a component of a law with several possible types; a case file selects one by ``type`` in an inline table."""
    return _declared({"types": dict(types)}, default)


def _declared(metadata: dict[str, Any], default: Any, *, static: bool = False) -> Any:
    given = {} if default is dataclasses.MISSING else {"default": default}
    return eqx.field(static=static, metadata=metadata, **given)


class Law(eqx.Module):
    """Base class of laws: an immutable record of differentiable parameters, which rejects values outside their ranges.

    Raises
    ------
    InputError
        If a parameter is NaN or outside the range declared by its ``param``.
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
        return  # inside a JAX transformation: already checked when the law was created
    said, smallest, largest = field.metadata, np.min(value), np.max(value)
    is_inside = smallest > said["low"] if said["is_open"] else smallest >= said["low"]
    if not (is_inside and largest <= said["high"]):
        unit = "" if said["unit"] == "1" else f" {said['unit']}"
        found = f"{smallest:g}" if smallest == largest else f"{smallest:g} .. {largest:g}"
        raise InputError(
            f"{law}.{field.name} ({said['symbol']}) must lie in {'(' if said['is_open'] else '['}{said['low']:g}, "
            f"{said['high']:g}]{unit}; got {found}."
        )
