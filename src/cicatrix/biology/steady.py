"""Steady states of a network: where it comes to rest from several starts, and where it could rest but does not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..numerics.ode import Accuracy
from .courses import follow
from .network import RateLaw

AT_REST = 1e-4  # of the range, within the slowest time: what Newton's method then settles
SAME = 1e-5  # of the range: nearer states are one
NEUTRAL = 1e-7  # of the fastest rate: an eigenvalue that is 0 but for rounding
BETWEEN = 9  # starts of Newton's method between each two stable states
ITERATIONS = 50
HALVES = (1.0, 0.5, 0.25, 0.125, 0.0625)  # of a step
N_TIMES = 102  # of every course in a run, so that all of them share one program


class SteadyState(NamedTuple):
    """A state that does not move."""

    y: np.ndarray
    """(n_species,)."""
    growth: float
    """Largest real part of an eigenvalue of the Jacobian [1/s], those of conserved quantities left out."""
    n_starts: int
    """Starts that came to rest here."""

    @property
    def is_stable(self) -> bool:
        """Whether small deviations decay."""
        return self.growth < 0.0


class SteadyStates(NamedTuple):
    """What was found under one set of inputs."""

    states: list[SteadyState]
    """Stable ones first, those with most starts first."""
    reached: np.ndarray
    """Of every start (n_starts,), the number of its state; -1: did not come to rest."""
    n_conserved: int
    """Quantities that the network conserves: each makes a continuum of steady states."""

    @property
    def stable(self) -> list[SteadyState]:
        """Those that the network can be found in."""
        return [state for state in self.states if state.is_stable]


def latin_hypercube(low: np.ndarray, high: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Starts (n, n_species) between low and high (n_species,): each species in each n-th of its range once."""
    strata = rng.permuted(np.tile(np.arange(n), (len(low), 1)), axis=1).T
    return low + (high - low) * (strata + rng.random(strata.shape)) / max(n, 1)


def steady_states(
    law: RateLaw, inputs: np.ndarray, starts: np.ndarray, longest: float, scale: np.ndarray, accuracy: Accuracy
) -> SteadyStates:
    """Follow the network from every start until it rests, and search further for states that nothing leads to.

    Parameters
    ----------
    law : RateLaw
        The network; its rate must not heed time.
    inputs : (n_inputs,) array
        Held.
    starts : (n_starts, n_species) array
        Where to start.
    longest : float [s]
        How long to follow; a hundredth of it counts as the slowest time of the network.
    scale : (n_species,) array
        Range of every species, by which "near" is judged.
    accuracy : Accuracy
        Of the courses; the states themselves are found by Newton's method to rounding.

    Notes
    -----
    A start counts for the state at its course's end: basins are those of the network's own dynamics, tau included. Newton's
    method alone, from all starts and from between stable states, adds states that no course reached: saddles between basins; not
    where something is conserved, and states are a continuum anyway.
    Stability is that of the Jacobian. What no start leads to, and Newton's method does not meet, is not found: the list is what
    was found, not a proof that there is no more.
    """
    times = np.concatenate([[0.0], np.full(N_TIMES - 1, longest)])
    found: list[np.ndarray] = []
    reached = np.full(len(starts), -1)
    for number, start in enumerate(starts):
        done = follow(law, jnp.asarray(inputs), jnp.asarray(start), jnp.asarray(times), accuracy)
        y = _settled(law, inputs, np.asarray(done.y[-1]), 0.01 * longest, scale) if done.is_done else None
        if y is not None:
            reached[number] = _number_of(y, found, scale)
    n_conserved = max([0, *(_eigenvalues(law, inputs, y)[1] for y in found)])
    for guess in _guesses(np.vstack([starts, 0.5 * scale]), found) if not n_conserved else []:
        y = _newton(law, inputs, guess, scale)
        if y is not None and np.all(y > -SAME * scale) and np.all(y < (1.0 + SAME) * np.maximum(scale, starts.max(0))):
            _number_of(y, found, scale)
    return _sorted(law, inputs, found, reached, n_conserved)


