"""Time integration of a material point through a loading with adaptive steps.

The accepted steps can be repeated by :func:`.point.history`, which is differentiable.
"""

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
from ..materials.cohorts import exceeded_slots
from ..materials.material import Material
from ..numerics.compiler import COMPILER
from ..numerics.host import own_exceptions
from .point import Control, Instant, Point, control, initial_state, step

PARTS = 4096  # ratio of the interval between requested instants to the smallest step
DOUBLING_FRACTION = 0.125  # fraction of the error bound below which the step is doubled (its error quadruples)
SMALLEST_STRAIN = 0.01  # stresses below this times the initial shear modulus have an absolute error bound
SMALL_SHEAR = 1e-3  # shear at which the initial shear modulus is measured
TOLERANCE = 1e-4
NO_STIFFNESS = 1e-9  # stiffness that counts as zero [kPa]


@dataclass(frozen=True)
class PointProgress:
    """State of a time integration at a requested instant: a checkpoint from which it continues bitwise identically."""

    point: Point
    """State of the material point."""
    row: int
    """Index of the requested instant."""
    size: int = PARTS
    """Next step to try, in units of 1 / PARTS of the interval between requested instants."""
    largest: float = 0.0
    """Largest stress so far, the scale of the stress error [kPa]."""
    n_substeps: int = 0
    """Number of steps taken to reach this instant."""
    n_coarse: int = 0
    """Number of these steps that had the smallest size and still exceeded the error bound."""
    path: tuple[Instant, ...] = ()
    """Instants at the ends of these steps."""


class PointHistory(NamedTuple):
    """States of a material point at all requested instants, and the steps between them."""

    points: Point
    """States at the requested instants (n, ...)."""
    path: Instant
    """Instants at the ends of all steps (m, ...), for a differentiable repetition by ``point.history``."""
    rows: np.ndarray
    """Indices of the requested instants in ``path`` (n,)."""


def instants(
    time: Sequence[float], value: np.ndarray, shear: Sequence[float], steps_per_segment: int = 50, repeat: int = 1
) -> Instant:
    """Return the instants of a piecewise linear loading, with equal steps in each segment.

    Parameters
    ----------
    time : (n,) sequence [s]
        Times of the corners of the loading, ascending.
    value : (n, 3) array
        Stretch [1] or Cauchy stress [kPa] along x, y, z at the corners.
    shear : (n,) sequence [1]
        F_xy at the corners.
    steps_per_segment : int
        Number of steps between two corners.
    repeat : int
        Number of times the loading is applied; each repetition starts at the end of the previous one.
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


def integrate(
    law: Material, by: Control, asked: Instant, tolerance: float = TOLERANCE, progress: PointProgress | None = None
) -> Iterator[PointProgress]:
    r"""Integrate a point through the requested instants with adaptive steps; yield the progress after each.

    Each step is computed once in full and once as two half steps. If both agree the half steps are accepted, otherwise the
    step is halved. For exponential decay by backward Euler steps, z = dt / tau, the two differ by z^2 / 4 and the accumulated
    error of the half steps is at most z / (4 e), so the difference is bounded by (2 e tolerance)^2. Without history, full
    steps are taken.

    Parameters
    ----------
    law : Material
        Law of the material.
    by : Control
        Prescribed quantities: stretch or stress per axis, and incompressibility.
    asked : Instant
        Requested instants, stacked (n, ...), as from :func:`instants`.
    tolerance : float
        Error bound for stretches [1], growth [1], and stresses relative to the largest so far [1].
    progress : PointProgress, optional
        Progress from which to continue.

    Raises
    ------
    ConvergenceError
        If there is no solution within the smallest step; the message gives the requested and the last computed state.
    """
    integrator = _IntervalIntegrator(law, by, math.exp(2.0) * 4.0 * tolerance**2, len(asked.time) - 1)
    if progress is None:
        first = _row(asked, 0)
        origin = initial_state(law, first)
        rest = Instant(first.time, np.where(by.by_stress, 0.0, origin.stretch), np.float64(0.0))
        progress = integrator.integrate(
            PointProgress(origin, -1, largest=_modulus(law, origin) * SMALLEST_STRAIN), rest, first
        )
        yield progress
    for row in range(progress.row, len(asked.time) - 1):
        progress = integrator.integrate(progress, _row(asked, row), _row(asked, row + 1))
        yield progress


def integrate_all(law: Material, by: Control, asked: Instant, tolerance: float = TOLERANCE) -> PointHistory:
    """Integrate a point through all requested instants; arguments and exceptions as for :func:`integrate`."""
    reached = list(integrate(law, by, asked, tolerance))
    path = [instant for progress in reached for instant in progress.path]
    rows = np.cumsum([len(progress.path) for progress in reached]) - 1
    return PointHistory(_stacked([progress.point for progress in reached]), _stacked(path), rows)


@dataclass(frozen=True)
class _IntervalIntegrator:
    """Integrator of a material point from one requested instant to the next, with an error bound for each step."""

    law: Material
    by: Control
    bound: float
    n_asked: int

    def integrate(self, progress: PointProgress, start: Instant, end: Instant) -> PointProgress:
        point, at, size, largest = progress.point, 0, progress.size, progress.largest
        path: list[Instant] = []
        n_coarse = 0
        while at < PARTS:
            trial, passed, error = self._try_step(point, start, end, at, size, largest)
            failed = not np.isfinite(error)
            n_slots = exceeded_slots(trial.state) if failed else 0
            if n_slots:
                raise _full_memory_error(n_slots, max(progress.row, 0), self.n_asked)
            if failed and size == 1:
                raise _no_solution_error(self.law, self.by, point, _between(start, end, at + 1))
            if error > self.bound and size > 1:
                size //= 2
                continue
            point, at = trial, at + size
            path += passed
            n_coarse += bool(error > self.bound)
            largest = max(largest, float(np.abs(point.stress).max()))
            if error < DOUBLING_FRACTION * self.bound and size < PARTS and at % (2 * size) == 0:
                size *= 2
        return PointProgress(point, progress.row + 1, size, largest, len(path), n_coarse, tuple(path))

    @own_exceptions()
    def _try_step(
        self, point: Point, start: Instant, end: Instant, at: int, size: int, largest: float
    ) -> tuple[Point, list[Instant], float]:
        """Try a step from ``at`` to ``at + size``, in 1 / PARTS of the interval from ``start`` to ``end``.

        Return the new state, the instants at the ends of its one or two steps, and the error (inf without convergence).
        """
        middle, target = _between(start, end, at + 0.5 * size), _between(start, end, at + size)
        whole, both, whole_found, both_found, error = _tried(self.law, self.by, point, middle, target, largest)
        if end.time == start.time or not jax.tree.leaves(point.state):
            return whole, [target], 0.0 if whole_found else np.inf
        return both, [middle, target], float(error) if both_found else np.inf


@partial(jax.jit, compiler_options=COMPILER)
def _tried(law: Material, by: Control, before: Point, middle: Instant, target: Instant, largest: Array):
    """Compute a full step and two half steps, in one loop so that the law is compiled once.

    Return both final states, whether each converged, and their difference [1], with stresses relative to the largest stress.
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


