"""Formulas of a network that are to blame where its rates cannot be evaluated or integrated."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from .kinetics import Expression, Kinetics
from .network import RateLaw


def not_finite(law: RateLaw, inputs: np.ndarray, y: np.ndarray, time: float) -> str | None:
    """Name the first formula that is not a finite number at a state (n_species,) and time [s]; None if all are finite.

    Those of a network of Hill functions always are.
    """
    if not isinstance(law, Kinetics):
        return None
    bound = law.under(jnp.asarray(inputs))
    for name, value in _formulas(law, inputs, y, time):
        if not np.isfinite(value):
            gap = name in _with_gap(law)
            why = ", since none of the conditions of its piecewise holds and it has no otherwise" if gap else ""
            return f'the formula of "{name}" is {_word(value)}{why}'
    for name, value in zip(law.species, np.asarray(bound.rate(jnp.asarray(y), time))):
        if not np.isfinite(value):
            return f'the rate of change of "{name}" is {_word(float(value))}'
    return None


def fastest(law: RateLaw, inputs: np.ndarray, y: np.ndarray, time: float, scale: np.ndarray) -> tuple[str, float]:
    """Name the species whose rate is largest relative to its scale (n_species,), and the network's largest formula.

    The second value is that rate over the scale [1/s].
    """
    rate = np.asarray(law.under(jnp.asarray(inputs)).rate(jnp.asarray(y), time))
    k = int(np.argmax(np.abs(rate) / scale))
    formulas = _formulas(law, inputs, y, time)
    name, value = max(formulas, key=lambda one: abs(one[1]), default=("", 0.0))
    words = f'; the largest of its formulas is that of "{name}", {value:.4g}' if name else ""
    return f'"{law.species[k]}" changes fastest there, by {rate[k]:.4g} per s{words}', float(abs(rate[k]) / scale[k])


def _formulas(law: RateLaw, inputs: np.ndarray, y: np.ndarray, time: float) -> list[tuple[str, float]]:
    """Return the values of the formulas of reactions and rules, each after those on which it depends."""
    if not isinstance(law, Kinetics):
        return []
    values = law.under(jnp.asarray(inputs)).values(jnp.asarray(y), time)
    return [(name, float(np.asarray(values[name]))) for name, _ in law.assigned]


def _word(value: float) -> str:
    return "not a number" if np.isnan(value) else "infinite"


def _with_gap(law: RateLaw) -> set[str]:
    """Return the names whose formulas contain a piecewise function without a default value."""
    return {name for name, rule in law.assigned if _has_gap(rule)} if isinstance(law, Kinetics) else set()


def _has_gap(expression: Expression) -> bool:
    word, *parts = expression
    if word == "piecewise" and len(parts) % 2 == 0:
        return True
    return any(_has_gap(part) for part in parts if isinstance(part, tuple))
