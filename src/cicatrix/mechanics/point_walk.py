"""A point led through a loading in steps that adapt; what it was led by can be gone through again with derivatives."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import ConvergenceError
from ..core.units import hours_from_seconds
from ..materials.cohorts import used_up
from ..materials.material import EnergyMaterial
from ..numerics.compiler import COMPILER
from .point import Control, Instant, Point, control, step, virgin

PARTS = 4096  # of an asked step: the smallest one that is tried
QUIET = 0.125  # share of the bound below which a step of twice the size is tried: its error is four times as large
SMALLEST_STRAIN = 0.01  # stresses below so much of the first shear modulus are not resolved relative to themselves
SMALL_SHEAR = 1e-3
TOLERANCE = 1e-4
NO_STIFFNESS = 1e-9  # kPa: less is none


@dataclass(frozen=True)
class Mark:
    """Where a walk stands after an asked instant; enough to go on to the bit."""

    point: Point
    row: int
    """Number of the asked instant."""
    size: int = PARTS
    """The next step to try, in parts of an asked one."""
    largest: float = 0.0
    """The scale of stress so far [kPa]."""
    n_substeps: int = 0
    """Steps done for this row."""
    n_coarse: int = 0
    """Of these, steps of the smallest size whose error was above the bound all the same."""
    path: tuple[Instant, ...] = ()
    """The instants of these steps."""


class Walked(NamedTuple):
    """A whole walk."""

    points: Point
    """At the asked instants (n, ...)."""
    path: Instant
    """Every instant that was gone through (m, ...): ``point.history`` along it has derivatives."""
    rows: np.ndarray
    """Where the asked instants are in the path (n,)."""


def instants(
    time: Sequence[float], value: np.ndarray, shear: Sequence[float], steps_per_segment: int = 50, repeat: int = 1
) -> Instant:
    """Lay a piecewise linear loading out in equal steps per segment.

    Parameters
    ----------
    time : (n,) sequence [s]
        Corners, ascending.
    value : (n, 3) array
        Stretch [1] or Cauchy stress [kPa] of x, y, z at the corners.
    shear : (n,) sequence [1]
        F_xy at the corners.
    steps_per_segment : int
        Steps between two corners.
    repeat : int
        How often the loading is gone through; each time starts where the last one ended.
    """
    n = len(time) - 1
    corners = np.arange(n * steps_per_segment + 1) / steps_per_segment
    columns = np.column_stack([time, value, shear])
    once = np.column_stack([np.interp(corners, np.arange(n + 1), column) for column in columns.T])
    rounds = [once[:1]]
    for k in range(repeat):
        later = once[1:].copy()
        later[:, 0] += k * (once[-1, 0] - once[0, 0])
        rounds.append(later)
    whole = np.vstack(rounds)
    return Instant(whole[:, 0], whole[:, 1:4], whole[:, 4])


def walk(
    law: EnergyMaterial, by: Control, asked: Instant, tolerance: float = TOLERANCE, mark: Mark | None = None
) -> Iterator[Mark]:
    r"""Lead a point through the asked instants; yields where it stands after each.

    A step is done whole and in halves, and kept in halves where both agree; else it is halved. For a decaying exponential of
    backward Euler steps, z = dt / tau, they differ by z^2 / 4 and the halves are off by z / (4 e) at most, which bounds the
    difference by (2 e tolerance)^2. A law without history takes each step whole.

    Parameters
    ----------
    law : EnergyMaterial
    by : Control
        What is prescribed.
    asked : Instant
        Stacked (n, ...), such as :func:`instants` gives.
    tolerance : float
        Of stretches [1], growth [1], and stresses relative to the largest so far.
    mark : Mark, optional
        Where to go on.

    Raises
    ------
    ConvergenceError
        Where there is no solution within the smallest step: what was asked when, and what was last reached.
    """
    strider = _Strider(law, by, math.exp(2.0) * 4.0 * tolerance**2, len(asked.time) - 1)
    if mark is None:
        first = _row(asked, 0)
        origin = virgin(law, first)
        rest = Instant(first.time, np.where(by.by_stress, 0.0, origin.stretch), np.float64(0.0))
        mark = strider.cross(Mark(origin, -1, largest=_modulus(law, origin) * SMALLEST_STRAIN), rest, first)
        yield mark
    for row in range(mark.row, len(asked.time) - 1):
        mark = strider.cross(mark, _row(asked, row), _row(asked, row + 1))
        yield mark


def lead(law: EnergyMaterial, by: Control, asked: Instant, tolerance: float = TOLERANCE) -> Walked:
    """Walk to the end; arguments and errors as those of :func:`walk`."""
    marks = list(walk(law, by, asked, tolerance))
    path = [instant for mark in marks for instant in mark.path]
    rows = np.cumsum([len(mark.path) for mark in marks]) - 1
    return Walked(_stacked([mark.point for mark in marks]), _stacked(path), rows)


@dataclass(frozen=True)
class _Strider:
    """Crosses the interval between two asked instants."""

    law: EnergyMaterial
    by: Control
    bound: float
    n_asked: int

    def cross(self, mark: Mark, start: Instant, end: Instant) -> Mark:
        point, at, size, largest = mark.point, 0, mark.size, mark.largest
        path: list[Instant] = []
        n_coarse = 0
        while at < PARTS:
            trial, trodden, error = self._stride(point, start, end, at, size, largest)
            failed = not np.isfinite(error)
            places = used_up(trial.state) if failed else 0
            if places:
                raise _forgetful(places, max(mark.row, 0), self.n_asked)
            if failed and size == 1:
                raise _stopped(self.law, self.by, point, _between(start, end, at + 1))
            if error > self.bound and size > 1:
                size //= 2
                continue
            point, at = trial, at + size
            path += trodden
            n_coarse += bool(error > self.bound)
            largest = max(largest, float(np.abs(point.stress).max()))
            if error < QUIET * self.bound and size < PARTS and at % (2 * size) == 0:
                size *= 2
        return Mark(point, mark.row + 1, size, largest, len(path), n_coarse, tuple(path))

    def _stride(
        self, point: Point, start: Instant, end: Instant, at: int, size: int, largest: float
    ) -> tuple[Point, list[Instant], float]:
        """Go by so many parts: where to, through which instants, and the error, infinite where there is no solution."""
        middle, target = _between(start, end, at + 0.5 * size), _between(start, end, at + size)
        whole, both, whole_found, both_found, error = _tried(self.law, self.by, point, middle, target, largest)
        if end.time == start.time or not jax.tree.leaves(point.state):
            return whole, [target], 0.0 if whole_found else np.inf
        return both, [middle, target], float(error) if both_found else np.inf


@partial(jax.jit, compiler_options=COMPILER)
def _tried(law: EnergyMaterial, by: Control, before: Point, middle: Instant, target: Instant, largest: Array):
    """A step done whole and in halves, in one loop so that the law is compiled once.

    Returns where the whole one and the halves lead, whether each was found, and how far they differ [1], stresses relative
    to the largest.
    """

    def one(previous: Point, item: tuple[Instant, Array]) -> tuple[Point, Point]:
        asked, goes_on = item
        start = jax.tree.map(lambda new, old: jnp.where(goes_on, new, old), previous, before)
        after = step(law, by, start, asked)
        return after, after

    asked = jax.tree.map(lambda a, b: jnp.stack([b, a, b]), middle, target)
    done = jax.lax.scan(one, before, (asked, jnp.array([False, False, True])))[1]
    whole, both = _row(done, 0), _row(done, 2)
    return whole, both, whole.converged, jnp.all(done.converged), _difference(whole, both, largest)


def _between(start: Instant, end: Instant, parts: float) -> Instant:
    if parts == PARTS:
        return end
    return jax.tree.map(lambda a, b: a + (b - a) * (parts / PARTS), start, end)


def _difference(a: Point, b: Point, largest: Array) -> Array:
    scale = jnp.maximum(largest, jnp.max(jnp.abs(b.stress)))
    stresses = (a.stress - b.stress) / jnp.where(scale > 0.0, scale, 1.0)
    parts = (a.stretch - b.stretch, a.growth - b.growth, stresses)
    return jnp.max(jnp.stack([jnp.max(jnp.abs(part)) for part in parts]))


def _modulus(law: EnergyMaterial, origin: Point) -> float:
    """Shear modulus of the virgin law [kPa], by a small shear at the stretches that it starts from."""
    small = Instant(np.asarray(origin.time), np.asarray(origin.stretch), np.float64(SMALL_SHEAR))
    sheared = _tried(law, control(z="stretch", incompressible=False), origin, small, small, 0.0)[0]
    return float(np.nan_to_num(np.abs(sheared.stress[0, 1]) / SMALL_SHEAR))


def _forgetful(places: int, n_done: int, n_asked: int) -> ConvergenceError:
    return ConvergenceError(
        f"law[..].form.cohorts = {places} of the exact form is used up after {n_done} of the {n_asked} steps asked: give "
        f'{2 * n_asked + 2} at least, and more where steps are halved, or form.type = "recursive".'
    )


def _stopped(law: EnergyMaterial, by: Control, last: Point, asked: Instant) -> ConvergenceError:
    names = [("sigma" if stress else "lambda") + f"_{axis}" for stress, axis in zip(by.by_stress, "xyz")]
    units = [" kPa" if stress else "" for stress in by.by_stress]
    wanted = ", ".join(f"{n} = {v:.4g}{u}" for n, v, u in zip(names, asked.value, units))
    if asked.shear:
        wanted += f", shear = {asked.shear:.4g}"
    stretches = ", ".join(f"{v:.4g}" for v in last.stretch)
    stresses = ", ".join(f"{v:.4g}" for v in jnp.diagonal(last.stress))
    when, before = (f"{hours_from_seconds(float(time)):.6g} h" for time in (asked.time, last.time))
    return ConvergenceError(
        f"No state of the law was found at {when} with {wanted}; last reached, at {before}: stretches {stretches}, "
        f"stresses {stresses} kPa along x, y, z. {_advice(law, by)}"
    )


def _advice(law: EnergyMaterial, by: Control) -> str:
    soft = soft_axes(law, by)
    if soft:
        return f"The law has no stiffness at rest along {', '.join(soft)}: add a part that has, such as neo-hookean."
    return "Ask for less load, or give a law that carries it."


def soft_axes(law: EnergyMaterial, by: Control) -> str:
    """Axes of x, y, z whose stretches are free to change together at no cost where the law is at rest."""
    free, volume = np.diag(~np.asarray(by.by_stress)).astype(float), np.full((1, 3), float(by.incompressible))
    _, sizes, rows = np.linalg.svd(np.vstack([free, volume]))
    allowed = rows[sizes < NO_STIFFNESS]
    stiffness, ways = np.linalg.eigh(allowed @ np.asarray(_stiffness_at_rest(law)) @ allowed.T)
    soft = ways[:, np.abs(stiffness) < NO_STIFFNESS].T @ allowed
    return "".join(axis for axis, parts in zip("xyz", soft.T) if np.any(np.abs(parts) > SMALL_SHEAR))


@partial(jax.jit, compiler_options=COMPILER)
def _stiffness_at_rest(law: EnergyMaterial) -> Array:
    """Second derivatives of the virgin law's energy by the stretches along x, y, z (3, 3) [kPa]."""
    state = law.initial_state(())
    _, along = jax.linearize(
        lambda F: jnp.diagonal(law.stress(F, state)), jnp.cbrt(law.volume_at_rest(state)) * jnp.eye(3)
    )
    return jax.vmap(lambda stretch: along(jnp.diag(stretch)))(jnp.eye(3))


def _row(stacked: Any, row: int) -> Any:
    return jax.tree.map(lambda column: column[row], stacked)


def _stacked(items: Sequence) -> Array:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *items)
