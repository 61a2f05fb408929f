"""Formulas of reaction networks as trees: evaluated at a point, searched for names, and put in order."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from typing import Any

import jax.numpy as jnp
from jax.scipy.special import gamma

from ..core.errors import InputError

Expression = tuple
"""Expression tree: ("number", 2.0), ("name", "k1"), (TIME,), or a key of :data:`FUNCTIONS` with arguments: ("plus", a, b)."""

TIME = "csymbol time"  # no id of SBML holds a space, so a species that is named "time" is another symbol


def number(value: float) -> Expression:
    """Return a number as an expression."""
    return ("number", float(value))


def name(of: str) -> Expression:
    """Return the symbol of this name as an expression."""
    return ("name", of)


def _piecewise(*parts: Any) -> Any:
    """Return the first value whose condition is true; arguments: value, condition, value, condition, ..., default value."""
    value = parts[-1] if len(parts) % 2 else jnp.nan
    for k in range(len(parts) // 2 - 1, -1, -1):
        value = jnp.where(parts[2 * k + 1], parts[2 * k], value)
    return value


def _folded(pair: Callable, start: Any) -> Callable:
    def fold(*parts: Any) -> Any:
        value = start
        for part in parts:
            value = pair(value, part)
        return value

    return fold


def _chained(compare: Callable) -> Callable:
    """Return a function of any number of arguments that is true if ``compare`` is true for every pair of successive ones."""
    return lambda *parts: _folded(jnp.logical_and, True)(*(compare(a, b) for a, b in pairwise(parts)))


def _one_over(of: Callable) -> Callable:
    return lambda x: 1.0 / of(x)


def _of_one_over(of: Callable) -> Callable:
    return lambda x: of(1.0 / jnp.asarray(x, float))


RECIPROCALS = {"sec": "cos", "csc": "sin", "cot": "tan", "sech": "cosh", "csch": "sinh", "coth": "tanh"}
BOOLEAN: dict[str, Callable] = {
    "and": _folded(jnp.logical_and, True),
    "or": _folded(jnp.logical_or, False),
    "xor": _folded(jnp.logical_xor, False),
    "not": jnp.logical_not,
    "implies": lambda a, b: jnp.logical_or(jnp.logical_not(a), b),
    "eq": _chained(lambda a, b: a == b),
    "neq": lambda a, b: a != b,
    "lt": _chained(lambda a, b: a < b),
    "leq": _chained(lambda a, b: a <= b),
    "gt": _chained(lambda a, b: a > b),
    "geq": _chained(lambda a, b: a >= b),
}
"""Functions whose value is true or false."""

FUNCTIONS: dict[str, Callable] = {
    "plus": _folded(lambda a, b: a + b, 0.0),
    "times": _folded(lambda a, b: a * b, 1.0),
    "minus": lambda a, b=None: -jnp.asarray(a, float) if b is None else jnp.asarray(a, float) - b,
    "divide": lambda a, b: jnp.asarray(a, float) / b,
    "power": lambda a, b: jnp.asarray(a, float) ** b,
    "root": lambda degree, a: jnp.asarray(a, float) ** (1.0 / degree),
    "log": lambda base, a: jnp.log(a) / jnp.log(base),
    "ln": jnp.log,
    "exp": jnp.exp,
    "abs": jnp.abs,
    "floor": jnp.floor,
    "ceiling": jnp.ceil,
    "factorial": lambda n: jnp.round(gamma(n + 1.0)),
    "quotient": lambda a, b: jnp.trunc(a / b),
    "rem": lambda a, b: a - b * jnp.trunc(a / b),
    **{word: getattr(jnp, word) for word in ("sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{word: getattr(jnp, word) for word in ("arcsin", "arccos", "arctan", "arcsinh", "arccosh", "arctanh")},
    **{word: _one_over(getattr(jnp, of)) for word, of in RECIPROCALS.items()},
    **{f"arc{word}": _of_one_over(getattr(jnp, f"arc{of}")) for word, of in RECIPROCALS.items()},
    "min": lambda *parts: _folded(jnp.minimum, jnp.inf)(*parts),
    "max": lambda *parts: _folded(jnp.maximum, -jnp.inf)(*parts),
    "piecewise": _piecewise,
    **BOOLEAN,
}
CONSTANTS = {"pi": math.pi, "exponentiale": math.e, "true": True, "false": False, "avogadro": 6.02214179e23}


def evaluate(expression: Expression, values: Mapping[str, Any]) -> Any:
    """Evaluate an expression; ``values`` has the value of every name in the expression, and of :data:`TIME`."""
    word, *parts = expression
    if word == "number":
        return parts[0]
    if word == "name":
        return values[parts[0]]
    if word == TIME:
        return values[TIME]
    return FUNCTIONS[word](*(evaluate(part, values) for part in parts))


def names_in(expression: Expression) -> set[str]:
    """Return the names that an expression contains; :data:`TIME` is one of them."""
    word, *parts = expression
    if word in ("number", "name", TIME):
        return {"number": set(), "name": set(parts), TIME: {TIME}}[word]
    return set().union(*(names_in(part) for part in parts))


def substituted(expression: Expression, by: Mapping[str, Expression]) -> Expression:
    """Return an expression in which names are replaced by other expressions."""
    word, *parts = expression
    if word == "name":
        return by.get(parts[0], expression)
    if word in ("number", TIME):
        return expression
    return (word, *(substituted(part, by) for part in parts))


def needed(asked: Iterable[str], rules: Mapping[str, Expression]) -> set[str]:
    """Return the names in ``asked`` and all those on which they depend, by way of ``rules``; :data:`TIME` is none of them."""
    found, left = set(), list(asked)
    while left:
        one = left.pop()
        if one not in found and one != TIME:
            found.add(one)
            left += names_in(rules[one]) if one in rules else ()
    return found


def ordered(rules: Mapping[str, Expression], known: Iterable[str]) -> tuple[tuple[str, Expression], ...]:
    """Sort rules so that each depends only on ``known`` names and on those before it.

    Raises
    ------
    InputError
        If rules depend on each other in a circle.
    """
    order, at_hand, left = [], set(known), {one: names_in(rule) for one, rule in rules.items()}
    while left:
        ready = [one for one, of in left.items() if of <= at_hand]
        if not ready:
            raise InputError(f"the rules of {', '.join(sorted(left))} depend on each other")
        order += [(one, rules[one]) for one in ready]
        at_hand |= set(ready)
        left = {one: of for one, of in left.items() if one not in at_hand}
    return tuple(order)
