"""Many points in one compiled call, some at a time: what one step of the way needs stays in the cache, and in memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from ..core.errors import InputError

POINTS = 1024  # about what a core's cache holds of a law's nine derivatives


def chunked(work: Callable[..., Any], points: Any, size: int = POINTS) -> Any:
    """Do the work on so many points at a time; the same numbers as ``work(points)``.

    Parameters
    ----------
    work : function of a pytree of arrays (m, ...) to a pytree of arrays (m, ...)
        Whatever is not an array of points, a law with single numbers for parameters say, it closes over.
    points : pytree of arrays (n, ...)
        Deformation gradients, histories, parameters of a law with one number per point.
    size : int
        Points at a time; those left over at the end are done in a call of their own.

    Returns
    -------
    pytree of arrays (n, ...)

    Raises
    ------
    InputError
        If ``size`` is below 1, or the arrays are not of as many points.

    Notes
    -----
    Only the answers are held for all points: 720 bytes a point for P and its tangent. Call it inside ``jax.jit``; ``jax.grad``
    and ``jax.vmap`` go through it.
    """
    counts = {leaf.shape[0] if leaf.ndim else 0 for leaf in map(jnp.asarray, jax.tree.leaves(points))}
    if size < 1:
        raise InputError(f"chunked: size must be 1 or more; got {size}.")
    if len(counts) != 1:
        raise InputError(f"chunked: all arrays must have one row per point; got {sorted(counts)} rows.")
    n = counts.pop()
    whole = n - n % size
    if n <= size:
        return work(points)
    head = _fold(jax.lax.map(work, jax.tree.map(lambda leaf: leaf[:whole].reshape(-1, size, *leaf.shape[1:]), points)))
    if whole == n:
        return head
    tail = work(jax.tree.map(lambda leaf: leaf[whole:], points))
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), head, tail)


def _fold(answers: Any) -> Any:
    def folded(leaf: Array) -> Array:
        return leaf.reshape(-1, *leaf.shape[2:])

    return jax.tree.map(folded, answers)
