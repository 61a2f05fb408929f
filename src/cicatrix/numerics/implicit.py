"""Solution of small systems of nonlinear equations at many points at once, differentiable by the implicit function theorem."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from .small import eliminate

MAX_ITERATIONS = 60  # iterations; Newton's method needs a few, and more if steps are halved
STEP_TOLERANCE = 1e-14  # step, relative to the unknowns, below which further iterations bring no improvement


def jacobian(residual: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """Return the residual (..., n) and its Jacobian matrix (..., n, n) at x (..., n), for points independent of each other."""
    r, along = jax.linearize(residual, x)
    columns = jax.vmap(lambda e: along(jnp.broadcast_to(e, x.shape)))(jnp.eye(x.shape[-1]))
    return r, jnp.moveaxis(columns, 0, -1)


def solve(residual: Callable[[Array], Array], guess: Array) -> Array:
    """Solve residual(x) = 0 by Newton's method at every point: guess (..., n) -> (..., n).

    The result has first derivatives with respect to the arrays that ``residual`` closes over: only one additional Newton step
    at the root is differentiated, not the iteration (implicit function theorem). A step is halved if it increases the residual
    or makes it NaN. Points are independent: converged ones stay unchanged while others iterate. At points that do not
    converge, the last iterate is returned.
    """
    converted, parameters = jax.closure_convert(residual, guess)
    constants = [lax.stop_gradient(p) for p in parameters]

    def iterate(now: _Iterate) -> _Iterate:
        r, slope = jacobian(lambda y: converted(y, *constants), now.x)
        norm = jnp.max(jnp.abs(r), axis=-1, keepdims=True)
        is_down = norm < now.norm  # False for NaN
        step = jnp.where(is_down, -eliminate(slope, r), 0.5 * now.step)
        base = jnp.where(is_down, now.x, now.base)
        size = jnp.max(jnp.abs(step), axis=-1, keepdims=True) / jnp.maximum(
            jnp.max(jnp.abs(base), axis=-1, keepdims=True), 1.0
        )
        is_done = now.is_done | (size <= STEP_TOLERANCE) | (norm == 0.0)
        x = jnp.where(now.is_done, now.x, base + jnp.where(norm == 0.0, 0.0, step))
        return _Iterate(x, base, step, jnp.where(is_down, norm, now.norm), is_done, now.n + 1)

    start, each = lax.stop_gradient(guess), (*guess.shape[:-1], 1)
    first = _Iterate(
        start, start, jnp.zeros_like(start), jnp.full(each, jnp.inf), jnp.zeros(each, bool), jnp.zeros((), int)
    )
    x = lax.while_loop(lambda now: (now.n < MAX_ITERATIONS) & ~jnp.all(now.is_done), iterate, first).x
    _, slope = jacobian(lambda y: converted(y, *constants), x)
    return x - eliminate(lax.stop_gradient(slope), converted(x, *parameters))


class _Iterate(NamedTuple):
    """State of Newton's method at every point."""

    x: Array
    """Next trial, where the residual will be evaluated."""
    base: Array
    """Best iterate so far."""
    step: Array
    """Step from ``base`` to ``x``."""
    norm: Array
    """Maximum norm of the residual at ``base``."""
    is_done: Array
    n: Array
    """Number of iterations."""
