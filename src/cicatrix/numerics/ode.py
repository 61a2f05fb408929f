"""Solution of initial value problems of ordinary differential equations, stiff or not, by the package diffrax."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import diffrax
import jax.numpy as jnp
import optimistix
from jax import Array

from ..core.precision import use_double_precision

Method = Literal["implicit", "explicit"]
CHORD = diffrax.with_stepsize_controller_tols(optimistix.Chord)()
"""Newton's method with one Jacobian per stage: diffrax's own variant takes updates of the size of rounding for divergence."""
SOLVERS: dict[str, Callable[[], diffrax.AbstractSolver]] = {
    "implicit": lambda: diffrax.Kvaerno5(root_finder=CHORD),
    "explicit": diffrax.Tsit5,
}
Rate = Callable[[Any, Array, Array], Array]
"""Right-hand side of the equation: (parameters, y, time) -> dy/dt, with the shape of y."""

use_double_precision()


class Accuracy(NamedTuple):
    """Tolerances, method and maximum number of steps of a time integration."""

    relative: float = 1e-6
    absolute: float | Array = 1e-9
    """A number, or one for every entry of the state's last axis."""
    method: Method = "implicit"
    max_steps: int = 100_000


class Solution(NamedTuple):
    """Result of a time integration."""

    y: Array
    """State at the requested times (n_times, ...); infinite at times that were not reached."""
    n_steps: Array
    """Number of steps, including rejected ones."""
    is_done: Array
    """True if the last time was reached."""
    reached: Array
    """Last time that was reached; it may lie between two requested times."""
    last: Array
    """State at the time ``reached`` (...)."""
    out_of_steps: Array
    """True if the maximum number of steps was reached."""


def integrate_ode(rate: Rate, parameters: Any, start: Array, times: Array, accuracy: Accuracy) -> Solution:
    """Integrate y' = rate from ``start`` at the first of ``times`` (n_times,) [s] to the last; times may repeat.

    "implicit" is Kvaerno's singly diagonally implicit Runge-Kutta method of order 5, for stiff systems (Kvaerno, BIT 44:489,
    2004); "explicit" is the Runge-Kutta method of Tsitouras
    (2011). Both adapt the step length. A state may have any shape, and all its entries
    share the steps, so many parameter sets can be integrated in one explicit call. The result has reverse-mode derivatives,
    which do not include the choice of steps.
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
    out_of_steps = solution.result == diffrax.RESULTS.max_steps_reached
    return Solution(y, solution.stats["num_steps"], is_done, reached, last, out_of_steps)


def _largest(error: Array) -> Array:
    """Return the norm of the error estimate: root mean square over the last axis, maximum over all other axes."""
    return jnp.sqrt(jnp.max(jnp.mean(jnp.square(jnp.abs(error)), axis=-1)))
