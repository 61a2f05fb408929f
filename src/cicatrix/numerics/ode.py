"""Initial value problems of many unknowns, stiff or not: diffrax, with what it says made plain."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jax import Array

Method = Literal["implicit", "explicit"]
SOLVERS: dict[str, Callable[[], diffrax.AbstractSolver]] = {"implicit": diffrax.Kvaerno5, "explicit": diffrax.Tsit5}
Rate = Callable[[Any, Array, Array], Array]
"""(parameters, y, time) -> dy/dt, of the shape of y."""

jax.config.update("jax_enable_x64", True)


class Accuracy(NamedTuple):
    """How exactly, and with what."""

    relative: float = 1e-6
    absolute: float = 1e-9
    method: Method = "implicit"
    max_steps: int = 100_000


class Course(NamedTuple):
    """What became of a state."""

    y: Array
    """At the times asked for (n_times, ...); what was not reached is infinite."""
    n_steps: Array
    is_done: Array
    """Whether the last time was reached."""
    reached: Array
    """The last time that was reached, asked for or not."""
    last: Array
    """The state there (...)."""
    is_spent: Array
    """Whether all steps were taken."""


def course(rate: Rate, parameters: Any, start: Array, times: Array, accuracy: Accuracy) -> Course:
    """Follow y' = rate from ``start`` at the first of ``times`` (n_times,) [s] to the last, which may be repeated.

    "implicit" is Kvaerno's singly diagonal implicit method of order 5, for stiff systems (Kvaerno, BIT 44:489, 2004), "explicit"
    that of Tsitouras (2011); both adapt their steps. A state may have any shape, and all of it then shares the steps: the way to
    follow many sets of parameters in one call explicitly. Reverse derivatives go through; the choice of steps is not followed.
    """
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, p: rate(p, y, t)),
        SOLVERS[accuracy.method](),
        t0=times[0],
        t1=times[-1],
        dt0=None,
        y0=start,
        args=parameters,
        saveat=diffrax.SaveAt(subs=[diffrax.SubSaveAt(ts=times), diffrax.SubSaveAt(t1=True)]),
        stepsize_controller=diffrax.PIDController(rtol=accuracy.relative, atol=accuracy.absolute, norm=_largest),
        max_steps=accuracy.max_steps,
        throw=False,
    )
    (y, (last,)), (_, (reached,)) = solution.ys, solution.ts  # pyright: ignore[reportGeneralTypeIssues]
    is_done = (solution.result == diffrax.RESULTS.successful) & jnp.all(jnp.isfinite(y))
    is_spent = solution.result == diffrax.RESULTS.max_steps_reached
    return Course(y, solution.stats["num_steps"], is_done, reached, last, is_spent)


def _largest(error: Array) -> Array:
    """Root of the mean square over the last axis, the largest of all sets."""
    return jnp.sqrt(jnp.max(jnp.mean(jnp.square(jnp.abs(error)), axis=-1)))
