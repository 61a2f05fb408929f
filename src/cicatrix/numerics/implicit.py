"""Small implicit equations at many points at once, differentiable without differentiating the iteration."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax

from .small import eliminate

MOST = 60  # iterations; Newton's method needs a handful, a step that is cut short some more
EXACT = 1e-14  # of the unknowns' scale: what further iterations would not improve


def jacobian(residual: Callable[[Array], Array], x: Array) -> tuple[Array, Array]:
    """Residual (..., n) and its derivative (..., n, n) at x (..., n), points being independent of each other."""
    r, along = jax.linearize(residual, x)
    columns = jax.vmap(lambda e: along(jnp.broadcast_to(e, x.shape)))(jnp.eye(x.shape[-1]))
    return r, jnp.moveaxis(columns, 0, -1)


def solve(residual: Callable[[Array], Array], guess: Array) -> Array:
    """Root of residual(x) = 0 by Newton's method at every point: guess (..., n) -> (..., n).

    What ``residual`` closes over may be differentiated, once: the iteration is not followed, one more step from the root
    found is (the implicit function theorem). A step that brings the residual up, or to what is no number, is halved. Points
    are independent: those that have converged stay while others go on. Where it does not converge the last iterate comes back.
    """
    held, parameters = jax.closure_convert(residual, guess)
    still = [lax.stop_gradient(p) for p in parameters]

    def go_on(now: _Iterate) -> _Iterate:
        r, slope = jacobian(lambda y: held(y, *still), now.x)
        norm = jnp.max(jnp.abs(r), axis=-1, keepdims=True)
        is_down = norm < now.norm  # not where it is NaN
        step = jnp.where(is_down, -eliminate(slope, r), 0.5 * now.step)
        base = jnp.where(is_down, now.x, now.base)
        size = jnp.max(jnp.abs(step), axis=-1, keepdims=True) / jnp.maximum(
            jnp.max(jnp.abs(base), axis=-1, keepdims=True), 1.0
        )
        is_done = now.is_done | (size <= EXACT) | (norm == 0.0)
        x = jnp.where(now.is_done, now.x, base + jnp.where(norm == 0.0, 0.0, step))
        return _Iterate(x, base, step, jnp.where(is_down, norm, now.norm), is_done, now.n + 1)

    start, each = lax.stop_gradient(guess), (*guess.shape[:-1], 1)
    first = _Iterate(
        start, start, jnp.zeros_like(start), jnp.full(each, jnp.inf), jnp.zeros(each, bool), jnp.zeros((), int)
    )
    x = lax.while_loop(lambda now: (now.n < MOST) & ~jnp.all(now.is_done), go_on, first).x
    _, slope = jacobian(lambda y: held(y, *still), x)
    return x - eliminate(lax.stop_gradient(slope), held(x, *parameters))


class _Iterate(NamedTuple):
    """Where Newton's method stands at every point."""

    x: Array
    """Where the residual is asked for next."""
    base: Array
    """The best so far."""
    step: Array
    """From there to x."""
    norm: Array
    """Of the residual at ``base``."""
    is_done: Array
    n: Array
    """Iterations."""
