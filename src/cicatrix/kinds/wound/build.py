"""Build the model of a case of kind "wound", and measure its states."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...cases.continuum_laws import Network, front_resolution_warning, local_of, mobility_of, scarring_of
from ...healing.continuum import ContinuumIntegrator, IntegratorState, Tolerance, WoundState
from ...healing.scarring import Local
from ...healing.transport import Transport
from .body import MaterialPoints, WoundBody, breast_with_cavity, sheet_with_wound
from .case import WoundCase


class WoundModel(NamedTuple):
    """Solver of a wound, its body and its initial state."""

    solver: ContinuumIntegrator
    body: WoundBody
    fields: np.ndarray
    """Initial cells and cytokine at the vertex nodes (n, 2) [1]."""
    local: Local
    """Initial states at the quadrature points."""
    notes: tuple[str, ...]

    def start(self, first_step: float) -> IntegratorState:
        """Return the initial state of the integration, with the length of the first time step [s]."""
        return self.solver.start(self.fields, self.local, first_step)


def model_of(case: WoundCase, network: Network | None = None, body: WoundBody | None = None) -> WoundModel:
    """Build the model of a case on the body of its benchmark, or on ``body`` if it is given.

    ``network`` is a signalling network and its initial activities (n_species,).

    Raises
    ------
    InputError
        If the adhesion is not defined on an unstretched substrate, or the network lacks the input or output that is named.
    """
    if body is None:
        body = sheet_with_wound(case.elements or 40) if case.is_sheet else breast_with_cavity(case.elements or 16)
    scarring, signal_state = scarring_of(case, network)
    space, X = body.discretization.space, body.X
    transport = Transport(space, X, body.fixed_vertices)
    tolerance = case.solver.time_tolerance
    iteration = case.solver.iteration_tolerance or min(0.1 * tolerance, 1e-5)
    solver = ContinuumIntegrator(
        *(body.placeholder_body(), X, np.zeros(3), scarring, mobility_of(case), transport),
        Tolerance(tolerance, iteration),
        case.coupling == "two-way",
    )
    fields, local = _at_first(case, body, transport, signal_state)
    return WoundModel(solver, body, fields, local, front_resolution_warning(case, transport))


def _at_first(
    case: WoundCase, body: WoundBody, transport: Transport, signal_state: np.ndarray
) -> tuple[np.ndarray, Local]:
    """Return cells and cytokine at vertex nodes, and local states, of the fresh wound, blended into healthy tissue."""
    v, space = case.values, body.discretization.space
    healthy, whole = body.healthy
    fields = np.stack([v["rho_wound"] + (1.0 - v["rho_wound"]) * healthy, v["c_wound"] * (1.0 - healthy)], axis=-1)
    phi = v["phi_wound"] + (1.0 - v["phi_wound"]) * whole
    return fields, local_of(phi, v["kappa"], signal_state, space.n_axes)


class Numbers(NamedTuple):
    """Measures of a wound for one row of the history."""

    size: float
    """Present area or volume of the material that formed the initial wound [mm^2, mm^3]."""
    at: dict[str, dict[str, float]]
    """rho, c, phi and permanent change of area or volume (lamP) at "centre" and "edge"."""
    cells: float
    """Cells in the whole body: density over that of healthy tissue, integrated over the area or volume [mm^2, mm^3]."""


def numbers_of(model: WoundModel, state: WoundState) -> Numbers:
    """Compute wound size, cells and local values at centre and edge of a state, for one row of the history."""
    transport, local = model.solver.transport, state.local
    to_corners = np.linalg.pinv(
        transport.space.corner_table.value
    ).T  # within each element, as values at quadrature points may jump between elements
    of = {
        "rho": state.fields[transport.element_vertices, 0],
        "c": state.fields[transport.element_vertices, 1],
        "phi": local.phi @ to_corners,
        "lamP": np.prod(local.stretch, axis=-1) @ to_corners,
    }
    points_at: dict[str, MaterialPoints] = {"centre": model.body.centre, "edge": model.body.edge}
    at = {where: {name: points.mean(corners) for name, corners in of.items()} for where, points in points_at.items()}
    return Numbers(model.body.size(state.x), at, transport.total(state.fields[:, 0]))
