"""From a case of kind "wound" to its body, its laws and where it is looked at."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...cases.continuum_laws import Network, local_of, mobility_of, scarring_of, thin_fronts
from ...healing.continuum import Course, Tolerance, Wound, WoundState
from ...healing.scarring import Local
from ...healing.transport import Transport
from .body import Place, WoundBody, breast_with_cavity, sheet_with_wound
from .case import WoundCase


class WoundModel(NamedTuple):
    """A wound and where it is looked at."""

    solver: Wound
    body: WoundBody
    fields: np.ndarray
    """Cells and cytokine at first (n, 2)."""
    local: Local
    notes: tuple[str, ...]

    def start(self, first_step: float) -> Course:
        """The fresh wound; a first step [s]."""
        return self.solver.start(self.fields, self.local, first_step)


def model_of(case: WoundCase, network: Network | None = None, body: WoundBody | None = None) -> WoundModel:
    """Put the parts together, on a benchmark's body unless one is given; a network comes with its start (n_species,).

    Raises
    ------
    InputError
        If the adhesion does not hold at rest, or the network has no such input or output.
    """
    if body is None:
        body = sheet_with_wound(case.elements or 40) if case.is_sheet else breast_with_cavity(case.elements or 16)
    scarring, sensed = scarring_of(case, network)
    space, X = body.frame.space, body.X
    transport = Transport(space, X, body.held)
    tolerance = case.solver.time_tolerance
    iteration = case.solver.iteration_tolerance or min(0.1 * tolerance, 1e-5)
    solver = Wound(
        *(body.empty_body(), X, np.zeros(3), scarring, mobility_of(case), transport),
        Tolerance(tolerance, iteration),
        case.coupling == "two-way",
    )
    fields, local = _at_first(case, body, transport, sensed)
    return WoundModel(solver, body, fields, local, thin_fronts(case, transport))


def _at_first(case: WoundCase, body: WoundBody, transport: Transport, sensed: np.ndarray) -> tuple[np.ndarray, Local]:
    """Cells and cytokine at carriers, and local states, of the fresh wound: healthy tissue blended into it."""
    v, space = case.values, body.frame.space
    healthy, whole = body.healthy
    fields = np.stack([v["rho_wound"] + (1.0 - v["rho_wound"]) * healthy, v["c_wound"] * (1.0 - healthy)], axis=-1)
    phi = v["phi_wound"] + (1.0 - v["phi_wound"]) * whole
    return fields, local_of(phi, v["kappa"], sensed, space.n_axes)


class Numbers(NamedTuple):
    """What a row of the history tells of the wound."""

    size: float
    """Area or volume of the material that was wound at first, as it is now [mm^2, mm^3]."""
    at: dict[str, dict[str, float]]
    """rho, c, phi and lamP_area (or volume) at "centre" and "edge"."""
    cells: float
    """In the whole body, in those of healthy tissue times its volume [mm^2, mm^3]."""


def numbers_of(model: WoundModel, state: WoundState) -> Numbers:
    """Measure a state."""
    transport, local = model.solver.transport, state.local
    to_corners = np.linalg.pinv(
        transport.space.corner_table.value
    ).T  # within each element: what points hold may jump between
    of = {
        "rho": state.fields[transport.cells, 0],
        "c": state.fields[transport.cells, 1],
        "phi": local.phi @ to_corners,
        "lamP": np.prod(local.stretch, axis=-1) @ to_corners,
    }
    places: dict[str, Place] = {"centre": model.body.centre, "edge": model.body.edge}
    at = {where: {name: place.mean(corners) for name, corners in of.items()} for where, place in places.items()}
    return Numbers(model.body.size(state.x), at, transport.total(state.fields[:, 0]))