@own_exceptions()
def _modulus(law: Material, origin: Point) -> float:
    """Return the shear modulus of the law in its initial state [kPa], from a small shear at the initial stretches."""
    small = Instant(np.asarray(origin.time), np.asarray(origin.stretch), np.float64(SMALL_SHEAR))
    sheared = _tried(law, control(z="stretch", incompressible=False), origin, small, small, 0.0)[0]
    return float(np.nan_to_num(np.abs(sheared.stress[0, 1]) / SMALL_SHEAR))


def _full_memory_error(n_slots: int, n_done: int, n_asked: int) -> ConvergenceError:
    return ConvergenceError(
        f"law[..].form.cohorts = {n_slots} is too small for the exact form: it is full after {n_done} of {n_asked} steps; "
        f'set at least {2 * n_asked + 2}, more if steps are halved, or use form.type = "recursive".'
    )


def _no_solution_error(law: Material, by: Control, last: Point, asked: Instant) -> ConvergenceError:
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


def _advice(law: Material, by: Control) -> str:
    soft = soft_axes(law, by)
    if soft:
        return f"The law has no stiffness at rest along {', '.join(soft)}: add a part that has, such as neo-hookean."
    return "Reduce the load, or use a law that can carry it."


@own_exceptions()
def soft_axes(law: Material, by: Control) -> str:
    """Return the axes, such as "xz", along which a law at rest deforms without stiffness under given boundary conditions."""
    free, volume = np.diag(~np.asarray(by.by_stress)).astype(float), np.full((1, 3), float(by.incompressible))
    _, sizes, rows = np.linalg.svd(np.vstack([free, volume]))
    allowed = rows[sizes < NO_STIFFNESS]
    stiffness, directions = np.linalg.eigh(allowed @ np.asarray(_stiffness_at_rest(law)) @ allowed.T)
    soft = directions[:, np.abs(stiffness) < NO_STIFFNESS].T @ allowed
    return "".join(axis for axis, parts in zip("xyz", soft.T) if np.any(np.abs(parts) > SMALL_SHEAR))


@partial(jax.jit, compiler_options=COMPILER)
def _stiffness_at_rest(law: Material) -> Array:
    """Return the second derivatives of the energy with respect to the stretches, in the initial state (3, 3) [kPa]."""
    state = law.initial_state(())
    _, along = jax.linearize(
        lambda F: jnp.diagonal(law.stress(F, state)), jnp.cbrt(law.volume_at_rest(state)) * jnp.eye(3)
    )
    return jax.vmap(lambda stretch: along(jnp.diag(stretch)))(jnp.eye(3))


def _row(stacked: Any, row: int) -> Any:
    return jax.tree.map(lambda column: column[row], stacked)


def _stacked(items: Sequence) -> Array:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *items)
