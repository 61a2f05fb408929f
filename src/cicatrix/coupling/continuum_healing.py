"""Continuum model of wound healing in a cavity: cells, cytokine and collagen as fields, and contraction by the cells."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..core.units import days_from_seconds, seconds_from_days
from ..geometry.transfer import linear_fit
from ..healing.continuum import (
    ContinuumIntegrator,
    Host,
    IntegratorState,
    Tolerance,
    WoundState,
    integrator_arrays,
    integrator_from,
    integrator_scalars,
)
from ..healing.scarring import Local, Scarring
from ..healing.transport import Mobility, Transport
from ..mechanics.body import Body
from .cavity import Cavity
from .deposition import Deposition
from .healing import Advance, TissueState
from .ruler import Ruler

CLOSED = 0.5  # cell density at and above which a site counts as filled, relative to healthy tissue
FIRST_STEP_S = 3600.0


@dataclass(frozen=True, eq=False)
class FreshWound:
    """Contents of a fresh wound; the tissue around it is healthy, with all densities 1 and no cytokine."""

    rho: float
    """Cell density relative to healthy tissue [1]."""
    c: float
    """Cytokine concentration relative to a maximum [1]."""
    local: Local
    """Internal variables at quadrature points (n_elements, n_qp) of the whole body."""


@dataclass(frozen=True, eq=False)
class ContinuumTissue:
    """State of healing by the continuum model: fields in the cavity and around it, and the filled sites.

    Parameters
    ----------
    integration : IntegratorState
        Present fields, and the earlier ones that the next time step needs.
    natural : (n_elements, n_qp, 3, 3) array [1]
        Natural configuration: of new tissue in the cavity; elsewhere the deformation at which cells sense no strain.
    occupancy : bool array of the lattice's shape
        Sites where the density of cells has reached ``CLOSED``; it follows from the fields.
    filled : (n_elements,) array [1]
        Fraction of each element's sites that are filled.
    """

    integration: IntegratorState
    natural: np.ndarray
    occupancy: np.ndarray
    filled: np.ndarray


@dataclass(frozen=True, eq=False)
class ContinuumHealing:
    """Model of wound healing (:class:`.healing.Healing`) by reaction, diffusion and contraction; docs/theory/wound.md.

    The cavity is filled from the start with a provisional matrix into which cells migrate; its stiffness and weight scale
    with its collagen. Surrounding tissue keeps its law; there cells sense the strain relative to the shape before surgery.

    Parameters
    ----------
    cavity : Cavity
        The body and its cavity.
    ruler : Ruler
        Lattice that measures the wound.
    gravity : (3,) array [mm/s^2]
        Gravity in the healing position, in the body's axes.
    deposition : Deposition
        Stress-free state of new tissue.
    scarring : Scarring
        Laws at a point.
    mobility : Mobility
        Laws of transport of cells and cytokine.
    transport : Transport
        Discretization of cells and cytokine on the whole body, without flux through its surface.
    contents : FreshWound
        Contents of the fresh wound.
    tolerance : Tolerance
        Accuracy of time steps.
    is_coupled : bool
        True (two-way): cells, fibres and contracture follow the deforming body. False (one-way): the shape after surgery is kept.
    last_visit : int
        Cycle until which a closed wound is simulated, because scars change shape long after closure.
    notes : tuple of str
        Sentences for the run's manifest.
    report : callable, optional
        Function that is called with a text giving the day reached.
    closes : str
        Text that says when the wound counts as closed.
    """

    cavity: Cavity
    ruler: Ruler
    gravity: np.ndarray
    deposition: Deposition
    scarring: Scarring
    mobility: Mobility
    transport: Transport
    contents: FreshWound
    tolerance: Tolerance
    is_coupled: bool
    last_visit: int
    notes: tuple[str, ...] = ()
    report: Callable[[str], None] | None = None
    closes: str = f"when the cell density had reached {CLOSED:g} of that of healthy tissue everywhere"

    def fresh(self, x: np.ndarray, x_intact: np.ndarray) -> ContinuumTissue:
        """Return the state right after surgery: a cavity full of provisional matrix, deposited in the shape x.

        ``x_intact`` is the shape before surgery; both (n_nodes, 3) [mm].
        """
        elements = self.cavity.elements
        none, full = np.zeros(elements.shape), np.ones(elements.shape)
        laid = self.deposition.natural(self.cavity.unstrained, none, full, self.cavity.deformation(x))
        natural = np.where(elements[:, None, None, None], laid, self.cavity.deformation(x_intact))
        # the border of the cavity gets the mean of the values on its two sides
        inside = 0.5 * vertices_of(self.transport, elements) + 0.5 * self.cavity_vertices
        rho, c = 1.0 - (1.0 - self.contents.rho) * inside, self.contents.c * inside
        first = WoundState(x, np.stack([rho, c], axis=-1), self.contents.local)
        return self._with_sites(IntegratorState((first,), (0.0,), FIRST_STEP_S), natural)

    @cached_property
    def cavity_vertices(self) -> np.ndarray:
        """Whether each vertex node lies inside the cavity and not on its border (n,) bool."""
        return inner_vertices(self.transport, self.cavity.elements)

    def _with_sites(self, integration: IntegratorState, natural: np.ndarray) -> ContinuumTissue:
        """Return the state with integrated fields, and with the filled sites and elements computed from them."""
        rho = self.transport.at_points(integration.now.fields[:, 0])
        fit = linear_fit(rho, self.transport.weights, self.transport.space.corner_table.points)
        occupancy = self.ruler.occupancy(self.ruler.at_sites(fit) >= CLOSED)
        return ContinuumTissue(integration, natural, occupancy, self.ruler.filled(occupancy))

    def advance(self, state: TissueState[ContinuumTissue], until: float) -> Advance[ContinuumTissue]:
        """Integrate the fields up to a time [days], in the two-way model together with the deformation of the body.

        Raises
        ------
        ConvergenceError
            If time steps become too short.
        """
        solver, integration, closure, iterations = self.solver(state.healing), first_shape(state), state.closure_days, 0
        for reached in solver.integrate(integration, seconds_from_days(until)):
            if closure < 0.0:
                closure = self._closed_between(integration, reached)
            integration, iterations = reached, iterations + reached.iterations
            if self.report is not None:
                self.report(f"day {days_from_seconds(integration.time):.1f}")
        tissue = self._with_sites(integration, state.healing.natural)
        return Advance(tissue, closure, integration.now.x if self.is_coupled else None, iterations)

    def solver(self, state: ContinuumTissue) -> ContinuumIntegrator:
        """Return a new solver of the fields, one for each cycle, so that a restarted run gives identical bits."""
        return ContinuumIntegrator(
            *(self._weighing, self.cavity.X, self.gravity, self.scarring, self.mobility, self.transport),
            *(self.tolerance, self.is_coupled, Host(self.cavity.elements, state.natural)),
        )

    @cached_property
    def _weighing(self) -> Body:
        """Intact body with the mass density of scar in its cavity."""
        return replace(self.cavity.intact, density=self.cavity.density)

    def _closed_between(self, before: IntegratorState, after: IntegratorState) -> float:
        """Return the time at which the last vertex node was filled [days], interpolated between two states; -1 if one is open."""
        low, high = (integration.now.fields[self.cavity_vertices, 0] for integration in (before, after))
        if high.min(initial=1.0) < CLOSED:
            return -1.0
        late = low < CLOSED
        share = float(((CLOSED - low[late]) / (high[late] - low[late])).max(initial=0.0))
        return days_from_seconds(before.time + share * (after.time - before.time))

    def is_over(self, state: TissueState[ContinuumTissue]) -> bool:
        """Check whether the wound is closed and the cycle ``last_visit`` is reached."""
        return state.is_closed and state.cycle >= self.last_visit

    def body(self, state: ContinuumTissue) -> Body:
        """Return the body with its present collagen, fibres and tension."""
        return self.solver(state).tissue(state.integration.now)

    def occupancy(self, state: ContinuumTissue) -> np.ndarray:
        """Return the sites where the cell density has reached ``CLOSED``: bool array of the lattice's shape."""
        return state.occupancy

    def filled(self, state: ContinuumTissue) -> np.ndarray:
        """Return the fraction of each element's sites that are filled (n_elements,) [1]."""
        return state.filled

    def shown(self, state: ContinuumTissue) -> dict[str, np.ndarray]:
        """Return cells and collagen relative to healthy tissue, means over elements (n_elements,) [1]."""
        now, weights = state.integration.now, self.transport.weights
        points = {"cells_fraction": self.transport.at_points(now.fields[:, 0]), "collagen_fraction": now.local.phi}
        return {name: np.sum(at * weights, axis=1) / np.sum(weights, axis=1) for name, at in points.items()}

    def measured(self, state: TissueState[ContinuumTissue]) -> dict[str, float]:
        """Return the means of the fields over the cavity, and the cavity's present volume relative to the unloaded one."""
        elements, now = self.cavity.elements, state.healing.integration.now
        weights = self.transport.weights[elements]

        def mean(points: np.ndarray) -> float:
            return float(np.sum(points[elements] * weights) / np.sum(weights))

        J = np.linalg.det(self.cavity.intact.law_gradient(self.cavity.X, state.x))
        return {
            "cells_mean": mean(self.transport.at_points(now.fields[:, 0])),
            "cytokine_mean": mean(self.transport.at_points(now.fields[:, 1])),
            "collagen_mean": mean(now.local.phi),
            "permanent_volume_mean": mean(np.prod(now.local.stretch, axis=-1)),
            "cavity_volume_mean": mean(J),
        }

    def pack(self, state: ContinuumTissue) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the state as named arrays, and scalars that JSON can store; filled sites follow from the fields."""
        return {"natural": state.natural, **integrator_arrays(state.integration)}, integrator_scalars(state.integration)

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> ContinuumTissue:
        """Return the state that ``pack`` stored, to the bit."""
        return self._with_sites(integrator_from(arrays, scalars), arrays["natural"])


def first_shape(state: TissueState[ContinuumTissue]) -> IntegratorState:
    """Return the integrator state to continue from; in the first cycle, with the shape found with the provisional matrix."""
    integration = state.healing.integration
    return integration if state.cycle else replace(integration, past=(integration.now._replace(x=state.x),))


def inner_vertices(transport: Transport, elements: np.ndarray) -> np.ndarray:
    """Return the vertex nodes that belong to chosen elements only: elements (n_elements,) bool -> (n,) bool."""
    return vertices_of(transport, elements) & ~vertices_of(transport, ~elements)


def vertices_of(transport: Transport, elements: np.ndarray) -> np.ndarray:
    """Return the vertex nodes of chosen elements: elements (n_elements,) bool -> (n,) bool."""
    found = np.zeros(transport.n, bool)
    found[transport.element_vertices[elements]] = True
    return found
