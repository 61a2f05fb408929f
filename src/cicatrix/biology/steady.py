"""Steady states of a network: those reached from given initial states, and others found by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..numerics.ode import Accuracy
from .courses import integrate
from .network import RateLaw

AT_REST = 1e-4  # Newton's method takes over below this change within the slowest time, relative to the range
SAME = 1e-5  # difference, relative to the range of values, below which two states count as the same
NEUTRAL = 1e-7  # eigenvalues below this, relative to the largest one, count as 0
BETWEEN = 9  # initial guesses of Newton's method between each pair of states found
ITERATIONS = 50
HALVES = (1.0, 0.5, 0.25, 0.125, 0.0625)  # fractions of a Newton step that the line search tries
N_TIMES = 102  # output times of every course in a run, so that all of them share one compiled program


class SteadyState(NamedTuple):
    """Steady state of a network."""

    y: np.ndarray
    """State (n_species,)."""
    growth: float
    """Largest real part of the eigenvalues of the Jacobian [1/s], without those of conserved quantities."""
    n_starts: int
    """Number of initial states whose time course ends in this state."""

    @property
    def is_stable(self) -> bool:
        """Whether small deviations decay."""
        return self.growth < 0.0


class SteadyStates(NamedTuple):
    """Steady states found for one set of inputs."""

    states: list[SteadyState]
    """Stable states first; then in descending order of ``n_starts``."""
    reached: np.ndarray
    """Index of the state reached from every initial state (n_starts,); -1 if no steady state was reached."""
    n_conserved: int
    """Number of conserved quantities; each makes a continuum of steady states."""

    @property
    def stable(self) -> list[SteadyState]:
        """Those of the steady states that are stable."""
        return [state for state in self.states if state.is_stable]


def latin_hypercube(low: np.ndarray, high: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draw n initial states (n, n_species) between low and high (n_species,), one in every n-th of the range of each species."""
    strata = rng.permuted(np.tile(np.arange(n), (len(low), 1)), axis=1).T
    return low + (high - low) * (strata + rng.random(strata.shape)) / max(n, 1)


def steady_states(
    law: RateLaw, inputs: np.ndarray, starts: np.ndarray, longest: float, scale: np.ndarray, accuracy: Accuracy
) -> SteadyStates:
    """Integrate the network from every initial state until it is steady, and search for further steady states.

    Parameters
    ----------
    law : RateLaw
        Network, whose rate must not depend explicitly on time.
    inputs : (n_inputs,) array
        Inputs, constant in time.
    starts : (n_starts, n_species) array
        Initial states.
    longest : float [s]
        Duration of the integration; a hundredth of it counts as the slowest time of the network.
    scale : (n_species,) array
        Range of every species, to which tolerances are relative.
    accuracy : Accuracy
        Accuracy of the time integration; the states themselves are found by Newton's method to rounding.

    Notes
    -----
    Each initial state is assigned to the steady state at the end of its course: basins of attraction are those of the
    network's own dynamics, tau included. Newton's method from all initial states, and from points between the states found,
    adds states that no course reached, such as saddles between basins. Newton's method is not used if quantities are
    conserved, since steady states then form a continuum. Stability follows from the eigenvalues of the Jacobian. The list of
    states is not guaranteed to be complete.
    """
    times = np.concatenate([[0.0], np.full(N_TIMES - 1, longest)])
    found: list[np.ndarray] = []
    reached = np.full(len(starts), -1)
    for number, start in enumerate(starts):
        done = integrate(law, jnp.asarray(inputs), jnp.asarray(start), jnp.asarray(times), accuracy)
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
    """Return dy/dt (n_species,) and its derivative with respect to the state (n_species, n_species)."""
    bound = law.under(inputs)
    return bound.rate(y), jax.jacfwd(bound.rate)(y)


def _settled(law: RateLaw, inputs: np.ndarray, y: np.ndarray, slowest: float, scale: np.ndarray) -> np.ndarray | None:
    """Return the steady state near the end of a course, or None if the course has not reached one."""
    rate, _ = rate_and_jacobian(law, jnp.asarray(inputs), jnp.asarray(y))
    if not np.all(np.abs(rate) * slowest < AT_REST * scale):
        return None
    near = _newton(law, inputs, y, scale)
    is_near = near is not None and np.all(np.abs(near - y) < 100 * AT_REST * scale)
    return near if is_near else None


def _newton(law: RateLaw, inputs: np.ndarray, y: np.ndarray, scale: np.ndarray) -> np.ndarray | None:
    """Find a steady state from a guess y by Newton's method with step halving; None if it does not converge.

    Each step is the least-squares solution, which almost preserves conserved quantities (the Jacobian is then singular).
    """
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
    """Return the index of a state in ``found``, after appending it if it is new."""
    for number, other in enumerate(found):
        if np.all(np.abs(other - y) < SAME * scale):
            return number
    found.append(y)
    return len(found) - 1


def _eigenvalues(law: RateLaw, inputs: np.ndarray, y: np.ndarray) -> tuple[float, int]:
    """Return the largest real part of the non-zero eigenvalues [1/s], and how many are 0 (conserved quantities)."""
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
