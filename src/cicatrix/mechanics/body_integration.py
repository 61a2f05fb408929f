"""Time integration of a body whose law has history variables: viscous, growing, or with constituents that turn over."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from ..core.errors import ConvergenceError
from ..materials.cohorts import exceeded_slots
from ..materials.incremental import IncrementalMaterial
from ..materials.material import State
from ..numerics.compiler import COMPILER
from ..numerics.host import own_exceptions
from ..numerics.newton import NewtonReport
from .body import Body
from .equilibrium import Equilibrium


class Load(NamedTuple):
    """Gravity, pressure and support positions of a body at the end of a time step."""

    time: float
    """Time [s]."""
    gravity: np.ndarray
    """Acceleration (3,) [mm/s^2]."""
    share: float = 1.0
    """Fraction of the body's pressure [1]."""
    prescribed_positions: np.ndarray | None = None
    """Prescribed positions of constrained nodes (n_nodes, 3) [mm]; by default these nodes stay in place."""


@dataclass(frozen=True, eq=False)
class BodyState:
    """State of a body at an instant, from which the next time step starts."""

    time: float
    """Time [s]."""
    x: np.ndarray
    """Positions (n_nodes, 3) [mm]."""
    state: State
    """History variables of the law at quadrature points, arrays (n_elements, n_qp, ...)."""
    heat: float = 0.0
    """Energy dissipated since the start [uJ]; per depth for a section [mN]."""
    report: NewtonReport | None = None
    """Record of the solve for equilibrium; None in the initial state."""


def initial_state(body: Body, X: np.ndarray, time: float = 0.0) -> BodyState:
    """Return the initial state of a body, before its first load: X (n_nodes, 3) [mm], time [s]."""
    return BodyState(time, X, jax.tree.map(np.asarray, body.law.initial_state(body.density.shape)))


def integrate(
    body: Body, X: np.ndarray, loads: Iterable[Load], start: BodyState, solver: Equilibrium
) -> Iterator[BodyState]:
    """Integrate a body in time: solve equilibrium at each load, with implicit update of the law's history.

    Parameters
    ----------
    body : Body
        Body; its law may have a history. Each step returns new arrays, so earlier states remain valid.
    X : (n_nodes, 3) array [mm]
        Reference positions.
    loads : iterable of Load
        Loads in order of time; a load at the time of ``start`` is applied as a step of zero duration.
    start : BodyState
        State from :func:`initial_state`, or one yielded earlier, from which the run continues identically.
    solver : Equilibrium
        Equilibrium solver; it reuses factorised matrices from step to step if the forces have a potential.

    Raises
    ------
    ConvergenceError
        If no equilibrium is found in a step; the state before that step has already been yielded.
    """
    now = start
    for load in loads:
        now = _step(body, X, now, load, solver)
        yield now


def incremental_body(body: Body, before: BodyState, load: Load) -> Body:
    """Return a body without history whose equilibrium is that at the end of a time step from the state ``before``.

    Its law includes the implicit update of the history, and its pressure is that of the load.
    """
    law = IncrementalMaterial(body.law, before.state, np.asarray(load.time - before.time))
    return replace(body.with_pressure_share(load.share), law=law)


def _step(body: Body, X: np.ndarray, now: BodyState, load: Load, solver: Equilibrium) -> BodyState:
    n_slots = exceeded_slots(now.state, 1)
    if n_slots:
        raise ConvergenceError(
            f"law[..].form.cohorts = {n_slots} is too small for the exact form: set it to the number of steps plus two, "
            'or use form.type = "recursive".'
        )
    during = incremental_body(body, now, load)
    start = None if now.report is None else now.x
    if not body.has_potential:
        solver.reset()  # an indefinite factorisation is not bitwise reproducible after a restart
    x, report = solver.loaded(during, X, load.gravity, start, load.prescribed_positions)
    F = during.law_gradient(X, x)
    with own_exceptions():
        after, lost = (jax.tree.map(np.asarray, part) for part in _advanced(during.law, F))
    heat = body.discretization.total(float(np.sum(lost * body.volumes(X) * body.fraction[:, None])))
    return BodyState(load.time, x, after, now.heat + heat, report)


@partial(jax.jit, compiler_options=COMPILER)
def _advanced(law: IncrementalMaterial, F):
    after = law.after(F)
    return after, law.law.dissipated(F, law.before, after, law.dt)
