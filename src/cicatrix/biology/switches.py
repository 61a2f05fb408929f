"""Instants at which formulas of a network switch, since a condition on the time alone becomes true or false there."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from .expressions import TIME, Expression, evaluate, names_in
from .kinetics import Kinetics
from .network import RateLaw

COMPARISONS = ("lt", "leq", "gt", "geq")
SAMPLES = 20_001  # times between which a condition is taken to change once at most
HALVINGS = 60
AFTER = 1e-12  # relative distance of an instant from the crossing, so that the formula has switched there


def instants(law: RateLaw, inputs: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return the ascending times in (start, end) [s] just after which a comparison of times and constants has changed.

    A solver that starts anew there misses no pulse, however short. Conditions that depend on states are left to its steps.
    """
    if not isinstance(law, Kinetics) or not law.is_time_dependent:
        return np.zeros(0)
    times = np.linspace(start, end, SAMPLES)
    found = [_crossings(above, times) for above in _conditions(law, inputs)]
    after = np.unique(np.concatenate([np.zeros(0), *found])) * (1.0 + AFTER)
    return after[(after > start) & (after < end)]


def depends_on_constants(law: RateLaw) -> bool:
    """Return whether the instants at which formulas switch depend on constants of the network."""
    if not isinstance(law, Kinetics):
        return False
    return any(names_in(one) - {TIME} for one in _differences(law, {*law.input_names}))


def _differences(law: Kinetics, constants: set[str]) -> Iterator[Expression]:
    """Yield left minus right side of all comparisons of the time and constants."""
    known = {*constants, TIME}
    timed = {TIME}
    for name, rule in law.assigned:
        if names_in(rule) <= known:
            known.add(name)
            timed |= {name} if names_in(rule) & timed else set()
    for one in (*law.rates, *(rule for _, rule in law.assigned)):
        for left, right in _compared(one):
            names = names_in(left) | names_in(right)
            if names <= known and names & timed:
                yield ("minus", left, right)


def _compared(expression: Expression) -> Iterator[tuple[Expression, Expression]]:
    """Yield both sides of every comparison in an expression."""
    word, *parts = expression
    if word in ("number", "name", TIME):
        return
    if word in COMPARISONS:
        yield from pairwise(parts)
    for part in parts:
        yield from _compared(part)


def _conditions(law: Kinetics, inputs: np.ndarray) -> Iterator[Callable[[np.ndarray], np.ndarray]]:
    """Yield functions of time (n,) [s] for the sign of left minus right side of each comparison."""
    constants = dict(zip(law.input_names, map(float, inputs)))

    def sign(difference: Expression, times: np.ndarray) -> np.ndarray:
        values = constants | {TIME: jnp.asarray(times / law.seconds)}
        for name, rule in law.assigned:
            if names_in(rule) <= values.keys():
                values[name] = evaluate(rule, values)
        return np.sign(np.broadcast_to(np.asarray(evaluate(difference, values), float), times.shape))

    for one in _differences(law, {*law.input_names}):
        yield lambda times, of=one: sign(of, times)


def _crossings(sign: Callable[[np.ndarray], np.ndarray], times: np.ndarray) -> np.ndarray:
    """Return the times after which a sign differs from that before, by halving the intervals in which it changes."""
    values = sign(times)
    at = np.flatnonzero(values[1:] != values[:-1])
    low, high, first = times[at], times[at + 1], values[at]
    for _ in range(HALVINGS if len(at) else 0):
        middle = 0.5 * (low + high)
        is_same = sign(middle) == first
        low, high = np.where(is_same, middle, low), np.where(is_same, high, middle)
    return high
