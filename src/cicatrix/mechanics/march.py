"""A body of tissue with history, led through time: viscous, growing, or of constituents that are replaced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from ..core.errors import ConvergenceError
from ..materials.cohorts import used_up
from ..materials.material import State
from ..materials.stepped import Stepped
from ..numerics.compiler import COMPILER
from ..numerics.newton import NewtonReport
from .body import Body
from .equilibrium import Equilibrium


class Load(NamedTuple):
    """What acts on a body at an instant."""

    time: float
    """[s]."""
    gravity: np.ndarray
    """(3,) [mm/s^2]."""
    share: float = 1.0
    """Of the body's pressure [1]."""
    held_at: np.ndarray | None = None
    """Where nodes are held (n_nodes, 3) [mm]; left out, where they were."""


@dataclass(frozen=True, eq=False)
class Moment:
    """Where a body stands: all that the next step depends on besides the solver."""

    time: float
    x: np.ndarray
    """Positions (n_nodes, 3) [mm]."""
    state: State
    """History of the law at quadrature points, leading shape (n_elements, n_qp)."""
    heat: float = 0.0
    """Work turned into heat since the start [uJ]; of a section per depth [mN]."""
    report: NewtonReport | None = None


def virgin(body: Body, X: np.ndarray, time: float = 0.0) -> Moment:
    """The body before its first load: X (n_nodes, 3) [mm], time [s]."""
    return Moment(time, X, jax.tree.map(np.asarray, body.law.initial_state(body.density.shape)))


def march(body: Body, X: np.ndarray, loads: Iterable[Load], start: Moment, solver: Equilibrium) -> Iterator[Moment]:
    """Lead a body through loads, in equilibrium at every instant; the law's history goes on implicitly with its shape.

    Parameters
    ----------
    body : Body
        Its law may have any history. Accepting a step means keeping what is yielded; it is new arrays.
    X : (n_nodes, 3) array [mm]
        Reference positions.
    loads : iterable of Load
        In the order of time; a load at the time of ``start`` acts without time passing.
    start : Moment
        From :func:`virgin`, or one that was yielded before: the same moments follow from it.
    solver : Equilibrium
        Keeps its factors from step to step, where the law's steps have a potential.

    Raises
    ------
    ConvergenceError
        Where a step finds no equilibrium; the moment before it was yielded.
    """
    now = start
    for load in loads:
        now = _step(body, X, now, load, solver)
        yield now


def stepped(body: Body, moment: Moment, load: Load) -> Body:
    """The body during the step from a moment to a load."""
    law = Stepped(body.law, moment.state, np.asarray(load.time - moment.time))
    return replace(body.under(load.share), law=law)


def _step(body: Body, X: np.ndarray, now: Moment, load: Load, solver: Equilibrium) -> Moment:
    places = used_up(now.state, 1)
    if places:
        raise ConvergenceError(
            f"law[..].form.cohorts = {places} of the exact form is used up: give it one place for each step asked and two "
            'more, or use form.type = "recursive".'
        )
    during = stepped(body, now, load)
    start = None if now.report is None else now.x
    if not body.has_potential:
        solver.forget()  # an indefinite factor made again is not the same to the bit
    x, report = solver.loaded(during, X, load.gravity, start, load.held_at)
    F = during.law_gradient(X, x)
    after, lost = (jax.tree.map(np.asarray, part) for part in _advanced(during.law, F))
    heat = body.frame.total(float(np.sum(lost * body.volumes(X) * body.fraction[:, None])))
    return Moment(load.time, x, after, now.heat + heat, report)


@partial(jax.jit, compiler_options=COMPILER)
def _advanced(law: Stepped, F):
    after = law.after(F)
    return after, law.law.dissipated(F, law.before, after, law.dt)
