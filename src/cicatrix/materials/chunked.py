"""Evaluation of many points in batches, in one compiled call, so that intermediate results fit into cache and RAM."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from ..core.errors import InputError

POINTS = 1024  # nine directional derivatives of a law at about this many points fit into a core's cache


def chunked(work: Callable[..., Any], points: Any, size: int = POINTS) -> Any:
    """Apply ``work`` to batches of ``size`` points; the result equals ``work(points)``.

    Parameters
    ----------
    work : function of a pytree of arrays (m, ...) to a pytree of arrays (m, ...)
        Function to evaluate. Anything that is not an array over points, such as a law with scalar parameters, must be
        captured in its closure.
    points : pytree of arrays (n, ...)
        Arguments of ``work`` at n points: deformation gradients, histories, and law parameters with one number per point.
    size : int
        Number of points in a batch; the remaining points, fewer than this, are evaluated in a separate call.

    Returns
    -------
    pytree of arrays (n, ...)

    Raises
    ------
    InputError
        If ``size`` is below 1, or the arrays do not all have the same number of points.

    Notes
    -----
    Only the results are stored for all points: 720 bytes per point for P and its tangent. Call this function inside
    ``jax.jit``; ``jax.grad`` and ``jax.vmap`` can be applied to it.
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
