"""The bonds of a case followed from row to row: their mean, or single bonds at random. Equal rows give equal bits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...biology.adhesion import Adhesion, after, anchored, carried
from ...biology.clutch import Clutches, Ground, MotorClutch
from ...biology.sampling import exact, monte_carlo
from ...cases.adhesion_laws import is_viscoelastic
from ...core.errors import ConvergenceError, InputError
from .build import clutch_of, ground_under
from .case import AdhesionCase

UPDATES = 2**26  # of bonds between two looks at the keyboard
FINEST = 2**16  # parts of the time between two rows
MOST_EVENTS, MOST_EVENTS_EACH = 1e10, 1e7  # of all bonds and of one, at exact times
TOLERANCE = 1e-9  # of the mean bound fraction on a substrate that yields


class Bonds(NamedTuple):
    """Bonds on each stretch (s,)."""

    mean: np.ndarray
    """Bound fraction [1]."""
    sd: np.ndarray
    """Its standard deviation between cells [1]; 0 of the mean field."""
    force: np.ndarray
    """Of one closed bond, in the mean [pN]."""
    others: dict[str, np.ndarray] = {}  # noqa: RUF012 - never changed
    """What clutches have beside, by column, each (s,)."""


@dataclass(frozen=True)
class MeanField:
    """Eq. (24) of the review: by its solution, or in steps as fine as it takes where the substrate yields."""

    case: AdhesionCase
    law: Adhesion

    @cached_property
    def times(self) -> np.ndarray:
        """Of the rows [s]."""
        return np.linspace(0.0, self.case.method.duration_s, self.case.method.n_rows + 1)

    @cached_property
    def _stretch(self) -> np.ndarray:
        return np.array(self.case.substrate.stretch)

    @cached_property
    def _k_off(self) -> np.ndarray:
        return np.asarray(anchored(self.law, self._stretch).k_off)

    def start(self) -> np.ndarray:
        """Bound fraction on each stretch (s,) [1]."""
        return np.full(self._stretch.shape, self.case.method.start_bound_fraction)

    def onward(self, bound: np.ndarray, row: int) -> np.ndarray:
        """Bound fraction (s,) [1] at the next row."""
        if not is_viscoelastic(self.case.substrate):
            return np.asarray(after(self.start(), self.law.bond.k_on, self._k_off, self.times[row]))
        start, end = self.times[row - 1], self.times[row]
        coarse, n = carried(self.law, bound, self._stretch, start, end, 1), 2
        while n <= FINEST:
            fine = carried(self.law, bound, self._stretch, start, end, n)
            better = (4.0 * fine - coarse) / 3.0  # both are of second order
            if float(jnp.max(jnp.abs(better - fine))) <= TOLERANCE:
                return np.asarray(better)
            coarse, n = fine, 2 * n
        raise ConvergenceError(
            f"The bound fraction changes too fast between {start:.6g} and {end:.6g} s; give more method.n_rows."
        )

    def told(self, bound: np.ndarray, row: int) -> Bonds:
        """The mean; no cell differs from another one."""
        force = anchored(self.law, self._stretch, self.times[row]).force
        return Bonds(bound, np.zeros_like(bound), np.asarray(force))


@dataclass(frozen=True)
class Sampled:
    """Single bonds: 16 cells, or as many as said, on each stretch; an array (s * cells, integrins) of 0 and 1."""

    case: AdhesionCase
    law: Adhesion

    @cached_property
    def _steps(self) -> np.ndarray:
        return steps_of_rows(self.case)

    @cached_property
    def times(self) -> np.ndarray:
        """Of the rows [s]: whole steps where steps are fixed."""
        method = self.case.method
        if method.dt_s is None:
            return np.linspace(0.0, method.duration_s, method.n_rows + 1)
        return self._steps * method.dt_s

    @cached_property
    def _stretch(self) -> np.ndarray:
        """Of every cell (g,)."""
        return np.repeat(np.array(self.case.substrate.stretch), self.case.n_cells)

    @cached_property
    def _k_off(self) -> np.ndarray:
        return np.asarray(anchored(self.law, self._stretch).k_off)

    def start(self) -> np.ndarray:
        """The first bonds of every cell are closed, as many as come nearest to the fraction asked for."""
        n = self.case.method.n_integrins or 0
        first = np.arange(n) < round(self.case.method.start_bound_fraction * n)
        return np.tile(first.astype(np.uint8), (len(self._stretch), 1))

    def onward(self, bound: np.ndarray, row: int) -> np.ndarray:
        """Bonds at the next row."""
        return self._by_steps(bound, row) if self.case.method.dt_s is not None else self._exactly(bound, row)

    def told(self, bound: np.ndarray, row: int) -> Bonds:
        """Mean and standard deviation over the cells of a stretch."""
        each = bound.mean(axis=1).reshape(-1, self.case.n_cells)
        force = anchored(self.law, np.array(self.case.substrate.stretch), self.times[row]).force
        return Bonds(each.mean(axis=1), each.std(axis=1, ddof=1), np.asarray(force))

    def events(self) -> np.ndarray:
        """Estimate of the events, taken or not, of one bond on each stretch (s,) at exact times [1]."""
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
        """P_on and P_off of some steps (steps, g), at the middle of each where the substrate yields."""
        dt = self.case.method.dt_s or 0.0
        if is_viscoelastic(self.case.substrate):
            middle = (np.arange(start, end)[:, None] + 0.5) * dt
            k_off = _rates(self.law, *np.broadcast_arrays(self._stretch, middle))
        else:
            k_off = np.broadcast_to(self._k_off, (end - start, len(self._stretch)))
        on, off = self.law.chances(dt, k_off)
        return np.asarray(on), np.asarray(off)

    def _exactly(self, bound: np.ndarray, row: int) -> np.ndarray:
        times = self.times[row - 1], self.times[row]
        k_on = np.broadcast_to(np.asarray(self.law.bond.k_on, float), self._stretch.shape)
        if not is_viscoelastic(self.case.substrate):
            return exact(bound, times, k_on, self._k_off, None, self.case.seed, row)
        most = np.asarray(self.law.most_k_off(self._stretch, *times))

        def k_off(time: np.ndarray, cell: np.ndarray) -> np.ndarray:
            return _rates(self.law, self._stretch[cell], time)

        return exact(bound, times, k_on, most, k_off, self.case.seed, row)


@dataclass(frozen=True)
class Clutched:
    """Motors and clutches, in fixed steps: an array (s * cells, 2 n + 2) of closed or not, far ends, ground and dashpot."""

    case: AdhesionCase
    law: Adhesion
    clutch: MotorClutch

    @cached_property
    def _steps(self) -> np.ndarray:
        return steps_of_rows(self.case)

    @cached_property
    def times(self) -> np.ndarray:
        """Of the rows [s]: whole steps."""
        return self._steps * self.case.method.dt_s

    @cached_property
    def _ground(self) -> Ground:
        return ground_under(self.law, np.repeat(np.array(self.case.substrate.stretch), self.case.n_cells))

    def start(self) -> np.ndarray:
        """The first clutches of every cell closed, as many as come nearest to the fraction asked for."""
        n, cells = self.case.method.n_integrins or 0, self.case.n_cells * len(self.case.substrate.stretch)
        return _packed(self.clutch.start(cells, n, round(self.case.method.start_bound_fraction * n)))

    def onward(self, bound: np.ndarray, row: int) -> np.ndarray:
        """Clutches at the next row."""
        now = _unpacked(bound)
        for step in range(self._steps[row - 1], self._steps[row]):
            now = self.clutch.advance(self._ground, now, self.case.method.dt_s or 0.0, self.case.seed, step)
        return _packed(now)

    def told(self, bound: np.ndarray, row: int) -> Bonds:
        """Mean and standard deviation over the cells of a stretch; the force is shared by the closed ones."""
        now = _unpacked(bound)
        each = now.bound.mean(axis=1).reshape(-1, self.case.n_cells)
        force = self.clutch.force(self._ground, now).reshape(each.shape)
        closed = each.sum(axis=1) * now.bound.shape[1]
        flow = self.clutch.flow(self._ground, now).reshape(each.shape).mean(axis=1)
        others = {"cell_force_pN": force.mean(axis=1), "flow_um_per_s": flow}
        return Bonds(each.mean(axis=1), each.std(axis=1, ddof=1), force.sum(axis=1) / np.maximum(closed, 1.0), others)


def _packed(now: Clutches) -> np.ndarray:
    return np.hstack([now.bound, now.end, now.ground[:, None], now.flowed[:, None]])


def _unpacked(state: np.ndarray) -> Clutches:
    n = state.shape[1] // 2 - 1
    return Clutches(state[:, :n] > 0.5, state[:, n : 2 * n], state[:, -2], state[:, -1])


def steps_of_rows(case: AdhesionCase) -> np.ndarray:
    """Number of the last fixed step before each row."""
    method = case.method
    n = round(method.duration_s / (method.dt_s or method.duration_s / method.n_rows))
    return np.round(np.linspace(0, n, min(method.n_rows, n) + 1)).astype(int)


def _rates(law: Adhesion, stretch: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Rate of opening at points of any number (...) [1/s]: filled up to a power of two, so that few shapes are compiled."""
    n = stretch.size
    room = 1 << max(n - 1, 2**15 - 1).bit_length()
    padded = [np.concatenate([values.ravel(), np.ones(room - n)]) for values in (stretch, time)]
    return np.asarray(anchored(law, *padded).k_off)[:n].reshape(stretch.shape)


