"""Roots of increasing scalar functions at many points at once, by a differentiable bracketed Newton iteration."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

MAX_ITERATIONS = 200  # iterations; Newton's method needs a few, and more if a bracket has to be found
STEP_TOLERANCE = 1e-9  # relative step at which the search stops; two more Newton steps then square the error twice


def rising_root(function: Callable[[Array], Array], low: Array, guess: Array) -> Array:
    """Find the root of an increasing scalar function at every point: low, guess (...) -> (...).

    The function must not be positive at ``low``, so the root is not below it.

    Newton's method is applied at every point independently. A step that leaves the current bracket, or is more than half as
    long as the previous one, is replaced by bisection, or, while there is no upper bound, by doubling the distance from
    ``low``. A NaN value counts as above the root. Where no root is found the result is NaN.

    The result can be differentiated up to three times with respect to arrays that ``function`` closes over: instead
    of the iteration, two additional Newton steps at the root are differentiated, each of which doubles the order to which
    derivatives are exact.
    """
    converted, parameters = jax.closure_convert(function, guess)
    constants = [lax.stop_gradient(p) for p in parameters]

    def iterate(now: _Search) -> _Search:
        r, slope = _line(lambda y: converted(y, *constants), now.x)
        is_below = r < 0.0  # False for NaN
        low = jnp.where(is_below, now.x, now.low)
        high = jnp.where(is_below, now.high, now.x)
        newton = now.x - r / slope
        farthest = jnp.where(jnp.isinf(high), low + 8.0 * (now.x - now.start), high)
        is_quick = jnp.isinf(high) | (jnp.abs(newton - now.x) <= 0.5 * now.move)
        is_inside = (slope > 0.0) & (newton >= low) & (newton <= farthest) & is_quick
        middle = jnp.where(jnp.isinf(high), low + 2.0 * (now.x - now.start), 0.5 * (low + high))
        x = jnp.where(is_inside, newton, middle)
        is_done = now.is_done | (
            is_inside & (jnp.abs(x - now.x) <= STEP_TOLERANCE * jnp.maximum(jnp.abs(x - now.start), STEP_TOLERANCE))
        )
        move = jnp.abs(x - now.x)
        return _Search(jnp.where(now.is_done, now.x, x), move, low, high, now.start, is_done, now.n + 1)

    low, guess = jnp.broadcast_arrays(lax.stop_gradient(low), lax.stop_gradient(guess))
    far, no = jnp.full_like(guess, jnp.inf), jnp.zeros(guess.shape, bool)
    first = _Search(guess, far, low, far, low, no, jnp.zeros((), int))
    last = lax.while_loop(lambda now: (now.n < MAX_ITERATIONS) & ~jnp.all(now.is_done), iterate, first)
    x = jnp.where(last.is_done, last.x, jnp.nan)
    for _ in range(2):
        r, slope = _line(lambda y: converted(y, *parameters), x)
        x = x - r / slope
    return x


def _line(function: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """Return value and slope of a scalar function at every point: (...) -> (...), (...)."""
    return jax.jvp(function, (x,), (jnp.ones_like(x),))


class _Search(NamedTuple):
    """State of the root search at every point."""

    x: Array
    """Next trial, where the function will be evaluated."""
    move: Array
    """Distance from the previous trial."""
    low: Array
    """Lower bound of the root."""
    high: Array
    """Upper bound of the root; infinite until one is known."""
    start: Array
    """Initial lower bound."""
    is_done: Array
    """True at points where the search has converged."""
    n: Array
    """Number of iterations."""
