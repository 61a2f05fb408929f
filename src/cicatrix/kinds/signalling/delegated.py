"""A signalling network that libroadrunner integrates: its time course, without steady states and sensitivities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...biology.roadrunner import DelegatedNetwork
from ...core.units import seconds_from_hours
from ...runs.kind import Context, Drawing, End, Packed, Row, Simulation
from ...runs.quantity import Quantity
from .build import accuracy_of, inputs_at, refuse_unknown, row_times
from .case import SignallingCase
from .figures import courses_figure
from .network import read_model


class DelegatedState(NamedTuple):
    """The course before (no values) or after its only pass: libroadrunner cannot go on from a state with pending events."""

    values: np.ndarray
    """Values at the times of the rows (n_times, n_species), or (0, n_species)."""


class DelegatedRun(Simulation[DelegatedState]):
    """Integrates a network by libroadrunner, in one pass."""

    building, marching = "network", "course"

    def __init__(self, case: SignallingCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        self.model = read_model(case)
        refuse_unknown(case, self.model)
        assert isinstance(self.model.law, DelegatedNetwork)
        self.law: DelegatedNetwork = self.model.law
        self.times_h = row_times(case)
        self.times = seconds_from_hours(self.times_h)
        self.notes = list(self.model.notes)
        if self.law.has_jumps:
            seen = self.law.longest_step(self.times)
            self.notes.append(f"A condition that holds for less than {seen:.3g} s may pass unseen.")

    def start(self) -> DelegatedState:
        """Return the state before the pass."""
        return DelegatedState(np.zeros((0, len(self.law.species))))

    def march(self, state: DelegatedState) -> Iterator[DelegatedState]:
        """Yield the whole course."""
        if not len(state.values):
            yield DelegatedState(self.law.course(self.times, accuracy_of(self.case, np.ones(()))))

    def rows(self, state: DelegatedState) -> Iterator[Row]:
        """Return all rows: species, what changes besides them, and the inputs that the case sets."""
        for number, (time_h, y) in enumerate(zip(self.times_h, state.values)):
            inputs = dict(zip(self.law.input_names, inputs_at(self.case, self.model, time_h)))
            yield {
                "step": number,
                "time_h": float(time_h),
                **{name: float(value) for name, value in zip(self.law.species, y)},
                **{f"input_{name}": float(inputs[name]) for name in self.case.set},
            }

    def pack(self, state: DelegatedState) -> Packed:
        """Return the values, for a checkpoint."""
        return {"values": state.values}, {}

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> DelegatedState:
        """Return the state in a checkpoint."""
        return DelegatedState(arrays["values"])

    def done(self, state: DelegatedState) -> tuple[float, str]:
        """Return whether the course is computed, and the simulated time."""
        return float(len(state.values) > 0), f"{self.times_h[-1]:.4g} h"

    def outcome(self, end: End[DelegatedState]) -> dict[str, Quantity]:
        """Return the program that ran, and the species at the end."""
        last = dict(zip(self.law.species, map(float, end.state.values[-1])))
        return {
            "engine": Quantity("libroadrunner", "", "program that integrated the network"),
            "end": Quantity(last, "1", f"at {self.times_h[-1]:g} h"),
        }

    def figures(self, end: End[DelegatedState]) -> Mapping[str, Drawing]:
        """Return the function that draws the time courses."""
        return {"courses": partial(courses_figure, end.history, self.law.species, tuple(self.case.set), "input")}

    def sentence(self, end: End[DelegatedState]) -> str:
        """Return a sentence on how long the network was integrated, and by what."""
        return f"The network was simulated over {self.times_h[-1]:.6g} h by libroadrunner."
