"""Batched solution of small linear systems by explicit elimination, which avoids one LAPACK call per point."""

from __future__ import annotations

from functools import partial

import jax.numpy as jnp
from jax import Array


@partial(jnp.vectorize, signature="(n,n),(n)->(n)")
def solve(A: Array, b: Array) -> Array:
    """Solve A x = b by elimination with row scaling and pivoting: (..., n, n), (..., n) -> (..., n), n small.

    Rows may have different units. For a singular matrix the result is not finite; x is linear in b, and differentiable.
    """
    size = jnp.max(jnp.abs(A), axis=1, keepdims=True)
    rows = jnp.concatenate([A, b[:, None]], axis=1) / size
    n = len(b)
    for k in range(n):
        pivot = k + jnp.argmax(jnp.abs(rows[k:, k]))
        rows = rows.at[jnp.array([k, pivot])].set(rows[jnp.array([pivot, k])]) if k < n - 1 else rows
        rows = rows.at[k].divide(rows[k, k])
        others = jnp.where(jnp.arange(n) == k, 0.0, rows[:, k])
        rows = rows - others[:, None] * rows[k]
    return rows[:, n]


def eliminate(A: Array, b: Array) -> Array:
    """Solve A x = b by unrolled elimination without pivoting: (..., n, n), (..., n) -> (..., n), n small.

    This is cheaper than :func:`solve`, and valid for matrices near the identity or with a positive definite symmetric part.
    """
    n = b.shape[-1]
    rows = [[A[..., i, j] for j in range(n)] + [b[..., i]] for i in range(n)]
    for k in range(n):
        pivot = 1.0 / rows[k][k]
        for i in range(k + 1, n):
            share = rows[i][k] * pivot
            rows[i] = rows[i][: k + 1] + [rows[i][j] - share * rows[k][j] for j in range(k + 1, n + 1)]
    x: list[Array] = [b] * n
    for k in reversed(range(n)):
        x[k] = (rows[k][n] - sum(rows[k][j] * x[j] for j in range(k + 1, n))) / rows[k][k]
    return jnp.stack(x, axis=-1)