def _still(law: Adhesion, stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k_off = np.asarray(anchored(law, stretch).k_off)
    return k_off, k_off


def _ends(law: Adhesion, stretch: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lesser rate of opening at either end of intervals, and its upper bound in them: (n, 1) [s] -> (n, s) [1/s] each."""
    least = jnp.minimum(anchored(law, stretch, start).k_off, anchored(law, stretch, end).k_off)
    return np.asarray(least), np.asarray(law.most_k_off(stretch, start, end))


Follower = MeanField | Sampled | Clutched  # leads an array from row to row: start, onward, told, times


def follower_of(case: AdhesionCase, law: Adhesion) -> Follower:
    """Choose what follows the bonds of a case."""
    clutch = clutch_of(case)
    if clutch is not None:
        return Clutched(case, law, clutch)
    if case.method.type == "ode":
        return MeanField(case, law)
    sampled = Sampled(case, law)
    if case.method.type == "ssa":
        _refuse_too_many(sampled)
    return sampled


def _refuse_too_many(sampled: Sampled) -> None:
    """Refuse exact times that would take for ever."""
    each = sampled.events()
    total = each.sum() * sampled.case.n_cells * (sampled.case.method.n_integrins or 0)
    if not (each.max() <= MOST_EVENTS_EACH and total <= MOST_EVENTS):
        raise InputError(
            f'method.type = "ssa" would take about {each.max():.2g} events of each bond and {total:.2g} of all, beyond '
            f"{MOST_EVENTS_EACH:g} and {MOST_EVENTS:g}; give less duration_s or force, or more n_rows if the substrate yields"
        )
