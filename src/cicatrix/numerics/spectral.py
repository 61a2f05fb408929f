"""Isotropic functions of symmetric 3 x 3 tensors in terms of eigenvalues, with derivatives valid at repeated eigenvalues.

At repeated eigenvalues the eigenvectors have no derivatives, but the functions do; they are computed from divided differences
(Daleckii & Krein 1965).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array, lax

from .tensors import product

SWEEPS = 5  # sweeps of Jacobi's method; it converges quadratically, and four reach round-off for 3 x 3 tensors
COINCIDE = 1e-5  # relative gap of eigenvalues below which the limit is more accurate than the divided difference
PAIRS = ((0, 1), (0, 2), (1, 2))


def eigh(C: Array) -> tuple[Array, Array]:
    """Return unsorted eigenvalues, and eigenvectors as columns: symmetric C (..., 3, 3) -> (..., 3), (..., 3, 3).

    Explicit cyclic Jacobi rotations replace a LAPACK call per point. The result must not be differentiated.
    """
    a = [[C[..., i, j] for j in range(3)] for i in range(3)]
    one, zero = jnp.ones(C.shape[:-2]), jnp.zeros(C.shape[:-2])
    n = [[one if i == j else zero for j in range(3)] for i in range(3)]
    a, n = lax.fori_loop(0, SWEEPS, lambda _, both: _swept(*both), (a, n))
    vectors = jnp.stack([jnp.stack(row, axis=-1) for row in n], axis=-2)
    return jnp.stack([a[i][i] for i in range(3)], axis=-1), vectors


def _swept(a: list[list[Array]], n: list[list[Array]]) -> tuple[list, list]:
    for p, q in PAIRS:
        a, n = _rotated(a, n, p, q)
    return a, n


def _rotated(a: list[list[Array]], n: list[list[Array]], p: int, q: int) -> tuple[list, list]:
    """Apply the Jacobi rotation in the plane of axes p and q that makes a[p][q] vanish; return the rotated a and n."""
    gap, twice = a[q][q] - a[p][p], 2.0 * a[p][q]
    reach = gap + jnp.where(gap < 0.0, -1.0, 1.0) * jnp.sqrt(gap * gap + twice * twice)
    t = jnp.where(twice == 0.0, 0.0, twice / jnp.where(reach == 0.0, 1.0, reach))
    cosine = 1.0 / jnp.sqrt(1.0 + t * t)
    sine, r, shift = t * cosine, 3 - p - q, t * a[p][q]
    rp, rq = cosine * a[r][p] - sine * a[r][q], sine * a[r][p] + cosine * a[r][q]
    out = [list(row) for row in a]
    out[p][p], out[q][q] = a[p][p] - shift, a[q][q] + shift
    out[p][q] = out[q][p] = jnp.zeros_like(shift)
    out[r][p] = out[p][r] = rp
    out[r][q] = out[q][r] = rq
    turned = [list(row) for row in n]
    for i in range(3):
        turned[i][p], turned[i][q] = cosine * n[i][p] - sine * n[i][q], sine * n[i][p] + cosine * n[i][q]
    return out, turned


def recomposed(values: Array, vectors: Array) -> Array:
    """Return the tensor with given eigenvalues and eigenvectors, sum y_i n_i x n_i: (..., 3), (..., 3, 3) -> (..., 3, 3)."""
    return product(vectors * values[..., None, :], jnp.swapaxes(vectors, -1, -2))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def isotropic(function: Callable, C: Array, *parameters: Array) -> Array:
    r"""Return an isotropic function of a symmetric tensor, :math:`\sum y_i(c_1, c_2, c_3) \, n_i \otimes n_i`: C -> (..., 3, 3).

    :math:`c_i` and :math:`n_i` are the eigenvalues and eigenvectors of C (..., 3, 3).

    ``function(c, *parameters)`` maps eigenvalues c (..., 3) to values y (..., 3); it must be differentiable, and a
    permutation of c must permute y. Parameters are arrays or laws. The result has first derivatives with respect to C and
    the parameters.
    """
    c, n = eigh(C)
    return recomposed(function(c, *parameters), n)


@isotropic.defjvp
def _isotropic_jvp(function, primals, tangents):
    (C, *parameters), (dC, *moved) = primals, tangents
    c, n = eigh(C)
    y, along = jax.linearize(function, c, *parameters)
    turned = product(jnp.swapaxes(n, -1, -2), product(dC, n))
    diagonal = along(jnp.stack([turned[..., i, i] for i in range(3)], axis=-1), *moved)
    still = jax.tree.map(jnp.zeros_like, parameters)
    slopes = jax.vmap(lambda e: along(jnp.broadcast_to(e, c.shape), *still))(jnp.eye(3))
    rows = [[diagonal[..., i] if i == j else None for j in range(3)] for i in range(3)]
    for i, j in PAIRS:
        rows[i][j] = rows[j][i] = _divided(y, c, slopes, i, j) * turned[..., i, j]
    inner = jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
    return recomposed(y, n), product(n, product(inner, jnp.swapaxes(n, -1, -2)))


def _divided(y: Array, c: Array, slopes: Array, i: int, j: int) -> Array:
    """Return the divided difference (y_i - y_j) / (c_i - c_j), or its limit for equal eigenvalues c.

    y and c are (..., 3), and ``slopes`` the derivatives of y with respect to each eigenvalue.
    """
    gap = c[..., i] - c[..., j]
    coincide = jnp.abs(gap) < COINCIDE * jnp.abs(c).max(axis=-1)
    limit = 0.5 * (slopes[i][..., i] - slopes[j][..., i] + slopes[j][..., j] - slopes[i][..., j])
    return jnp.where(coincide, limit, (y[..., i] - y[..., j]) / jnp.where(coincide, 1.0, gap))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def invariant(function: Callable, C: Array, *parameters: Array) -> Array:
    """Return a scalar function of the eigenvalues of a symmetric C (..., 3, 3) -> (...), twice differentiable in C.

    ``function(c, *parameters)`` maps eigenvalues (..., 3) to (...), independently of their order.
    """
    return function(eigh(C)[0], *parameters)


@invariant.defjvp
def _invariant_jvp(function, primals, tangents):
    (C, *parameters), (dC, *moved) = primals, tangents

    def slope(c, *p):
        return jax.grad(lambda c: jnp.sum(function(c, *p)))(c)

    def change(c, *both):
        p, dp = both[: len(parameters)], both[len(parameters) :]
        return jax.jvp(lambda *p: function(c, *p), p, dp)[1]

    out = jnp.sum(isotropic(slope, C, *parameters) * dC, axis=(-2, -1))
    if parameters:
        out = out + invariant(change, C, *parameters, *moved)
    return invariant(function, C, *parameters), out
