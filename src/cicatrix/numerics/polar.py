"""Right stretch tensor of a deformation gradient, in closed form."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array, lax

from .tensors import IDENTITY, det, first_invariant, product

STEPS = 14  # Newton iterations for the trace of U; convergence is monotone, so additional iterations do no harm


def right_stretch(F: Array) -> Array:
    r"""Return U of the polar decomposition F = R U, det F > 0: (..., 3, 3) -> (..., 3, 3); differentiable once.

    .. math:: U = \frac{i \, iii \, I + (i^2 - ii) \, C - C^2}{i \, ii - iii}, \qquad C = F^T F

    with the invariants i, ii, iii of U (Hoger & Carlson 1984). The trace i of U is the largest root of a quartic, and a
    simple root wherever F is invertible, so no eigenvalues are needed and repeated ones cause no difficulty.
    """
    C = product(jnp.swapaxes(F, -1, -2), F)
    i = _trace(first_invariant(F), 0.5 * (first_invariant(F) ** 2 - first_invariant(C)), det(F))
    ii, iii = 0.5 * (i * i - first_invariant(F)), det(F)
    top = (i * iii)[..., None, None] * IDENTITY + (i * i - ii)[..., None, None] * C - product(C, C)
    return top / (i * ii - iii)[..., None, None]


def _trace(I: Array, II: Array, iii: Array) -> Array:
    """Return tr U from the first two invariants of C and det U: the largest root i of (i^2 - I)^2 = 4 II + 8 iii i."""

    def value(i, I, II, iii):
        return (i * i - I) ** 2 - 4.0 * II - 8.0 * iii * i

    constants = [lax.stop_gradient(x) for x in (I, II, iii)]
    i = jnp.sqrt(3.0 * constants[0])
    for _ in range(STEPS):
        i = i - value(i, *constants) / (4.0 * i * (i * i - constants[0]) - 8.0 * constants[2])
    return i - value(i, I, II, iii) / (4.0 * i * (i * i - constants[0]) - 8.0 * constants[2])
