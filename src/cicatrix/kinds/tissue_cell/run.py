"""Tissue that grows because its cells pull: the chain of models integrated through time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ...cases.signals import NetworkSignalTable
from ...core.errors import ConvergenceError
from ...core.units import hours_from_seconds
from ...files.networks import read_network
from ...numerics.ode import Solution
from ...runs.kind import Context, Drawing, End, Packed, Row, Simulation
from ...runs.quantity import Quantity
from .build import CHUNK, accuracy_of, adhesion_is_finite, integrate, model_of, passive_stress, stimulus
from .case import TissueCellCase
from .figures import tissue_cell_figure

UNITS = {
    "lambda_s": "1",
    "lambda_g": "1",
    "rho_per_mm3": "1/mm3",
    "c_g_per_mm3": "g/mm3",
    "m_f": "1",
    "bound_fraction": "1",
    "traction_kPa": "kPa",
    "sigma_kPa": "kPa",
    "signal": "1",
}


class TissueCellState(NamedTuple):
    """State of the tissue at a row, with the rows since the solver was last started."""

    row: int
    y: np.ndarray
    """State of the model (n_states,)."""
    n_steps: int
    """Steps of the solver so far."""
    new_rows: np.ndarray
    """Numbers of the rows since the solver was last started (n,)."""
    new_states: np.ndarray
    """States at these rows (n, n_states)."""


class TissueCellRun(Simulation[TissueCellState]):
    """Integrates bond, signal, turnover and growth together; the solver restarts every few rows."""

    building, marching = "law", "grow"

    def __init__(self, case: TissueCellCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        self.model = model_of(case, network_of(case))
        self.notes = list(self.model.notes)

    def start(self) -> TissueCellState:
        """Return the tissue at the first instant of its loading."""
        y = self.model.start
        return TissueCellState(0, y, 0, np.array([0]), y[None])

    def march(self, state: TissueCellState) -> Iterator[TissueCellState]:
        """Integrate the model, and yield the state after every few rows."""
        last = len(self.model.times) - 1
        while state.row < last:
            rows = np.minimum(np.arange(state.row, state.row + CHUNK + 1), last)  # of one length: compiled once
            done = integrate(
                *(self.model.mechanobiology, self.model.corners, jnp.asarray(state.y), self.model.times[rows]),
                accuracy_of(self.case),
            )
            if not done.is_done:
                raise self._failure(done)
            states, new = np.asarray(done.y), np.unique(rows)[1:]
            n_steps = state.n_steps + int(done.n_steps)
            state = TissueCellState(int(new[-1]), states[-1], n_steps, new, states[1 : len(new) + 1])
            yield state

    def _failure(self, done: Solution) -> ConvergenceError:
        y, reached = np.asarray(done.last), float(done.reached)
        held = ", ".join(f"{name} {value:.4g}" for name, value in zip(self.model.mechanobiology.names[:5], y))
        elastic = float(self.model.stretch(np.array(reached))) / y[0]
        if not adhesion_is_finite(self.model, elastic):
            why = "the cells' pull exceeds the load that the substrate can carry there"
        elif done.out_of_steps:
            why = f"solver.max_steps = {int(done.n_steps)} were taken; raise it"
        else:
            why = f"the solver gave up after {int(done.n_steps)} steps"
        return ConvergenceError(
            f"The tissue could not be followed beyond {hours_from_seconds(reached):.6g} h, at an elastic stretch of "
            f"{elastic:.4g}: {why}.",
            [f"last good state: {held}"],
        )

    def rows(self, state: TissueCellState) -> Iterator[Row]:
        """Return stretches, densities, traction and stress at the new rows."""
        at, scale, states = self.model.times[state.new_rows], self.case.scale, state.new_states
        has = stimulus(self.model, states, at)
        passive = passive_stress(self.model.law, has.elastic)
        for k, (row, y) in enumerate(zip(state.new_rows, states)):
            yield {
                "step": int(row),
                "time_h": float(hours_from_seconds(at[k])),
                "lambda": float(self.model.stretch(at[k])),
                "lambda_s": float(has.elastic[k]),
                "lambda_g": float(y[0]),
                "rho_per_mm3": float(y[1] * scale.rho_phys_per_mm3),
                "c_g_per_mm3": float(y[2] * scale.c_max_g_per_mm3),
                "m_f": float(y[3]),
                "bound_fraction": float(y[4]),
                "traction_kPa": float(has.traction[k]),
                "sigma_kPa": float(passive[k] + y[1] * has.traction[k]),
                "sigma_passive_kPa": float(passive[k]),
                "force_pN": float(has.force[k]),
                "signal": float(has.signal[k]),
                **{
                    f"activity_{name}": float(value)
                    for name, value in zip(self.model.mechanobiology.signal.names, y[5:])
                },
            }

    def pack(self, state: TissueCellState) -> Packed:
        """Return the state of the model."""
        return {"y": state.y}, {"row": state.row, "n_steps": state.n_steps}

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> TissueCellState:
        """Return the state in a checkpoint."""
        y = arrays["y"]
        return TissueCellState(scalars["row"], y, scalars["n_steps"], np.zeros(0, int), np.zeros((0, len(y))))

    def done(self, state: TissueCellState) -> tuple[float, str]:
        """Return the fraction of the rows that is computed, and the simulated time."""
        times = self.model.times
        now, end = hours_from_seconds(times[state.row]), hours_from_seconds(times[-1])
        return state.row / (len(times) - 1), f"{now:.4g} h of {end:.4g} h simulated"

    def outcome(self, end: End[TissueCellState]) -> dict[str, Quantity]:
        """Return the stretches, densities, traction and stress of the last row."""
        last = {name: Quantity(float(end.history[name][-1]), unit, "at the end") for name, unit in UNITS.items()}
        return last | {"n_solver_steps": Quantity(end.state.n_steps, "1")}

    def figures(self, end: End[TissueCellState]) -> Mapping[str, Drawing]:
        """Return the figure of all states over time."""
        return {"chain": partial(tissue_cell_figure, end.history)}

    def sentence(self, end: End[TissueCellState]) -> str:
        """Return a sentence on how much the tissue grew."""
        hours, growth = end.history["time_h"][-1], end.history["lambda_g"]
        percent = 100 * (growth[-1] - growth[0])
        return f"In {hours:.6g} h the tissue grew by {percent:.3g} % along each axis of the plane."


def network_of(case: TissueCellCase):
    """Return the signalling network of a case and its initial state; None if its signal is not a network."""
    if not isinstance(case.signal, NetworkSignalTable):
        return None
    model = read_network(case.signal.species, case.signal.reactions, case.signal.inhibition)
    return model.law, model.start
