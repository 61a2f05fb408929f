"""Numbers with a unit and a note."""

from __future__ import annotations

import html
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

COLUMNS = 100  # longest text that stands for a quantity


def _operator(operate: Callable[[Any, Any], Any], needs_equal_units: bool = False) -> tuple[Any, Any]:
    """Make the two methods of an operator: with the quantity on the left, and on the right."""

    def operand(quantity: Quantity, other: Any) -> Any:
        if not isinstance(other, Quantity):
            return other
        if needs_equal_units and other.unit != quantity.unit:
            raise TypeError(f"{quantity!r} and {other!r} have different units; convert one, and use .value")
        return other.number

    def on_the_left(self: Quantity, other: Any) -> Any:
        return operate(self.number, operand(self, other))

    def on_the_right(self: Quantity, other: Any) -> Any:
        return operate(operand(self, other), self.number)

    return on_the_left, on_the_right


@dataclass(frozen=True, eq=False, repr=False)
class Quantity:
    """A value with its unit and a note; behaves like a number, or like an array where the value is a list.

    Arithmetic, comparisons and NumPy functions give plain numbers and arrays: the unit is not propagated. Sums, differences and
    comparisons of two quantities with different units are refused. A value that is a text, a table or missing is accessed by
    ``.value`` and ``[...]``; using it as a number raises TypeError.

    Parameters
    ----------
    value : number, text, list, mapping or None
        The value; None if there is none, and the note says why.
    unit : str
        Unit of the value; "1" if it has none.
    note : str
        What the value is, or why it is missing.

    Examples
    --------
    >>> depth = Quantity(12.5, "mm")
    >>> depth, depth / 10, f"{depth:.2f}", depth > 3
    (12.5 mm, 1.25, '12.50', True)
    """

    value: Any
    unit: str
    note: str = ""

    @property
    def number(self) -> Any:
        """The value as a plain number, or as an array (...) where it is a list; None in a list is NaN.

        Raises
        ------
        TypeError
            If the value is missing, a text or a table.
        """
        value = self.value
        if isinstance(value, (list, tuple, np.ndarray)):
            return self._array(value)
        if value is None or isinstance(value, (str, Mapping)):
            raise TypeError(self._why_not())
        return value

    def _array(self, values: Any) -> np.ndarray:
        try:
            array = np.asarray(values)
            array = array.astype(float) if array.dtype == object else array
        except (TypeError, ValueError):
            raise TypeError(self._why_not()) from None
        if array.dtype.kind not in "biufc":
            raise TypeError(self._why_not())
        return array

    def _why_not(self) -> str:
        if self.value is None:
            return f"there is no number: {self.note or 'the value is missing'}"
        kinds = {str: "a text", dict: "a table"}
        what = next((words for kind, words in kinds.items() if isinstance(self.value, kind)), "a list")
        return f"the value is {what}, not a number: {self!r}"

    __add__, __radd__ = _operator(operator.add, needs_equal_units=True)
    __sub__, __rsub__ = _operator(operator.sub, needs_equal_units=True)
    __mul__, __rmul__ = _operator(operator.mul)
    __truediv__, __rtruediv__ = _operator(operator.truediv)
    __floordiv__, __rfloordiv__ = _operator(operator.floordiv)
    __mod__, __rmod__ = _operator(operator.mod)
    __pow__, __rpow__ = _operator(operator.pow)
    __divmod__, __rdivmod__ = _operator(divmod)
    __lt__, _ = _operator(operator.lt, needs_equal_units=True)
    __le__, _ = _operator(operator.le, needs_equal_units=True)
    __gt__, _ = _operator(operator.gt, needs_equal_units=True)
    __ge__, _ = _operator(operator.ge, needs_equal_units=True)
    del _

    def __eq__(self, other: object) -> Any:
        """Compare value, unit and note with another quantity, and the value alone with anything else."""
        if isinstance(other, Quantity):
            return (self.value, self.unit, self.note) == (other.value, other.unit, other.note)
        if isinstance(self.value, (list, tuple, np.ndarray)):
            return self.number == other
        return self.value == other

    def __hash__(self) -> int:
        """Return the hash of the value, as a quantity equals its value."""
        return hash(self.value)

    def __neg__(self) -> Any:
        return -self.number

    def __pos__(self) -> Any:
        return +self.number

    def __abs__(self) -> Any:
        return abs(self.number)

    def __round__(self, digits: int | None = None) -> Any:
        return np.round(self.number, digits or 0) if np.ndim(self.number) else round(self.number, digits)

    def __float__(self) -> float:
        return float(self.number)

    def __int__(self) -> int:
        return int(self.number)

    def __index__(self) -> int:
        return operator.index(self.number)

    def __bool__(self) -> bool:
        return bool(self.value if isinstance(self.value, Mapping) else np.asarray(self.value))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Return the value as an array (...), for NumPy."""
        return np.array(self.number, dtype=dtype, copy=copy)

    def __len__(self) -> int:
        if np.ndim(self.value) or isinstance(self.value, Mapping):
            return len(self.value)
        raise TypeError(f"a single value has no length: {self!r}")

    def __iter__(self) -> Iterator[Any]:
        if np.ndim(self.value) or isinstance(self.value, Mapping):
            return iter(self.value)
        raise TypeError(f"a single value cannot be iterated over: {self!r}")

    def __getitem__(self, key: Any) -> Any:
        if isinstance(self.value, (Mapping, str)):
            return self.value[key]
        return self.number[key]

    def __format__(self, spec: str) -> str:
        """Format the value alone as ``spec`` says, such as ``.2f``; without it value, unit and note."""
        if not spec:
            return str(self)
        return format(self.value if isinstance(self.value, str) else self.number, spec)

    def __repr__(self) -> str:
        """Return value, unit and note, at most one line."""
        unit = "" if self.unit in ("", "1") or self.value is None else f" {self.unit}"
        note = f" ({self.note})" if self.note else ""
        return _cut(f"{_shown(self.value)}{unit}{note}", COLUMNS)

    def _repr_html_(self) -> str:
        """Return value, unit and note as HTML, for notebooks."""
        return html.escape(repr(self))


def _shown(value: Any) -> str:
    """Return a short text for a value of any type."""
    if value is None:
        return "not available"
    if isinstance(value, Mapping):
        return _cut("{" + ", ".join(f"{key}: {_shown(item)}" for key, item in value.items()) + "}", 70)
    if isinstance(value, (list, tuple, np.ndarray)):
        return _cut("[" + ", ".join(_shown(item) for item in value) + "]", 70)
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    return _cut(str(value), 70)


def _cut(text: str, most: int) -> str:
    """Shorten a text to at most so many characters on one line."""
    line = " ".join(text.split())
    return line if len(line) <= most else f"{line[: most - 4]} ..."
