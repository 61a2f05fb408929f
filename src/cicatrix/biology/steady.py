"""Steady states of a network: those reached from given initial states, and others found by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ..numerics.ode import Accuracy
from .balances import Balances, balances_of
from .courses import integrate, rate_and_jacobian
from .network import RateLaw

AT_REST = 1e-4  # Newton's method takes over below this change within the slowest time, relative to the scale
SAME = 1e-5  # difference, relative to the scale, below which two states count as the same
VANISHING = 1e-9  # a rate counts as 0 below this share of the turnover
CONVERGED = 1e-10  # Newton's method ends below this step, relative to the scale
NEUTRAL = 1e-9  # eigenvalues below this, relative to the largest one, count as 0
WIDE = (
    30  # initial guesses of Newton's method up to the largest magnitude, as in a switch that starts with one side off
)
BETWEEN = 9  # initial guesses of Newton's method between each pair of states found
ITERATIONS = 50
HALVES = (1.0, 0.5, 0.25, 0.125, 0.0625)  # fractions of a Newton step that the line search tries
ROUNDS = 2000  # most projections that give a start its totals
N_TIMES = 102  # output times of every course in a run, so that all of them share one compiled program


class SteadyState(NamedTuple):
    """Steady state of a network."""

    y: np.ndarray
    """State (n_species,)."""
    growth: float
    """Largest real part of the Jacobian's eigenvalues for deviations that keep all conserved sums [1/s]; 0 within rounding."""
    n_starts: int
    """Number of initial states whose time course ends in this state."""

    @property
    def is_stable(self) -> bool:
        """Whether small deviations decay, of those that keep the conserved sums."""
        return self.growth < 0.0


class SteadyStates(NamedTuple):
    """Steady states found for one set of inputs."""

    states: list[SteadyState]
    """Stable states first; then in descending order of ``n_starts``."""
    reached: np.ndarray
    """Index of the state reached from every initial state (n_starts,); -1 if no steady state was reached."""
    is_skipped: np.ndarray
    """Whether an initial state was left out (n_starts,), since rates or their derivatives are not finite there."""
    balances: Balances
    """Conserved sums, whose values all starts have in common; a sum that changes for ever, so that no steady state exists."""

    @property
    def stable(self) -> list[SteadyState]:
        """Those of the steady states that are stable."""
        return [state for state in self.states if state.is_stable]

    @property
    def n_conserved(self) -> int:
        """Number of independent sums of species that the network conserves."""
        return len(self.balances.conserved)

    @property
    def n_unsettled(self) -> int:
        """Number of initial states that could be followed but did not reach a steady state."""
        return int(np.sum((self.reached < 0) & ~self.is_skipped))

    @property
    def is_bistable(self) -> bool | None:
        """Whether there are several stable states; None while starts are unsettled that could decide it otherwise.

        The first and the last start must have settled, and all of them if fewer than two stable states are known.
        """
        if len(self.balances.growing):
            return False
        has_own = len(self.reached) and self.reached[0] >= 0 and self.reached[-1] >= 0
        if not has_own or (len(self.stable) < 2 and np.any(self.reached < 0)):
            return None
        return len(self.stable) > 1


