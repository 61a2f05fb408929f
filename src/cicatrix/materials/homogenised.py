"""A constituent as one body whose natural state creeps, instead of many cohorts."""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from ..numerics.tensors import product
from .cohorts import Cohorts, Memory, Places
from .material import EnergyMaterial

MOST = 60  # iterations: Newton's method in a bracket takes about 5, bisection alone 50
CLOSE = 1e-15
SILENT = 1e-8  # relative stress difference below which stress no longer tells how far to go


class Homogenised(Places):
    r"""One natural state per constituent, moving so that stress relaxes to that of deposition at the rate of turnover.

    .. math:: \tau(F N) - \tau_d = \frac{\rho_{old}}{\rho} (\tau(F N_{old}) - \tau_d), \qquad N = N_d + \beta \, (N_{old} - N_d)

    :math:`N_d = U(s)^{-1} G` is the natural state of what is laid down now, :math:`\tau_d = \tau(F N_d)` its Kirchhoff
    stress, :math:`\rho_{old}` the mass that outlives the step, :math:`\rho` all of it. Source: Cyron, Aydin & Humphrey (2016),
    whose stress relaxes at the rate :math:`\dot\rho / \rho + 1 / T`; here that is integrated at the stretch at which the step
    ends. They solve for six components of an inelastic rate, which a law that does not resist all of them leaves open; here
    the natural state moves on the straight line to that of deposition, one number :math:`\beta` per step, and the
    equation holds along the stress difference. Under constant stretch fibres relax as by the heredity integral, for any step.
    """

    cohorts: int = eqx.field(static=True, default=1, init=False)

    def memory(self, law: EnergyMaterial) -> Memory:
        """Itself."""
        return self

    def absorb(
        self, law: EnergyMaterial, F: Array, state: Cohorts, survival: Array, mass: Array, natural: Array
    ) -> Cohorts:
        """Move the natural state."""
        survived = survival * state.masses[..., 0]
        total = survived + mass
        share = jnp.where(total > 0.0, survived / jnp.where(total > 0.0, total, 1.0), 1.0)
        way = state.natural[..., 0, :, :] - natural
        beta = _on_the_way(law, F, natural, way, share)
        return state._replace(masses=total[..., None], natural=(natural + beta[..., None, None] * way)[..., None, :, :])


def _on_the_way(law: EnergyMaterial, F: Array, natural: Array, way: Array, share: Array) -> Array:
    """Beta at which the stress difference is down to its share (...)."""
    start, end = _kirchhoff(law, F, natural), _kirchhoff(law, F, natural + way)
    gap = end - start
    silent = SILENT**2 * jnp.sum(start * start + end * end, axis=(-2, -1)) + 1e-300
    wanted = jnp.sum(gap * (start + share[..., None, None] * gap), axis=(-2, -1)) + silent * share

    def excess(beta, law, F, natural, way, gap, silent, wanted):
        """Work of stress along the gap, beyond what is wanted; about beta itself where stress does not tell."""
        F_e = product(F, natural + beta[..., None, None] * way)
        return jax.jvp(law.energy, (F_e,), (product(gap, F_e),))[1] + silent * beta - wanted

    given = (law, F, natural, way, gap, silent, wanted)
    held = jax.tree.map(lax.stop_gradient, given)
    beta = _bracketed_root(lambda b: excess(b, *held), lax.stop_gradient(share))
    _, slope = jax.jvp(lambda b: excess(b, *held), (beta,), (jnp.ones_like(beta),))
    return beta - excess(beta, *given) / slope


def _kirchhoff(law: EnergyMaterial, F: Array, natural: Array) -> Array:
    F_e = product(F, natural)
    return product(law.stress(F_e), jnp.swapaxes(F_e, -1, -2))


def _bracketed_root(function: Callable[[Array], Array], guess: Array) -> Array:
    """Root in [0, 1] of a function (...) -> (...) that is negative at 0 and positive at 1: Newton's method in a bracket."""

    def go_on(state):
        x, low, high, _, k = state
        value, slope = jax.jvp(function, (x,), (jnp.ones_like(x),))
        low, high = jnp.where(value <= 0.0, x, low), jnp.where(value >= 0.0, x, high)
        step = x - value / jnp.where(slope == 0.0, 1.0, slope)
        new = jnp.where((step >= low) & (step <= high) & (slope > 0.0), step, 0.5 * (low + high))
        return new, low, high, jnp.max(jnp.abs(new - x)), k + 1

    start = (guess, jnp.zeros_like(guess), jnp.ones_like(guess), jnp.asarray(1.0), 0)
    return lax.while_loop(lambda s: (s[3] > CLOSE) & (s[4] < MOST), go_on, start)[0]
