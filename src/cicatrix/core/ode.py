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
"""(parameters, y (n,), time) -> dy/dt (n,)."""

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
    """At the times asked for (n_times, n); what was not reached is infinite."""
    n_steps: Array
    is_done: Array
    """Whether the last time was reached."""


def course(
    rate: Rate, parameters: Any, start: Array, times: Array, accuracy: Accuracy, is_forward: bool = False
) -> Course:
    """Follow y' = rate from ``start`` (n,) at the first of ``times`` (n_times,) [s] to the last, which may be repeated.

    "implicit" is Kvaerno's singly diagonal implicit method of order 5, for stiff systems, "explicit" that of Tsitouras; both
    adapt their steps. ``jax.vmap`` follows many at once; reverse derivatives work as they are, forward ones with ``is_forward``.
    """
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, p: rate(p, y, t)),
        SOLVERS[accuracy.method](),
        t0=times[0],
        t1=times[-1],
        dt0=None,
        y0=start,
        args=parameters,
        saveat=diffrax.SaveAt(ts=times),
        stepsize_controller=diffrax.PIDController(rtol=accuracy.relative, atol=accuracy.absolute),
        adjoint=diffrax.ForwardMode() if is_forward else diffrax.RecursiveCheckpointAdjoint(),
        max_steps=accuracy.max_steps,
        throw=False,
    )
    is_done = (solution.result == diffrax.RESULTS.successful) & jnp.all(jnp.isfinite(solution.ys))
    return Course(solution.ys, solution.stats["num_steps"], is_done)


def settled(rate: Rate, parameters: Any, start: Array, longest: float, accuracy: Accuracy, slowest: float) -> Course:
    """Follow y' = rate from ``start`` (n,) for ``longest`` [s], or until nothing moves beyond accuracy within ``slowest`` [s].

    Returns the end alone, ``y`` (n,); ``is_done`` says whether it stands still.
    """

    def is_still(t: Any, y: Array, args: Any, **_: Any) -> Array:
        return jnp.all(jnp.abs(rate(args, y, t)) * slowest < accuracy.absolute + accuracy.relative * jnp.abs(y))

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, p: rate(p, y, t)),
        SOLVERS[accuracy.method](),
        t0=0.0,
        t1=longest,
        dt0=None,
        y0=start,
        args=parameters,
        stepsize_controller=diffrax.PIDController(rtol=accuracy.relative, atol=accuracy.absolute),
        event=diffrax.Event(is_still),
        max_steps=accuracy.max_steps,
        throw=False,
    )
    y = solution.ys[-1]
    return Course(y, solution.stats["num_steps"], is_still(solution.ts[-1], y, parameters))
