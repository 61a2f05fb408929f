"""Integrate the bonds of a case from one history row to the next: their mean, single random bonds, or clutches.

The result at a row depends, to the bit, only on the state at the previous row, so a run can be resumed at any row.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...biology.adhesion import Adhesion, integrate_bound_fraction, relax_bound_fraction, steady_state
from ...biology.clutch import Clutches, ClutchSubstrate, MotorClutch
from ...biology.sampling import exact, monte_carlo
from ...cases.adhesion_laws import is_viscoelastic
from ...core.errors import ConvergenceError, InputError
from .build import clutch_of, clutch_substrate
from .case import AdhesionCase

UPDATES = 2**26  # bond updates between two returns to Python, where an interrupt is noticed
MAX_SUBSTEPS = 2**16  # largest number of time steps between two rows
MAX_EVENTS, MAX_EVENTS_EACH = 1e10, 1e7  # largest number of events of all bonds and of one bond, at exact times
TOLERANCE = 1e-9  # absolute error of the mean bound fraction on a viscoelastic substrate


class Bonds(NamedTuple):
    """State of the bonds on each stretch (s,)."""

    mean: np.ndarray
    """Mean bound fraction [1]."""
    sd: np.ndarray
    """Standard deviation of the bound fraction between cells [1]; 0 for the mean field."""
    force: np.ndarray
    """Mean force of one closed bond [pN]."""
    others: dict[str, np.ndarray] = {}  # noqa: RUF012 - never changed
    """Further columns of the history by name, each (s,); only clutches have any."""


@dataclass(frozen=True)
class MeanFieldBonds:
    """Mean bound fraction of all bonds: in closed form, or in adaptive steps on a viscoelastic substrate.

    Source: Guo, Mofrad & Buganza Tepole, Eq. (24).
    """

    case: AdhesionCase
    law: Adhesion

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the rows (n_rows + 1,) [s]."""
        return np.linspace(0.0, self.case.method.duration_s, self.case.method.n_rows + 1)

    @cached_property
    def _stretch(self) -> np.ndarray:
        return np.array(self.case.substrate.stretch)

    @cached_property
    def _k_off(self) -> np.ndarray:
        return np.asarray(steady_state(self.law, self._stretch).k_off)

    def start(self) -> np.ndarray:
        """Return the initial bound fraction on each stretch (s,) [1]."""
        return np.full(self._stretch.shape, self.case.method.start_bound_fraction)

    def advance(self, bound: np.ndarray, row: int) -> np.ndarray:
        """Integrate the bound fraction (s,) [1] from the previous row to this row."""
        if not is_viscoelastic(self.case.substrate):
            return np.asarray(relax_bound_fraction(self.start(), self.law.bond.k_on, self._k_off, self.times[row]))
        start, end = self.times[row - 1], self.times[row]
        coarse, n = integrate_bound_fraction(self.law, bound, self._stretch, start, end, 1), 2
        while n <= MAX_SUBSTEPS:
            fine = integrate_bound_fraction(self.law, bound, self._stretch, start, end, n)
            better = (4.0 * fine - coarse) / 3.0  # Richardson extrapolation of a second-order method
            if float(jnp.max(jnp.abs(better - fine))) <= TOLERANCE:
                return np.asarray(better)
            coarse, n = fine, 2 * n
        raise ConvergenceError(
            f"The bound fraction changes too fast between {start:.6g} and {end:.6g} s; increase method.n_rows."
        )

    def report(self, bound: np.ndarray, row: int) -> Bonds:
        """Return the mean bound fraction and bond force for a row of the history; the standard deviation is 0."""
        force = steady_state(self.law, self._stretch, self.times[row]).force
        return Bonds(bound, np.zeros_like(bound), np.asarray(force))


