"""Healing alone: the automaton from a fresh wound to closure, step by step."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass, field

import numpy as np

from ..core import native
from ..healing.automaton import Automaton, AutomatonState, pack_rows, unpack_rows
from ..study.automaton_case import AutomatonCase, automaton_of, cue_of
from .figures_automaton import closure_figure
from .progress import Progress
from .results import Quantity, RunFolder

BATCH = 10  # steps between two looks
CHECKPOINT_EVERY = 100  # steps
FRONTS_EVERY = 0.1  # of the wound closed, between two fronts of the picture


@dataclass
class AutomatonRun:
    """One run; a checkpoint holds occupancy and step, what the picture needs, and the seconds spent."""

    case: AutomatonCase
    folder: RunFolder
    progress: Progress
    fronts: list[np.ndarray] = field(default_factory=list)  # occupancies as rows of bits
    steps_of_fronts: list[int] = field(default_factory=list)
    seconds: float = 0.0

    def go(self) -> str:
        """Run to closure or to the last step; returns the sentence that ends the run."""
        with self.progress.stage("lattice"):
            automaton = automaton_of(self.case)
            cue = automaton.checked(cue_of(self.case))
            state = self._start(automaton)
            self.folder.note(_how())
        core, n_open0 = automaton.core(state), int(np.count_nonzero(automaton.open0))
        n_open = int(np.count_nonzero(automaton.fillable)) - state.n_cells
        with self.progress.stage("heal"):
            while n_open and core.step < self.case.run.max_steps:
                n_steps = min(BATCH, self.case.run.max_steps - core.step)
                started, first = time.perf_counter(), core.step + 1
                counts = core.advance(n_steps, *cue)
                self.seconds += time.perf_counter() - started
                n_open = self._record(automaton, first, counts, n_open0)
                self.progress.update(1.0 - n_open / n_open0, f"step {core.step}")
                self._keep(automaton, core, 1.0 - n_open / n_open0)
        with self.progress.stage("outcome"):
            return self._finish(automaton, core, n_open)

    def _start(self, automaton: Automaton) -> AutomatonState:
        kept = self.folder.checkpoint
        if kept is None:
            state = automaton.initial_state()
            self.fronts, self.steps_of_fronts = [pack_rows(state.occupancy)], [0]
            n_open = int(np.count_nonzero(automaton.open0))
            self.folder.record(_row(0, state.n_cells, n_open, 0.0, 0, 0))
            return state
        self.fronts, self.steps_of_fronts = list(kept.arrays["fronts"]), kept.scalars["steps_of_fronts"]
        self.seconds = kept.scalars["seconds"]
        return AutomatonState(unpack_rows(kept.arrays["occupancy"], automaton.lattice.shape), kept.scalars["step"])

    def _record(self, automaton: Automaton, first: int, counts: np.ndarray, n_open0: int) -> int:
        """Write a row per step, up to the one that closes the wound; returns the sites that are open after it."""
        n_fillable, n_open = int(np.count_nonzero(automaton.fillable)), 0
        for step, (n_edge, n_layer, _, _, n_cells) in enumerate(counts.tolist(), start=first):
            n_open = n_fillable - n_cells
            self.folder.record(_row(step, n_cells, n_open, 1.0 - n_open / n_open0, n_edge, n_layer))
            if n_open == 0:
                break
        return n_open

    def _keep(self, automaton: Automaton, core, closed: float) -> None:
        """Keep a front for the picture, and a checkpoint now and then."""
        wanted = len(self.fronts) * FRONTS_EVERY
        if closed >= wanted and closed < 1.0:
            self.fronts.append(pack_rows(core.occupancy()))
            self.steps_of_fronts.append(core.step)
        if core.step % CHECKPOINT_EVERY == 0:
            arrays = {"occupancy": pack_rows(core.occupancy()), "fronts": np.array(self.fronts)}
            scalars = {"step": core.step, "steps_of_fronts": self.steps_of_fronts, "seconds": self.seconds}
            self.folder.save_checkpoint(core.step, arrays, scalars)

    def _finish(self, automaton: Automaton, core, n_open: int) -> str:
        history = self.folder.history()
        last, occupancy = int(history["step"][-1]), core.occupancy()
        closed = last if n_open == 0 else None
        self.folder.write_outcome(
            {
                "steps_to_closure": Quantity(closed, "1", "" if closed is not None else f"{n_open} sites still open"),
                "occupancy_sha256": Quantity(
                    hashlib.sha256(np.packbits(occupancy).tobytes()).hexdigest(), "", "bits of the lattice in C order"
                ),
                "seconds_per_step": Quantity(self.seconds / max(last, 1), "s"),
                "n_sites": Quantity(automaton.lattice.n_sites, "1"),
            }
        )
        fronts = [unpack_rows(front, automaton.lattice.shape) for front in self.fronts]
        self.folder.save_figure(
            "closure", closure_figure(automaton.lattice, automaton.fillable, fronts, self.steps_of_fronts, history)
        )
        if closed is None:
            return f"The wound was still open after {last} steps: {n_open} of {history['n_open'][0]} sites."
        return f"The wound closed after {closed} steps."


def _how() -> str:
    if not native.is_native:
        return "The NumPy automaton did the steps."
    return f"The compiled automaton did the steps ({native.instruction_sets()[-1]}, {native.threads()} threads)."


def _row(step: int, n_cells: int, n_open: int, closed: float, n_edge: int, n_layer: int) -> dict[str, float | int]:
    return {
        "step": step,
        "n_cells": n_cells,
        "n_open": n_open,
        "closed_fraction": closed,
        "n_edge_divisions": n_edge,
        "n_layer_divisions": n_layer,
    }
