"""Roots of rising functions of one number, at many points at once: kept in brackets, and differentiable."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

MOST = 200  # iterations; Newton's method needs a handful, a search for a bracket some more
CLOSE = 1e-9  # of the root's scale: the two steps that follow square it twice


def rising_root(function: Callable[[Array], Array], low: Array, guess: Array) -> Array:
    """Root above ``low`` of a function that rises with x and is 0 or less at ``low``: low, guess (...) -> (...).

    Newton's method at every point, points being independent of each other; a step out of the bracket found so far, or more than
    half as long as the one before, is replaced by one to the bracket's middle; while nothing is known above, by twice the
    distance from ``low``. What is no number counts as too far. Where there is no root the answer is NaN.

    What ``function`` closes over may be differentiated, up to three times: the iteration is not followed, two more steps from
    the root are, each of which makes twice as many orders right.
    """
    held, parameters = jax.closure_convert(function, guess)
    still = [lax.stop_gradient(p) for p in parameters]

    def further(now: _Search) -> _Search:
        r, slope = _line(lambda y: held(y, *still), now.x)
        is_below = r < 0.0  # not where it is NaN
        low = jnp.where(is_below, now.x, now.low)
        high = jnp.where(is_below, now.high, now.x)
        newton = now.x - r / slope
        farthest = jnp.where(jnp.isinf(high), low + 8.0 * (now.x - now.start), high)
        is_quick = jnp.isinf(high) | (jnp.abs(newton - now.x) <= 0.5 * now.move)
        is_inside = (slope > 0.0) & (newton >= low) & (newton <= farthest) & is_quick
        middle = jnp.where(jnp.isinf(high), low + 2.0 * (now.x - now.start), 0.5 * (low + high))
        x = jnp.where(is_inside, newton, middle)
        is_done = now.is_done | (is_inside & (jnp.abs(x - now.x) <= CLOSE * jnp.maximum(jnp.abs(x - now.start), CLOSE)))
        move = jnp.abs(x - now.x)
        return _Search(jnp.where(now.is_done, now.x, x), move, low, high, now.start, is_done, now.n + 1)

    low, guess = jnp.broadcast_arrays(lax.stop_gradient(low), lax.stop_gradient(guess))
    far, no = jnp.full_like(guess, jnp.inf), jnp.zeros(guess.shape, bool)
    first = _Search(guess, far, low, far, low, no, jnp.zeros((), int))
    last = lax.while_loop(lambda now: (now.n < MOST) & ~jnp.all(now.is_done), further, first)
    x = jnp.where(last.is_done, last.x, jnp.nan)
    for _ in range(2):
        r, slope = _line(lambda y: held(y, *parameters), x)
        x = x - r / slope
    return x


def _line(function: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """Value and slope of a function of one number at every point (...)."""
    return jax.jvp(function, (x,), (jnp.ones_like(x),))


class _Search(NamedTuple):
    """Where the search stands at every point."""

    x: Array
    """Where the function is asked for next."""
    move: Array
    """How far that is from where it was asked for last."""
    low: Array
    high: Array
    """Bracket so far."""
    start: Array
    is_done: Array
    n: Array
    """Iterations."""
