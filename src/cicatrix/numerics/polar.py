"""The stretch in a deformation, in closed form."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array, lax

from .tensors import IDENTITY, det, first_invariant, product

STEPS = 14  # of Newton's method for the trace of U; it descends monotonically, so more of them do no harm


def right_stretch(F: Array) -> Array:
    r"""U of the polar decomposition F = R U, det F > 0: (..., 3, 3) -> (..., 3, 3); differentiable once.

    .. math:: U = \frac{i \, iii \, I + (i^2 - ii) \, C - C^2}{i \, ii - iii}, \qquad C = F^T F

    with the invariants i, ii, iii of U (Hoger & Carlson 1984). Its trace i is the largest root of a quartic, which is
    simple wherever F can be inverted, so no eigenvalues are needed and coinciding ones do no harm.
    """
    C = product(jnp.swapaxes(F, -1, -2), F)
    i = _trace(first_invariant(F), 0.5 * (first_invariant(F) ** 2 - first_invariant(C)), det(F))
    ii, iii = 0.5 * (i * i - first_invariant(F)), det(F)
    top = (i * iii)[..., None, None] * IDENTITY + (i * i - ii)[..., None, None] * C - product(C, C)
    return top / (i * ii - iii)[..., None, None]


def _trace(I: Array, II: Array, iii: Array) -> Array:
    """Trace of U from the first two invariants of C and det U: the root of (i^2 - I)^2 = 4 II + 8 iii i from above."""

    def value(i, I, II, iii):
        return (i * i - I) ** 2 - 4.0 * II - 8.0 * iii * i

    held = [lax.stop_gradient(x) for x in (I, II, iii)]
    i = jnp.sqrt(3.0 * held[0])
    for _ in range(STEPS):
        i = i - value(i, *held) / (4.0 * i * (i * i - held[0]) - 8.0 * held[2])
    return i - value(i, I, II, iii) / (4.0 * i * (i * i - held[0]) - 8.0 * held[2])
