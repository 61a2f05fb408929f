"""Tissue that grows because its cells pull: the chain followed through time."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np

from ...cases.signals import NetworkSignalTable
from ...core.errors import ConvergenceError
from ...core.units import hours_from_seconds
from ...files.networks import read_network
from ...numerics.ode import Course
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .build import CHUNK, Model, accuracy_of, felt, follow, is_borne, model_of, passive_stress
from .case import TissueCellCase
from .figures import chain_figure

CHECKPOINT_SECONDS = 10.0  # between two checkpoints; one more when the run is interrupted
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


@dataclass
class TissueCellRun:
    """One run; a checkpoint holds the states at the end of some rows, where the solver starts anew."""

    case: TissueCellCase
    folder: RunFolder
    progress: Progress
    saved: float = field(default_factory=time.perf_counter)

    def go(self) -> str:
        """Follow the tissue to the end; returns the sentence that ends the run."""
        with self.progress.stage("law"):
            for note in self.model.notes:
                self.folder.note(note)
        with self.progress.stage("grow"):
            n_steps = self._follow()
        with self.progress.stage("outcome"):
            return self._tell(n_steps)

    @cached_property
    def model(self) -> Model:
        """The chain and what it is led by."""
        return model_of(self.case, network_of(self.case))

    def _follow(self) -> int:
        """Write the rows; returns the solver's steps."""
        kept, times = self.folder.checkpoint, self.model.times
        if kept is None:
            row, y, n_steps = 0, self.model.start, 0
            self._record(np.array([0]), y[None])
        else:
            row, y, n_steps = kept.cycle, kept.arrays["y"], kept.scalars["n_steps"]
        try:
            while row < len(times) - 1:
                y, taken = self._pass(row, y)
                row, n_steps = min(row + CHUNK, len(times) - 1), n_steps + taken
                if time.perf_counter() - self.saved > CHECKPOINT_SECONDS:
                    self._save(row, y, n_steps)
                now, end = hours_from_seconds(times[row]), hours_from_seconds(times[-1])
                self.progress.update(row / (len(times) - 1), f"{now:.4g} h of {end:.4g} h simulated")
        except (KeyboardInterrupt, ConvergenceError):
            self._save(row, y, n_steps)
            raise
        return n_steps

    def _pass(self, row: int, y: np.ndarray) -> tuple[np.ndarray, int]:
        """Some rows on from one: the states there, and the solver's steps."""
        rows = np.minimum(np.arange(row, row + CHUNK + 1), len(self.model.times) - 1)  # as many always: compiled once
        done = follow(
            self.model.chain, self.model.corners, jnp.asarray(y), self.model.times[rows], accuracy_of(self.case)
        )
        states = np.asarray(done.y)
        if not done.is_done:
            raise self._failure(done)
        new = np.unique(rows)[1:]
        self._record(new, states[1 : len(new) + 1])
        return states[-1], int(done.n_steps)

    def _failure(self, done: Course) -> ConvergenceError:
        y, reached = np.asarray(done.last), float(done.reached)
        held = ", ".join(f"{name} {value:.4g}" for name, value in zip(self.model.chain.names[:5], y))
        elastic = float(self.model.stretch(np.array(reached))) / y[0]
        if not is_borne(self.model, elastic):
            why = "cells pull more than the substrate bears there"
        elif done.is_spent:
            why = f"solver.max_steps = {int(done.n_steps)} were taken; raise it"
        else:
            why = f"the solver gave up after {int(done.n_steps)} steps"
        return ConvergenceError(
            f"The tissue could not be followed beyond {hours_from_seconds(reached):.6g} h, at an elastic stretch of "
            f"{elastic:.4g}: {why}.",
            [f"last good state: {held}"],
        )

    def _record(self, rows: np.ndarray, states: np.ndarray) -> None:
        at, scale = self.model.times[rows], self.case.scale
        has = felt(self.model, states, at)
        passive = passive_stress(self.model.law, has.elastic)
        for k, (row, y) in enumerate(zip(rows, states)):
            cells: Mapping[str, Any] = {
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
                **{f"activity_{name}": float(value) for name, value in zip(self.model.chain.signal.names, y[5:])},
            }
            self.folder.record(cells)

    def _save(self, row: int, y: np.ndarray, n_steps: int) -> None:
        self.saved = time.perf_counter()
        self.folder.save_checkpoint(row, {"y": y}, {"n_steps": n_steps})

    def _tell(self, n_steps: int) -> str:
        history = self.folder.history()
        told = {name: Quantity(float(history[name][-1]), unit, "at the end") for name, unit in UNITS.items()}
        told["n_solver_steps"] = Quantity(n_steps, "1")
        self.folder.write_outcome(told)
        self.folder.save_figure("chain", chain_figure(history))
        grown = history["lambda_g"][-1] - history["lambda_g"][0]
        return f"Through {history['time_h'][-1]:.6g} h the tissue grew by {100 * grown:.3g} % along each axis of the plane."


def network_of(case: TissueCellCase):
    """Read the network of a case's signal and its start, if it has one."""
    if not isinstance(case.signal, NetworkSignalTable):
        return None
    model = read_network(case.signal.species, case.signal.reactions, case.signal.inhibition)
    return model.law, model.start
