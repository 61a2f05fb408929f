"""Magnitudes of the species of a network, to which absolute errors are relative."""

from __future__ import annotations

from collections.abc import Iterable

import jax.numpy as jnp
import numpy as np

from .balances import balances_of
from .courses import rate_and_jacobian
from .network import RateLaw

SWEEPS = 60  # most links of a chain of species that start at 0
SETTLED = 2.0  # an estimate that falls by less than this factor is good enough
FALL = 1e-6  # least share of its first value to which an estimate falls


def magnitudes(law: RateLaw, start: np.ndarray, inputs: Iterable[np.ndarray], duration: float) -> np.ndarray:
    """Estimate the magnitude (n_species,) that each species reaches, in its own unit.

    A species that does not start at 0 has the magnitude of its start. One that does has the value to which its production and
    its loss lead within the duration, with all other species at their magnitudes: the rate without the species itself, times
    the duration or, if it is shorter, the time in which the species is lost. The estimate is passed along chains of reactions,
    and conserved sums limit it.

    Parameters
    ----------
    law : RateLaw
        Network.
    start : (n_species,) array
        Initial state.
    inputs : iterable of (n_inputs,) arrays
        Values of the inputs that apply one after the other; a species' magnitude is the largest under any of them.
    duration : float [s]
        Time within which the species changes.
    """
    found = np.abs(start)
    for held in inputs:
        grown = np.minimum(_grown(law, np.asarray(start, float), held, duration), _most(law, start, held))
        found = np.maximum(found, grown)
    least = np.min(found[found > 0.0], initial=np.inf)
    return np.where(found > 0.0, found, least if np.isfinite(least) else 1.0)


def _grown(law: RateLaw, start: np.ndarray, inputs: np.ndarray, duration: float) -> np.ndarray:
    """Return the estimated magnitudes under one set of inputs; 0 for species that nothing produces.

    Once a species has an estimate, it only falls, by at most :data:`FALL`: a magnitude that is too small costs steps, and one
    that is too large costs digits.
    """
    is_empty, y, first = start == 0.0, start.copy(), np.zeros_like(start)
    for _ in range(SWEEPS if is_empty.any() else 0):
        goal = _goals(law, y, inputs, duration)
        first = np.where(is_empty & (y == 0.0), goal, first)
        new = np.where(is_empty, np.where(y == 0.0, goal, np.clip(goal, FALL * first, y)), y)
        is_settled = np.all(SETTLED * new >= y) and np.all((new == 0.0) | (y != 0.0))
        y = new
        if is_settled:
            break
    return np.abs(y)


def _most(law: RateLaw, start: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Return the upper limits (n_species,) that conserved sums of species set, if no species falls below 0."""
    most = np.full(len(start), np.inf)
    for weights in balances_of(law, inputs).conserved:
        if np.all(weights >= 0.0) and np.all(start[weights > 0.0] >= 0.0) and weights @ start > 0.0:
            most[weights > 0.0] = np.minimum(most, weights @ start / np.where(weights > 0.0, weights, 1.0))[
                weights > 0.0
            ]
    return most


def _goals(law: RateLaw, y: np.ndarray, inputs: np.ndarray, duration: float) -> np.ndarray:
    """Return how far each species' production leads from 0 (n_species,), at the state y; 0 where that is not a number."""
    rate, J = (np.asarray(part) for part in rate_and_jacobian(law, jnp.asarray(inputs), jnp.asarray(y)))
    loss = np.diag(J)
    with np.errstate(all="ignore"):
        goal = np.abs((rate - loss * y) * np.minimum(duration, 1.0 / np.abs(loss)))
    return np.where(np.isfinite(goal), goal, 0.0)
