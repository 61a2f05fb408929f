"""Homogenised constrained mixture: one evolving natural state per constituent instead of many cohorts."""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from ..numerics.tensors import product
from .cohorts import Cohorts, CohortSlots, Memory
from .material import EnergyMaterial

MAX_ITERATIONS = 60  # maximum iterations: bracketed Newton takes about 5, bisection alone 50
STEP_TOLERANCE = 1e-15  # step of beta below which the iteration ends
STRESS_TOLERANCE = 1e-8  # relative stress difference below which the stress cannot determine beta


class Homogenised(CohortSlots):
    r"""One natural state per constituent, which evolves so that stress relaxes to the deposition stress by turnover.

    .. math:: \tau(F N) - \tau_d = \frac{\rho_{old}}{\rho} (\tau(F N_{old}) - \tau_d), \qquad N = N_d + \beta \, (N_{old} - N_d)

    :math:`N_d = U(s)^{-1} G` is the natural state of newly deposited mass, :math:`\tau_d = \tau(F N_d)` its Kirchhoff
    stress, :math:`\rho_{old}` the mass that survives the step, :math:`\rho` the total mass. Source: Cyron, Aydin & Humphrey
    (2016), whose stress relaxes at the rate :math:`\dot\rho / \rho + 1 / T`; here this rate is integrated at the stretch at
    the end of the step. They solve for six components of an inelastic rate, which are not unique for a law that does not
    resist all of them. Here the natural state moves on the straight line towards :math:`N_d`, with one unknown :math:`\beta`
    per step, and the equation is satisfied in the direction of the stress difference. Under constant stretch, fibres relax
    as in the heredity integral for any step size.
    """

    cohorts: int = eqx.field(static=True, default=1, init=False)

    def memory(self, law: EnergyMaterial) -> Memory:
        """Return this object, which implements :class:`.cohorts.Memory` for any law."""
        return self

    def absorb(
        self, law: EnergyMaterial, F: Array, state: Cohorts, survival: Array, mass: Array, natural: Array
    ) -> Cohorts:
        """Return the history with the new total mass, and the natural state moved towards that of the newly deposited mass."""
        survived = survival * state.masses[..., 0]
        total = survived + mass
        share = jnp.where(total > 0.0, survived / jnp.where(total > 0.0, total, 1.0), 1.0)
        direction = state.natural[..., 0, :, :] - natural
        beta = _turnover_root(law, F, natural, direction, share)
        return state._replace(
            masses=total[..., None], natural=(natural + beta[..., None, None] * direction)[..., None, :, :]
        )


def _turnover_root(law: EnergyMaterial, F: Array, natural: Array, direction: Array, share: Array) -> Array:
    """Return beta (...) in [0, 1], which determines the new natural state.

    beta is the position of this state on the line from that of the newly deposited mass (0) to the old one (1), at which the
    Kirchhoff stress differs from that of the new mass by the fraction ``share`` (...) of the old difference, measured along
    that difference.
    """
    start, end = _kirchhoff(law, F, natural), _kirchhoff(law, F, natural + direction)
    gap = end - start
    silent = STRESS_TOLERANCE**2 * jnp.sum(start * start + end * end, axis=(-2, -1)) + 1e-300
    wanted = jnp.sum(gap * (start + share[..., None, None] * gap), axis=(-2, -1)) + silent * share

    def excess(beta, law, F, natural, direction, gap, silent, wanted):
        """Return tau : gap minus its target; the term with ``silent`` makes the root unique where the gap vanishes."""
        F_e = product(F, natural + beta[..., None, None] * direction)
        return jax.jvp(law.energy, (F_e,), (product(gap, F_e),))[1] + silent * beta - wanted

    given = (law, F, natural, direction, gap, silent, wanted)
    constants = jax.tree.map(lax.stop_gradient, given)
    beta = _bracketed_root(lambda b: excess(b, *constants), lax.stop_gradient(share))
    _, slope = jax.jvp(lambda b: excess(b, *constants), (beta,), (jnp.ones_like(beta),))
    return beta - excess(beta, *given) / slope


def _kirchhoff(law: EnergyMaterial, F: Array, natural: Array) -> Array:
    F_e = product(F, natural)
    return product(law.stress(F_e), jnp.swapaxes(F_e, -1, -2))


def _bracketed_root(function: Callable[[Array], Array], guess: Array) -> Array:
    """Return the root in [0, 1] of a function (...) -> (...), negative at 0 and positive at 1, by bracketed Newton."""

    def iterate(state):
        x, low, high, _, k = state
        value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
        low, high = jnp.where(value <= 0.0, x, low), jnp.where(value >= 0.0, x, high)
        step = x - value / jnp.where(slope == 0.0, 1.0, slope)
        new = jnp.where((step >= low) & (step <= high) & (slope > 0.0), step, 0.5 * (low + high))
        return new, low, high, jnp.max(jnp.abs(new - x)), k + 1

    start = (guess, jnp.zeros_like(guess), jnp.ones_like(guess), jnp.asarray(1.0), 0)
    return lax.while_loop(lambda s: (s[3] > STEP_TOLERANCE) & (s[4] < MAX_ITERATIONS), iterate, start)[0]
