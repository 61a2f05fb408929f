"""Reaction kinetics of SBML models: rates at a point, evaluated from expressions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

Expression = tuple
"""Expression tree: ("number", 2.0), ("name", "k1"), ("time",), or a key of :data:`FUNCTIONS` with arguments: ("plus", a, b)."""

TIME = "time"


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


FUNCTIONS: dict[str, Callable] = {
    "plus": _folded(lambda a, b: a + b, 0.0),
    "times": _folded(lambda a, b: a * b, 1.0),
    "minus": lambda a, b=None: -a if b is None else a - b,
    "divide": lambda a, b: a / b,
    "power": lambda a, b: jnp.asarray(a, float) ** b,
    "root": lambda degree, a: jnp.asarray(a, float) ** (1.0 / degree),
    "log": lambda base, a: jnp.log(a) / jnp.log(base),
    "ln": jnp.log,
    "exp": jnp.exp,
    "abs": jnp.abs,
    "floor": jnp.floor,
    "ceiling": jnp.ceil,
    **{name: getattr(jnp, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{name: getattr(jnp, name) for name in ("arcsin", "arccos", "arctan", "arcsinh", "arccosh", "arctanh")},
    "min": lambda *parts: _folded(jnp.minimum, jnp.inf)(*parts),
    "max": lambda *parts: _folded(jnp.maximum, -jnp.inf)(*parts),
    "piecewise": _piecewise,
    "and": _folded(jnp.logical_and, True),
    "or": _folded(jnp.logical_or, False),
    "xor": _folded(jnp.logical_xor, False),
    "not": jnp.logical_not,
    "eq": _chained(lambda a, b: a == b),
    "neq": lambda a, b: a != b,
    "lt": _chained(lambda a, b: a < b),
    "leq": _chained(lambda a, b: a <= b),
    "gt": _chained(lambda a, b: a > b),
    "geq": _chained(lambda a, b: a >= b),
}
CONSTANTS = {"pi": math.pi, "exponentiale": math.e, "true": True, "false": False, "avogadro": 6.02214179e23}


def evaluate(expression: Expression, values: Mapping[str, Any]) -> Any:
    """Evaluate an expression; ``values`` has the value of every name in the expression, and of ``time``."""
    word, *parts = expression
    if word == "number":
        return parts[0]
    if word == "name":
        return values[parts[0]]
    if word == TIME:
        return values[TIME]
    return FUNCTIONS[word](*(evaluate(part, values) for part in parts))


def names_in(expression: Expression) -> set[str]:
    """Return the names that an expression contains; ``time`` is one of them."""
    word, *parts = expression
    if word in ("number", "name", TIME):
        return {"number": set(), "name": set(parts), TIME: {TIME}}[word]
    return set().union(*(names_in(part) for part in parts))


class Kinetics(eqx.Module):
    r"""Kinetic laws of an SBML model; its states are concentrations or other quantities of the model.

    .. math:: \dot y = f(y, k, t), \quad f \text{ by the model's rules and reactions}

    Source: SBML Level 3 Version 2 Core (Hucka et al., J Integr Bioinform 16:20190021, 2019), sections 4.6, 4.9 and 4.11.

    Parameters
    ----------
    species : tuple of str
        States (n_species,): species that reactions or rate rules change, and parameters with rate rules.
    input_names : tuple of str
        Constants (n_inputs,): parameters, compartments and species that no rule or reaction changes. All of them are inputs.
    values : (n_inputs,) array
        Values of the constants in the model, in its own units.
    assigned : tuple of (str, Expression)
        Names computed by rules or reactions, ordered so that each depends only on those before it.
    rates : tuple of Expression
        Rate of every state, per ``seconds``.
    seconds : float [s]
        The model's unit of time.
    """

    species: tuple[str, ...] = eqx.field(static=True)
    input_names: tuple[str, ...] = eqx.field(static=True)
    values: Array
    assigned: tuple[tuple[str, Expression], ...] = eqx.field(static=True)
    rates: tuple[Expression, ...] = eqx.field(static=True)
    seconds: float = eqx.field(static=True, default=1.0)

    @property
    def is_time_dependent(self) -> bool:
        """Whether a rule or a rate contains the time."""
        return any(TIME in names_in(one) for one in (*self.rates, *(rule for _, rule in self.assigned)))

    @property
    def differentiable(self) -> dict[str, tuple[str, ...]]:
        """Names of the parameter fields: an empty mapping, since all constants of the model are inputs."""
        return {}

    def rate(self, y: Array, inputs: Array | None = None, time: Array | float = 0.0) -> Array:
        """Return dy/dt at states (..., n_species) under constants (..., n_inputs) at a time [s] -> (..., n_species) [1/s]."""
        return self.under(inputs).rate(y, time)

    def under(self, inputs: Array | None = None) -> BoundKinetics:
        """Return the rates as a function of state and time alone, with fixed constants (..., n_inputs)."""
        return BoundKinetics(self, jnp.asarray(self.values if inputs is None else inputs))


class BoundKinetics(eqx.Module):
    """Rates of an SBML model as a function of state and time, with fixed constants."""

    law: Kinetics
    inputs: Array

    def rate(self, y: Array, time: Array | float = 0.0) -> Array:
        """Return dy/dt at states (..., n_species) at a time [s] -> (..., n_species) [1/s]."""
        y, law = jnp.asarray(y), self.law
        values = {name: self.inputs[..., k] for k, name in enumerate(law.input_names)}
        values |= {name: y[..., k] for k, name in enumerate(law.species)} | {TIME: time / law.seconds}
        for name, rule in law.assigned:
            values[name] = evaluate(rule, values)
        lead = np.broadcast_shapes(y.shape[:-1], self.inputs.shape[:-1])
        rates = [jnp.broadcast_to(jnp.asarray(evaluate(rate, values), float), lead) for rate in law.rates]
        return jnp.stack(rates, axis=-1) / law.seconds