@dataclass(frozen=True)
class SampledBonds:
    """Randomly sampled bonds of several cells on each stretch: an array (s * cells, integrins) of 0 (open) and 1 (closed)."""

    case: AdhesionCase
    law: Adhesion

    @cached_property
    def _steps(self) -> np.ndarray:
        return steps_of_rows(self.case)

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the rows [s]; with a fixed time step, each is a whole number of steps."""
        method = self.case.method
        if method.dt_s is None:
            return np.linspace(0.0, method.duration_s, method.n_rows + 1)
        return self._steps * method.dt_s

    @cached_property
    def _stretch(self) -> np.ndarray:
        """Stretch under each cell (g,) [1]."""
        return np.repeat(np.array(self.case.substrate.stretch), self.case.n_cells)

    @cached_property
    def _k_off(self) -> np.ndarray:
        return np.asarray(steady_state(self.law, self._stretch).k_off)

    def start(self) -> np.ndarray:
        """Close the first bonds of every cell, as many as come nearest to the initial bound fraction."""
        n = self.case.method.n_integrins or 0
        first = np.arange(n) < round(self.case.method.start_bound_fraction * n)
        return np.tile(first.astype(np.uint8), (len(self._stretch), 1))

    def advance(self, bound: np.ndarray, row: int) -> np.ndarray:
        """Advance the bonds from the previous row to this row."""
        return self._by_steps(bound, row) if self.case.method.dt_s is not None else self._exactly(bound, row)

    def report(self, bound: np.ndarray, row: int) -> Bonds:
        """Return mean and standard deviation of the bound fraction over the cells of each stretch, and the force."""
        each = bound.mean(axis=1).reshape(-1, self.case.n_cells)
        force = steady_state(self.law, np.array(self.case.substrate.stretch), self.times[row]).force
        return Bonds(each.mean(axis=1), each.std(axis=1, ddof=1), np.asarray(force))

    def events(self) -> np.ndarray:
        """Estimate the number of candidate events of one bond on each stretch (s,) [1], if times are exact."""
        stretch, k_on = np.array(self.case.substrate.stretch), np.asarray(self.law.bond.k_on, float)
        start, end = self.times[:-1, None], self.times[1:, None]
        least, most = (
            _ends(self.law, stretch, start, end) if is_viscoelastic(self.case.substrate) else _still(self.law, stretch)
        )
        bound = k_on / (k_on + least)
        return np.sum((bound * most + (1.0 - bound) * k_on) * (end - start), axis=0)

    def _by_steps(self, bound: np.ndarray, row: int) -> np.ndarray:
        first, last = self._steps[row - 1], self._steps[row]
        portion = max(1, UPDATES // bound.size)
        for start in range(first, last, portion):
            end = min(start + portion, last)
            bound = monte_carlo(bound, *self._chances(start, end), self.case.seed, start)
        return bound

    def _chances(self, start: int, end: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the probabilities that a bond closes and opens in each step (steps, g), by the rates at midpoints."""
        dt = self.case.method.dt_s or 0.0
        if is_viscoelastic(self.case.substrate):
            middle = (np.arange(start, end)[:, None] + 0.5) * dt
            k_off = _rates(self.law, *np.broadcast_arrays(self._stretch, middle))
        else:
            k_off = np.broadcast_to(self._k_off, (end - start, len(self._stretch)))
        on, off = self.law.step_probabilities(dt, k_off)
        return np.asarray(on), np.asarray(off)

    def _exactly(self, bound: np.ndarray, row: int) -> np.ndarray:
        times = self.times[row - 1], self.times[row]
        k_on = np.broadcast_to(np.asarray(self.law.bond.k_on, float), self._stretch.shape)
        if not is_viscoelastic(self.case.substrate):
            return exact(bound, times, k_on, self._k_off, None, self.case.seed, row)
        most = np.asarray(self.law.max_k_off(self._stretch, *times))

        def k_off(time: np.ndarray, cell: np.ndarray) -> np.ndarray:
            return _rates(self.law, self._stretch[cell], time)

        return exact(bound, times, k_on, most, k_off, self.case.seed, row)


