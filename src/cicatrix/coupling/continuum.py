"""The healing cycle with fields in the automaton's seat: cells, cytokine, collagen and their pull on the patient's body."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..core.units import days_from_seconds, seconds_from_days
from ..geometry.transfer import linear_fit
from ..healing.automaton import AutomatonState
from ..healing.continuum import Course, Host, Tolerance, Wound, WoundState
from ..healing.scarring import Local, Scarring
from ..healing.transport import Mobility, Transport
from ..mechanics.body import Body
from .cycle import HealingCycle, TissueState

CLOSED = 0.5  # cells, of healthy tissue, from which a place counts as filled
FIRST_STEP_S = 3600.0


@dataclass(frozen=True, eq=False)
class Fresh:
    """What a wound holds at first; about it healthy tissue, all densities 1 and no cytokine."""

    rho: float
    """Cells [1]."""
    c: float
    """Cytokine [1]."""
    local: Local
    """Collagen, fibres and what cells sense at quadrature points (n_elements, n_qp), of the whole body."""


@dataclass(frozen=True, eq=False)
class FieldsCycle(HealingCycle):
    """Healing by fields in the order of :class:`HealingCycle`, its numbers by the same ruler.

    The cavity is filled from the start with the provisional matrix that cells crawl into; it bears and weighs by its collagen.
    Surrounding tissue keeps its law; there cells feel what has changed since before surgery. A site of the lattice counts as
    filled where cells have come to :data:`CLOSED` of healthy tissue: the lattice only measures.

    Parameters
    ----------
    scarring : Scarring
        What happens at a point.
    mobility : Mobility
        How cells and cytokine move.
    fresh : Fresh
        The wound at first.
    tolerance : Tolerance
        Of steps.
    is_coupled : bool
        Two-way: cells, fibres and contracture follow the body as it moves. One-way: they have the shape after surgery.
    last_visit : int
        Cycle up to which a closed wound is followed, for scars change shape long after.
    tell : callable, optional
        Hears the day reached.
    """

    scarring: Scarring
    mobility: Mobility
    fresh: Fresh
    tolerance: Tolerance
    is_coupled: bool
    last_visit: int
    tell: Callable[[str], None] | None = None
    closes: ClassVar[str] = f"when cells had come to {CLOSED:g} of healthy tissue everywhere"

    @cached_property
    def transport(self) -> Transport:
        """Cells and cytokine, on the whole body; nothing leaves it."""
        return Transport(self.intact.frame.space, self.X)

    @cached_property
    def beds(self) -> np.ndarray:
        """Carriers of the cavity, its border left out (n,) bool."""
        return self._touches(self.cavity) & ~self._touches(~self.cavity)

    def _touches(self, elements: np.ndarray) -> np.ndarray:
        touched = np.zeros(self.transport.n, bool)
        touched[self.transport.cells[elements]] = True
        return touched

    def start(self) -> TissueState:
        """The fresh wound: the cavity is opened, the body finds its shape, and the provisional matrix is laid into it."""
        emptied = super().start()
        before = self.felt_deformation(self.x_intact)
        born = self.deposition.natural(
            emptied.natural, np.zeros(self.cavity.shape), np.ones(self.cavity.shape), self.felt_deformation(emptied.x)
        )
        natural = np.where(self.cavity[:, None, None, None], born, before)
        return replace(self._settled(self._state_of(emptied.x, natural)), W_ref=emptied.W_ref)

    def _state_of(self, x: np.ndarray, natural: np.ndarray) -> TissueState:
        inside = 0.5 * self._touches(self.cavity) + 0.5 * self.beds  # at the border the mean of both sides
        rho, c = 1.0 - (1.0 - self.fresh.rho) * inside, self.fresh.c * inside
        at_first = WoundState(x, np.stack([rho, c], axis=-1), self.fresh.local)
        return self._seen(TissueState(0, self.automaton.initial_state(), np.ones(0), natural, x, 0), _course(at_first))

    def step(self, state: TissueState) -> TissueState:
        """Heal for the days of a cycle.

        Raises
        ------
        ConvergenceError
            If steps become too short, or no equilibrium is found.
        """
        assert state.course is not None
        solver, course, closure, iterations = self.solver(state), state.course, state.closure_days, 0
        for reached in solver.follow(course, seconds_from_days(self.days(state.cycle + 1))):
            if closure < 0.0:
                closure = self._closed_between(course, reached)
            course, iterations = reached, iterations + reached.iterations
            if self.tell is not None:
                self.tell(f"day {days_from_seconds(course.time):.1f}")
        new = self._seen(
            replace(state, cycle=state.cycle + 1, closure_days=closure, newton_iterations=iterations), course
        )
        return replace(new, x=course.now.x) if self.is_coupled else self._settled(new)

    def solver(self, state: TissueState) -> Wound:
        """What follows the fields from here: made anew in every cycle, so that a run that goes on has the same bits."""
        return Wound(
            *(self._weighing, self.X, self.gravity, self.scarring, self.mobility, self.transport),
            *(self.tolerance, self.is_coupled, Host(self.cavity, state.natural)),
        )

    @cached_property
    def _weighing(self) -> Body:
        """The intact body, the scar's weight in its cavity."""
        density = np.where(self.cavity[:, None], self.scar.density, self.tissue.density)
        return replace(self.intact, density=density)

    def _settled(self, state: TissueState) -> TissueState:
        """In equilibrium; what the next step starts from has that shape too, if it is the first or the body moves."""
        body = self.body(state)
        x, report = self.equilibrium.loaded(body, self.X, self.gravity, state.x)
        course = state.course
        if course is not None and state.cycle == 0:
            course = _course(course.now._replace(x=x))
        return replace(state, x=x, course=course, newton_iterations=state.newton_iterations + report.iterations)

    def body(self, state: TissueState) -> Body:
        """The body as it is; with an open cavity where nothing has been laid into it yet."""
        return super().body(state) if state.course is None else self.solver(state).tissue(state.course.now)

    def is_over(self, state: TissueState) -> bool:
        """Whether the wound is closed and the last visit is over."""
        return state.is_closed and state.cycle >= self.last_visit

    def _seen(self, state: TissueState, course: Course) -> TissueState:
        """The state with what the lattice shows of a course."""
        rho = self.transport.at_points(course.now.fields[:, 0])
        space = self.intact.frame.space
        fit = linear_fit(rho, self.transport.weights, space.corner_table.points)
        filled = self.sites.evaluate(fit).reshape(self.automaton.lattice.shape) >= CLOSED
        occupancy = self.automaton.fillable & (filled | ~self.automaton.open0)
        healing = AutomatonState(occupancy, course.taken)
        return replace(state, healing=healing, filled=self.filled(healing), course=course)

    def _closed_between(self, before: Course, after: Course) -> float:
        """When the last place was filled, linear in time [days]; below 0 if it is not yet."""
        low, high = (course.now.fields[self.beds, 0] for course in (before, after))
        if high.min(initial=1.0) < CLOSED:
            return -1.0
        late = low < CLOSED
        share = float(((CLOSED - low[late]) / (high[late] - low[late])).max(initial=0.0))
        return days_from_seconds(before.time + share * (after.time - before.time))

    def shown(self, state: TissueState) -> dict[str, np.ndarray]:
        """Besides what is filled: cells and collagen over those of healthy tissue, means of elements (n_elements,) [1]."""
        assert state.course is not None
        now, weights = state.course.now, self.transport.weights
        points = {"cells_fraction": self.transport.at_points(now.fields[:, 0]), "collagen_fraction": now.local.phi}
        means = {name: np.sum(at * weights, axis=1) / np.sum(weights, axis=1) for name, at in points.items()}
        return super().shown(state) | means

    def measured(self, state: TissueState) -> dict[str, float]:
        """What the fields say of the cavity: means over it, and its size as it is now."""
        assert state.course is not None
        now, weights = state.course.now, self.transport.weights[self.cavity]

        def mean(points: np.ndarray) -> float:
            return float(np.sum(points[self.cavity] * weights) / np.sum(weights))

        J = np.linalg.det(self.intact.law_gradient(self.X, state.x))
        return {
            "cells_mean": mean(self.transport.at_points(now.fields[:, 0])),
            "cytokine_mean": mean(self.transport.at_points(now.fields[:, 1])),
            "collagen_mean": mean(now.local.phi),
            "permanent_volume_mean": mean(np.prod(now.local.stretch, axis=-1)),
            "cavity_volume_mean": mean(J),
        }


def _course(state: WoundState) -> Course:
    return Course((state,), (0.0,), FIRST_STEP_S)
