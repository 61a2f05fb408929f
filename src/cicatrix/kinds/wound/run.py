"""A wound that the continuum model heals: integrated step by step, with maps of its fields at regular times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...cases.continuum_laws import network_of
from ...core.units import days_from_hours, hours_from_seconds, seconds_from_hours
from ...files.figures_continuum import fields_figure
from ...files.mesh_doubts import doubt_of_extent
from ...healing.continuum import IntegratorState, integrator_arrays, integrator_from, integrator_scalars
from ...runs.kind import Context, Drawing, End, Fields, Packed, Row, Simulation
from ...runs.quantity import Quantity
from .body import WoundBody, meshed_wound
from .build import model_of, numbers_of
from .case import WoundCase
from .figures import BREAST, SHEET, course_figure
from .mesh import given_wound

STEPS_PER_MARK = 10  # steps after which the solver's matrices are dropped; then later steps depend on the state alone


class WoundStep(NamedTuple):
    """State of a wound after a time step."""

    integration: IntegratorState
    first_size: float
    """Initial area or volume of the wound [mm^2, mm^3]."""
    factorizations: int
    """Factorisations of the mechanical matrix so far."""
    picture: int | None = None
    """Number of the map of fields that is due at this instant, if one is."""
    is_mark: bool = True
    """Whether the solver's matrices have been dropped."""