@dataclass(frozen=True)
class ClutchBonds:
    """Motor-clutch model of several cells on each stretch, in fixed time steps; its state is an array (s * cells, 2 n + 2).

    The first n columns are 1 for closed and 0 for open clutches, the next n the positions of the clutches' actin ends [um],
    and the last two the displacements of the substrate and of its dashpot [um].
    """

    case: AdhesionCase
    law: Adhesion
    clutch: MotorClutch

    @cached_property
    def _steps(self) -> np.ndarray:
        return steps_of_rows(self.case)

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the rows [s], each a whole number of steps."""
        return self._steps * self.case.method.dt_s

    @cached_property
    def _substrate(self) -> ClutchSubstrate:
        return clutch_substrate(self.law, np.repeat(np.array(self.case.substrate.stretch), self.case.n_cells))

    def start(self) -> np.ndarray:
        """Close the first clutches of every cell, as many as come nearest to the initial bound fraction."""
        n, cells = self.case.method.n_integrins or 0, self.case.n_cells * len(self.case.substrate.stretch)
        return _packed(self.clutch.start(cells, n, round(self.case.method.start_bound_fraction * n)))

    def advance(self, bound: np.ndarray, row: int) -> np.ndarray:
        """Advance the clutches from the previous row to this row."""
        now = _unpacked(bound)
        for step in range(self._steps[row - 1], self._steps[row]):
            now = self.clutch.advance(self._substrate, now, self.case.method.dt_s or 0.0, self.case.seed, step)
        return _packed(now)

    def report(self, bound: np.ndarray, row: int) -> Bonds:
        """Return mean and standard deviation of the bound fraction over cells, and the force per closed clutch."""
        now = _unpacked(bound)
        each = now.bound.mean(axis=1).reshape(-1, self.case.n_cells)
        force = self.clutch.force(self._substrate, now).reshape(each.shape)
        closed = each.sum(axis=1) * now.bound.shape[1]
        flow = self.clutch.flow(self._substrate, now).reshape(each.shape).mean(axis=1)
        others = {"cell_force_pN": force.mean(axis=1), "flow_um_per_s": flow}
        return Bonds(each.mean(axis=1), each.std(axis=1, ddof=1), force.sum(axis=1) / np.maximum(closed, 1.0), others)


def _packed(now: Clutches) -> np.ndarray:
    return np.hstack([now.bound, now.end, now.displacement[:, None], now.dashpot[:, None]])


def _unpacked(state: np.ndarray) -> Clutches:
    n = state.shape[1] // 2 - 1
    return Clutches(state[:, :n] > 0.5, state[:, n : 2 * n], state[:, -2], state[:, -1])


def steps_of_rows(case: AdhesionCase) -> np.ndarray:
    """Return the number of fixed steps from the start to each row."""
    method = case.method
    n = round(method.duration_s / (method.dt_s or method.duration_s / method.n_rows))
    return np.round(np.linspace(0, n, min(method.n_rows, n) + 1)).astype(int)


def _rates(law: Adhesion, stretch: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the opening rate (...) [1/s] at stretches and times (...); padding to a power of two limits compilations."""
    n = stretch.size
    room = 1 << max(n - 1, 2**15 - 1).bit_length()
    padded = [np.concatenate([values.ravel(), np.ones(room - n)]) for values in (stretch, time)]
    return np.asarray(steady_state(law, *padded).k_off)[:n].reshape(stretch.shape)


def _still(law: Adhesion, stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k_off = np.asarray(steady_state(law, stretch).k_off)
    return k_off, k_off


def _ends(law: Adhesion, stretch: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the smaller opening rate at the ends of time intervals, and an upper bound within: (n, 1) [s] -> (n, s) [1/s]."""
    least = jnp.minimum(steady_state(law, stretch, start).k_off, steady_state(law, stretch, end).k_off)
    return np.asarray(least), np.asarray(law.max_k_off(stretch, start, end))


BondSolver = MeanFieldBonds | SampledBonds | ClutchBonds  # all have times, start, advance and report


def bond_solver(case: AdhesionCase, law: Adhesion) -> BondSolver:
    """Choose the method that computes the bonds of a case."""
    clutch = clutch_of(case)
    if clutch is not None:
        return ClutchBonds(case, law, clutch)
    if case.method.type == "ode":
        return MeanFieldBonds(case, law)
    sampled = SampledBonds(case, law)
    if case.method.type == "ssa":
        _refuse_too_many(sampled)
    return sampled


def _refuse_too_many(sampled: SampledBonds) -> None:
    """Refuse exact event times if there are so many events that the run would take too long."""
    each = sampled.events()
    total = each.sum() * sampled.case.n_cells * (sampled.case.method.n_integrins or 0)
    if not (each.max() <= MAX_EVENTS_EACH and total <= MAX_EVENTS):
        raise InputError(
            f'method.type = "ssa" would take about {each.max():.2g} events of each bond and {total:.2g} of all, more than '
            f"{MAX_EVENTS_EACH:g} and {MAX_EVENTS:g}; reduce duration_s or force, or raise n_rows on a viscoelastic substrate"
        )