class _Problem(NamedTuple):
    """What every step of the search needs: 0 = dy/dt and conserved . y = totals."""

    law: RateLaw
    inputs: np.ndarray
    scale: np.ndarray
    conserved: np.ndarray
    """Weights of the conserved sums (n_conserved, n_species)."""
    totals: np.ndarray
    """Values of the conserved sums (n_conserved,)."""

    def rates(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return dy/dt and the Jacobian."""
        rate, J = rate_and_jacobian(self.law, jnp.asarray(self.inputs), jnp.asarray(y))
        return np.asarray(rate), np.asarray(J)

    def sizes(self, y: np.ndarray) -> np.ndarray:
        """Return the magnitude of each species at a state: its scale, or more."""
        return np.maximum(self.scale, np.abs(y))


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
        Initial states; the first one has the totals of the case. All others are moved to the nearest states with its totals.
    longest : float [s]
        Duration of the integration; a hundredth of it counts as the slowest time of the network.
    scale : (n_species,) array
        Magnitude of every species, to which tolerances are relative.
    accuracy : Accuracy
        Accuracy of the time integration; the states themselves are found by Newton's method to rounding.

    Notes
    -----
    A state is steady if the rate of every species is 0 within :data:`VANISHING` of its turnover. Each initial state is assigned
    to the steady state at the end of its course: basins of attraction are those of the network's own dynamics, tau included.
    Newton's method from all initial states, from points between the states found, and, where magnitudes differ, from points up
    to the largest of them, adds states that no course reached, such as saddles between basins. It solves for vanishing rates and
    the totals of the conserved sums together, so every state found has the totals of the first start. Stability follows from
    the eigenvalues of the Jacobian. The list of states is not guaranteed to be complete.
    """
    balances = balances_of(law, inputs)
    if len(balances.growing):
        return SteadyStates([], np.full(len(starts), -1), np.zeros(len(starts), bool), balances)
    problem = _Problem(law, inputs, scale, balances.conserved, balances.conserved @ starts[0])
    starts = np.vstack([starts[:1], *(_with_totals(problem, start) for start in starts[1:])])
    times = jnp.asarray(np.concatenate([[0.0], np.full(N_TIMES - 1, longest)]))
    found: list[np.ndarray] = []
    reached, is_skipped = np.full(len(starts), -1), np.zeros(len(starts), bool)
    for number, start in enumerate(starts):
        end = _end(problem, start, times, accuracy)
        y = None if end is None else _settled(problem, end, 0.01 * longest)
        is_skipped[number] = end is None
        if y is not None:
            reached[number] = _number_of(y, found, scale)
    for guess in _guesses(np.vstack([starts, 0.5 * scale, *_wide(scale)]), found):
        y = _newton(problem, guess)
        if y is not None and np.all((y > -SAME * scale) | (starts.min(0) < 0.0)):
            _number_of(y, found, scale)
    return _sorted(problem, found, reached, is_skipped, balances)


def _with_totals(problem: _Problem, start: np.ndarray) -> np.ndarray:
    """Return a state near a start that has the totals of the problem and no more negative values, by alternating projections."""
    if not len(problem.conserved):
        return start
    weights = problem.conserved * problem.scale
    back = problem.scale[:, None] * np.linalg.pinv(weights)
    size = np.abs(weights).sum(axis=1)
    y = start
    for _ in range(ROUNDS):
        y = y - back @ (problem.conserved @ y - problem.totals)
        y = np.where(start >= 0.0, np.maximum(y, 0.0), y)
        if np.all(np.abs(problem.conserved @ y - problem.totals) < CONVERGED * size):
            break
    return y


def _end(problem: _Problem, start: np.ndarray, times: np.ndarray, accuracy: Accuracy) -> np.ndarray | None:
    """Return the state where a course ends, early or not; None if rates or derivatives are not finite at its start."""
    rate, J = problem.rates(start)
    if not np.isfinite(rate).all() or (accuracy.method == "implicit" and not np.isfinite(J).all()):
        return None
    done = integrate(problem.law, jnp.asarray(problem.inputs), jnp.asarray(start), times, accuracy)
    return np.asarray(done.y[-1]) if done.is_done else np.asarray(done.last)


def _settled(problem: _Problem, y: np.ndarray, slowest: float) -> np.ndarray | None:
    """Return the steady state near the end of a course, or None if the course has not reached one."""
    sizes, (rate, _) = problem.sizes(y), problem.rates(y)
    if not np.all(np.abs(rate) * slowest < AT_REST * sizes):
        return None
    near = _newton(problem, y)
    is_near = near is not None and np.all(np.abs(near - y) < 100 * AT_REST * sizes)
    return near if is_near else None


def _newton(problem: _Problem, y: np.ndarray) -> np.ndarray | None:
    """Find a steady state from a guess y by Newton's method with step halving; None if it does not converge to one.

    Each step is the least-squares solution of the linearised rates and conserved sums together, in which every species is
    divided by its magnitude, every rate by its turnover and every sum by its magnitude. Where states form a continuum
    that no linear sum distinguishes, it is the shortest step.
    """
    rate, J = problem.rates(y)
    for _ in range(ITERATIONS):
        if not (np.isfinite(rate).all() and np.isfinite(J).all()):
            return None
        sizes = problem.sizes(y)
        per = _reciprocal(np.concatenate([np.abs(J) @ sizes, np.abs(problem.conserved) @ sizes]))
        residual = per * np.concatenate([rate, problem.conserved @ y - problem.totals])
        slopes = per[:, None] * np.vstack([J, problem.conserved]) * sizes
        step = sizes * np.clip(np.linalg.lstsq(slopes, -residual, rcond=1e-12)[0], -0.5, 0.5)
        if np.all(np.abs(step) < CONVERGED * sizes):
            return y + step if _is_steady(problem, y + step) else None
        for share in HALVES:
            new = y + share * step
            rate, J = problem.rates(new)
            left = per * np.concatenate([rate, problem.conserved @ new - problem.totals])
            if np.max(np.abs(left)) < np.max(np.abs(residual)):
                break
        y = new
    return None


def _is_steady(problem: _Problem, y: np.ndarray) -> bool:
    """Return whether every rate is 0 relative to the turnover of its species, and every conserved sum has its total."""
    (rate, J), sizes = problem.rates(y), problem.sizes(y)
    off = np.abs(problem.conserved @ y - problem.totals)
    is_at_rest = np.all(np.abs(rate) <= VANISHING * (np.abs(J) @ sizes))
    return bool(is_at_rest and np.all(off <= VANISHING * (np.abs(problem.conserved) @ sizes)))


def _reciprocal(values: np.ndarray) -> np.ndarray:
    return 1.0 / np.where(values > 0.0, values, 1.0)


def _wide(scale: np.ndarray) -> np.ndarray:
    """Return guesses (n, n_species) in which every species is up to twice the largest magnitude; none if all are about equal."""
    if np.max(scale) <= 2.0 * np.min(scale):
        return np.zeros((0, len(scale)))
    rng = np.random.Generator(np.random.Philox(0))
    return latin_hypercube(np.zeros_like(scale), np.full_like(scale, 2.0 * np.max(scale)), WIDE, rng)


def _guesses(starts: np.ndarray, found: Sequence[np.ndarray]) -> list[np.ndarray]:
    shares = np.linspace(0.0, 1.0, BETWEEN + 2)[1:-1]
    between = [a + share * (b - a) for i, a in enumerate(found) for b in found[:i] for share in shares]
    return [*starts, *between]


def _number_of(y: np.ndarray, found: list[np.ndarray], scale: np.ndarray) -> int:
    """Return the index of a state in ``found``, after appending it if it is new."""
    for number, other in enumerate(found):
        if np.all(np.abs(other - y) < SAME * np.maximum(scale, np.abs(y))):
            return number
    found.append(y)
    return len(found) - 1


def _growth(problem: _Problem, y: np.ndarray) -> float:
    """Return the largest real part [1/s] of the Jacobian's eigenvalues on the deviations that keep all conserved sums."""
    sizes = problem.sizes(y)
    basis = np.linalg.qr((problem.conserved * sizes).T, mode="complete")[0][:, len(problem.conserved) :]
    values = np.linalg.eigvals(basis.T @ (problem.rates(y)[1] * sizes / sizes[:, None]) @ basis)
    growth = float(np.max(values.real, initial=-np.inf))
    return 0.0 if abs(growth) <= NEUTRAL * np.max(np.abs(values), initial=0.0) else growth


def _sorted(
    problem: _Problem, found: list[np.ndarray], reached: np.ndarray, is_skipped: np.ndarray, balances: Balances
) -> SteadyStates:
    states = [SteadyState(y, _growth(problem, y), int(np.sum(reached == number))) for number, y in enumerate(found)]
    order = sorted(range(len(states)), key=lambda i: (not states[i].is_stable, -states[i].n_starts, tuple(states[i].y)))
    rank = {old: new for new, old in enumerate(order)} | {-1: -1}
    return SteadyStates(
        [states[i] for i in order], np.array([rank[number] for number in reached]), is_skipped, balances
    )
