"""A cell on a substrate: its bonds integrated from row to row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...runs.kind import Context, Drawing, End, Packed, Row, Simulation
from ...runs.quantity import Quantity
from .bonds import SampledBonds, bond_solver
from .build import law_and_notes
from .case import AdhesionCase
from .figures import course_figure, stretch_figure
from .summary import mean_course, summary

WORDS = {
    "ode": "The mean bound fraction",
    "monte-carlo": "The state of single bonds",
    "ssa": "The state of single bonds, at exact times,",
}


class BondState(NamedTuple):
    """State of the bonds at a row of the history: the mean bound fraction, or every single bond."""

    row: int
    bound: np.ndarray


class AdhesionRun(Simulation[BondState]):
    """Integrates the bonds of a case of kind "adhesion"."""

    building, marching = "law", "bind"

    def __init__(self, case: AdhesionCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        self.law, self.notes = law_and_notes(case)
        self.solver = bond_solver(case, self.law)

    def start(self) -> BondState:
        """Return the bonds at time 0."""
        return BondState(0, self.solver.start())

    def march(self, state: BondState) -> Iterator[BondState]:
        """Yield the bonds at the time of every later row of the history."""
        for row in range(state.row + 1, len(self.solver.times)):
            state = BondState(row, self.solver.advance(state.bound, row))
            yield state

    def rows(self, state: BondState) -> Iterator[Row]:
        """Return the rows of the history for this time, one per stretch."""
        bonds = self.solver.report(state.bound, state.row)
        traction = np.asarray(self.law.traction(bonds.force, bonds.mean))
        for i, stretch in enumerate(self.case.substrate.stretch):
            yield {
                "step": state.row,
                "time_s": float(self.solver.times[state.row]),
                "stretch": float(stretch),
                "bound_fraction": float(bonds.mean[i]),
                "bound_fraction_sd": float(bonds.sd[i]),
                "force_pN": float(bonds.force[i]),
                "traction_kPa": float(traction[i]),
                **{name: float(values[i]) for name, values in bonds.others.items()},
            }

    def pack(self, state: BondState) -> Packed:
        """Return the bonds as an array."""
        return {"bound": state.bound}, {"row": state.row}

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> BondState:
        """Return the bonds from the arrays and numbers of ``pack``."""
        return BondState(scalars["row"], arrays["bound"])

    def done(self, state: BondState) -> tuple[float, str]:
        """Return the fraction of the rows that is computed, and the simulated time."""
        times = self.solver.times
        return state.row / (len(times) - 1), f"{times[state.row]:.4g} s of {times[-1]:.4g} s simulated"

    def outcome(self, end: End[BondState]) -> dict[str, Quantity]:
        """Return the steady states, and the outcomes computed from the history."""
        numbers = summary(self.case, self.law, end.history)
        return {name: Quantity(*entry) for name, entry in numbers.items()}

    def figures(self, end: End[BondState]) -> Mapping[str, Drawing]:
        """Return the functions that draw the bonds over time and, for several stretches, the steady states over the stretch."""
        drawings: dict[str, Drawing] = {"course": partial(self._course, end)}
        if len(self.case.substrate.stretch) > 1:
            drawings["stretch"] = partial(self._over_stretch, end)
        return drawings

    def _course(self, end: End[BondState]) -> Any:
        mean = mean_course(self.case, self.law) if isinstance(self.solver, SampledBonds) else None
        return course_figure(end.history, mean)

    def _over_stretch(self, end: End[BondState]) -> Any:
        return stretch_figure({name: entry[0] for name, entry in summary(self.case, self.law, end.history).items()})

    def sentence(self, end: End[BondState]) -> str:
        """Return a sentence on how long the bonds were integrated."""
        return f"{WORDS[self.case.method.type]} was computed over {self.solver.times[-1]:.6g} s."