class WoundRun(Simulation[WoundStep]):
    """Integrates cells, cytokine, collagen and mechanics of a case of kind "wound"."""

    building, marching = "body", "heal"

    def __init__(self, case: WoundCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        body, notes = body_of(case)
        self.model = model_of(case, network_of(case.mechanosensing), body)
        self.solver = self.model.solver
        self.notes = [*notes, *self.model.notes]
        if notes:
            self.context.progress.update(1.0, " ".join(notes))
        self.end = seconds_from_hours(case.hours)
        self.ratio = "ring_area_ratio" if case.is_sheet else "cavity_volume_ratio"

    def start(self) -> WoundStep:
        """Return the fresh wound in equilibrium with the traction of its cells."""
        integration = self.model.start(seconds_from_hours(self.case.solver.first_step_h))
        return WoundStep(
            integration, numbers_of(self.model, integration.now).size, self.solver.factorizations, picture=0
        )

    def march(self, state: WoundStep) -> Iterator[WoundStep]:
        """Yield the wound after every step; steps end exactly at the times of the maps, which are equally spaced."""
        integration, every = state.integration, self.case.output_interval_h
        if state.is_mark:
            self.solver.reset()
            self.solver.factorizations = state.factorizations
        number = int(np.floor(hours_from_seconds(integration.time) / every + 1e-9))
        while integration.time < self.end * (1.0 - 1e-9):
            number += 1
            until = min(seconds_from_hours(number * every), self.end)
            for reached in self.solver.integrate(integration, until):
                integration = reached
                is_due = integration.time >= until * (1.0 - 1e-12)
                is_mark = is_due or integration.n_accepted % STEPS_PER_MARK == 0
                if is_mark:
                    self.solver.reset()
                picture = number if is_due else None
                yield WoundStep(integration, state.first_size, self.solver.factorizations, picture, is_mark)

    def is_mark(self, state: WoundStep) -> bool:
        """Return whether the solver's matrices were dropped after this step."""
        return state.is_mark

    def rows(self, state: WoundStep) -> Iterator[Row]:
        """Return sizes, densities at the wound's centre and edge, and the solver's effort."""
        integration = state.integration
        numbers = numbers_of(self.model, integration.now)
        lam = "lamP_area" if self.case.is_sheet else "lamP_volume"
        local = {
            f"{lam if name == 'lamP' else name}_{where}": value
            for where, values in numbers.at.items()
            for name, value in values.items()
        }
        yield {
            "step": integration.n_accepted,
            "time_h": hours_from_seconds(integration.time),
            self.ratio: numbers.size / state.first_size,
            **local,
            "cells_total": numbers.cells * self.case.values["rho_phys_per_mm3"],
            "step_h": hours_from_seconds(integration.last_dt),
            "newton_iterations": integration.iterations,
            "wound_size": numbers.size,
            "steps_cut": integration.n_rejected,
        }

    def fields(self, state: WoundStep) -> Iterator[Fields]:
        """Return the fields on the deformed body if a map is due at this time."""
        if state.picture is not None:
            yield self._map(state.picture, state.integration)

    def _map(self, number: int, integration: IntegratorState) -> Fields:
        state, transport = integration.now, self.model.solver.transport
        space = transport.space
        X, x = (values[transport.vertex_nodes] for values in (self.model.body.X, state.x))
        local = state.local
        W = self.model.solver.tissue(state).energy_density(self.model.body.X, state.x)
        at_points = {
            "collagen": local.phi,
            "permanent_stretch": np.prod(local.stretch, axis=-1),
            "signal": self.model.solver.signal(state),
            "strain_energy_density_kPa": W,
        }
        points = {name: transport.at_vertices(values) for name, values in at_points.items()}
        points |= {"cells": state.fields[:, 0], "cytokine": state.fields[:, 1], "displacement": x - X}
        cells = transport.element_vertices if space.n_axes == 3 else _triangles(transport.element_vertices)
        time_days = days_from_hours(hours_from_seconds(integration.time))
        return Fields("wound", number, time_days, self.model.body.given(X), cells, points)

    def pack(self, state: WoundStep) -> Packed:
        """Return the state as arrays and numbers for a checkpoint: all values on which the next step depends."""
        counted = {"factorizations": state.factorizations, "first_size": state.first_size}
        return integrator_arrays(state.integration), integrator_scalars(state.integration) | counted

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> WoundStep:
        """Return the state in a checkpoint."""
        return WoundStep(integrator_from(arrays, scalars), scalars["first_size"], scalars["factorizations"])

    def done(self, state: WoundStep) -> tuple[float, str]:
        """Return the fraction of the duration that is simulated, and the day."""
        time = state.integration.time
        return time / self.end, f"{days_from_hours(hours_from_seconds(time)):.3g} d"

    @property
    def what(self) -> str:
        """Words for the measured size of the wound: an area in a sheet, a volume in a solid."""
        return "area of the ring" if self.case.is_sheet else "volume of the cavity"

    def outcome(self, end: End[WoundStep]) -> dict[str, Quantity]:
        """Return the size of the wound at the end and at its smallest, the densities at the end, and the effort."""
        history, integration, name = end.history, end.state.integration, self.ratio
        ratio, hours = history[name], history["time_h"]
        least, unit = int(ratio.argmin()), "mm2" if self.case.is_sheet else "mm3"
        first = float(history["wound_size"][0])
        outcome = {
            name: Quantity(float(ratio[-1]), "1", f"{self.what} at the end, relative to the initial one"),
            f"least_{name}": Quantity(float(ratio[least]), "1", "the smallest"),
            "time_of_least_h": Quantity(float(hours[least]), "h", "when it was smallest"),
            "first_size": Quantity(first, unit, f"initial {self.what}, under the pull"),
            "steps": Quantity(integration.n_accepted, "1"),
            "steps_cut": Quantity(integration.n_rejected, "1", "too long for their error, or without a solution"),
            "iterations": Quantity(int(history["newton_iterations"].sum()), "1"),
            "factorizations": Quantity(end.state.factorizations, "1", "of mechanics"),
            "n_dofs": Quantity(self._n_dofs(), "1", "of positions and fields that are free"),
        }
        for where in ("centre", "edge"):
            for key in [key for key in history if key.endswith(f"_{where}")]:
                outcome[key] = Quantity(float(history[key][-1]), "1", "at the end")
        return outcome

    def _n_dofs(self) -> int:
        supports = self.solver.body.discretization.supports(self.solver.transport.space.n_axes == 2)
        return supports.n_unknowns + 2 * len(self.solver.transport.free)

    def figures(self, end: End[WoundStep]) -> Mapping[str, Drawing]:
        """Return the functions that draw the wound over time, and its fields at the end."""
        view = SHEET if self.case.is_sheet else BREAST._replace(at_mm=self.model.body.middle_mm)
        now, days = end.state.integration.now, days_from_hours(self.case.hours)
        return {
            "course": partial(course_figure, end.history, self.ratio),
            "fields": partial(fields_figure, self.solver.transport, now, now.x, days, view),
        }

    def sentence(self, end: End[WoundStep]) -> str:
        """Return a sentence on the change of the wound's size."""
        ratio = end.history[self.ratio]
        days, now, least = days_from_hours(self.case.hours), 100.0 * ratio[-1], 100.0 * ratio.min()
        return (
            f"In {days:.4g} days the {self.what} changed to {now:.3g} % of its initial value (minimum {least:.3g} %)."
        )


def body_of(case: WoundCase) -> tuple[WoundBody | None, list[str]]:
    """Read the body whose mesh the case names (None if it names none); return it with notes on what was assumed."""
    if case.body is None:
        return None, []
    solid, is_wound = given_wound(case.body)
    notes = [*solid.notes, *filter(None, [doubt_of_extent(solid.points)])]
    return meshed_wound(solid.points, solid.tetrahedra, solid.is_fixed, is_wound), notes


def _triangles(squares: np.ndarray) -> np.ndarray:
    """Split quadrilaterals into pairs of triangles (2 n, 3), for ParaView."""
    return np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