@eqx.filter_jit
def rate_and_jacobian(law: RateLaw, inputs: Array, y: Array) -> tuple[Array, Array]:
    """dy/dt (n_species,) and its derivative by the state (n_species, n_species)."""
    bound = law.under(inputs)
    return bound.rate(y), jax.jacfwd(bound.rate)(y)


def _settled(law: RateLaw, inputs: np.ndarray, y: np.ndarray, slowest: float, scale: np.ndarray) -> np.ndarray | None:
    """The steady state beside a course's end, if it rests there."""
    rate, _ = rate_and_jacobian(law, jnp.asarray(inputs), jnp.asarray(y))
    if not np.all(np.abs(rate) * slowest < AT_REST * scale):
        return None
    near = _newton(law, inputs, y, scale)
    is_near = near is not None and np.all(np.abs(near - y) < 100 * AT_REST * scale)
    return near if is_near else None


def _newton(law: RateLaw, inputs: np.ndarray, y: np.ndarray, scale: np.ndarray) -> np.ndarray | None:
    """Newton's method, halving steps that do not slow the network; least squares, so that what is conserved nearly stays."""
    held = jnp.asarray(inputs)
    rate, J = (np.asarray(part) for part in rate_and_jacobian(law, held, jnp.asarray(y)))
    for _ in range(ITERATIONS):
        if not (np.isfinite(rate).all() and np.isfinite(J).all()):
            return None
        step = np.clip(np.linalg.lstsq(J, -rate, rcond=1e-12)[0], -0.5 * scale, 0.5 * scale)
        if np.all(np.abs(step) < 1e-11 * scale):
            return y + step
        for share in HALVES:
            new, new_J = (np.asarray(part) for part in rate_and_jacobian(law, held, jnp.asarray(y + share * step)))
            if np.max(np.abs(new) / scale) < np.max(np.abs(rate) / scale):
                break
        y, rate, J = y + share * step, new, new_J
    return None


def _guesses(starts: np.ndarray, found: Sequence[np.ndarray]) -> list[np.ndarray]:
    shares = np.linspace(0.0, 1.0, BETWEEN + 2)[1:-1]
    between = [a + share * (b - a) for i, a in enumerate(found) for b in found[:i] for share in shares]
    return [*starts, *between]


def _number_of(y: np.ndarray, found: list[np.ndarray], scale: np.ndarray) -> int:
    """Which of the states it is; a new one is entered."""
    for number, other in enumerate(found):
        if np.all(np.abs(other - y) < SAME * scale):
            return number
    found.append(y)
    return len(found) - 1


def _eigenvalues(law: RateLaw, inputs: np.ndarray, y: np.ndarray) -> tuple[float, int]:
    """Largest real part of an eigenvalue [1/s], and how many are 0: these count what is conserved, and are left out of it."""
    values = np.linalg.eigvals(np.asarray(rate_and_jacobian(law, jnp.asarray(inputs), jnp.asarray(y))[1]))
    is_neutral = np.abs(values) < NEUTRAL * np.max(np.abs(values), initial=1e-300)
    return float(np.max(values.real[~is_neutral], initial=-np.inf)), int(is_neutral.sum())


def _sorted(
    law: RateLaw, inputs: np.ndarray, found: list[np.ndarray], reached: np.ndarray, n_conserved: int
) -> SteadyStates:
    states = [
        SteadyState(y, _eigenvalues(law, inputs, y)[0], int(np.sum(reached == number)))
        for number, y in enumerate(found)
    ]
    order = sorted(range(len(states)), key=lambda i: (not states[i].is_stable, -states[i].n_starts, tuple(states[i].y)))
    rank = {old: new for new, old in enumerate(order)} | {-1: -1}
    return SteadyStates([states[i] for i in order], np.array([rank[number] for number in reached]), n_conserved)
