"""Healing alone: the automaton from a fresh wound to closure, step by step, by one process or by several ranks.

The first rank has the run's folder and leads; the others do its steps with it.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core import native
from ...core.errors import InputError, InvariantError
from ...core.ranks import Ranks, world
from ...healing.automaton import Automaton, AutomatonState, NativeCore, pack_rows, unpack_rows
from ...healing.twin import TwinCore
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .build import automaton_of, cue_of
from .case import AutomatonCase
from .figures import closure_figure

CHECKPOINT_SECONDS = 10.0  # between two checkpoints; one more when the run is interrupted
FRONTS_EVERY = 0.1  # of the wound closed, between two fronts of the picture


@dataclass
class AutomatonRun:
    """One run; a checkpoint holds occupancy and step, what the picture needs, and the seconds spent."""

    case: AutomatonCase
    folder: RunFolder
    progress: Progress
    ranks: Ranks = field(default_factory=world)
    fronts: list[np.ndarray] = field(default_factory=list)  # occupancies as rows of bits
    steps_of_fronts: list[int] = field(default_factory=list)
    seconds: float = 0.0
    last_row: int = 0
    n_shared: int = 0  # steps that several ranks shared
    saved: float = field(default_factory=time.perf_counter)

    def go(self) -> str:
        """Run to closure or to the last step; returns the sentence that ends the run."""
        with self.progress.stage("lattice"):
            automaton, cue = self.ranks.agree(lambda: _model(self.case))
            state = self.ranks.share(self.ranks.agree(lambda: self._start(automaton)))
            core = self.ranks.agree(lambda: _core(self.case, automaton, state, self.ranks))
            self.folder.note(_how(self.ranks))
        with self.progress.stage("heal"):
            n_open = self._heal(automaton, core, cue, state.n_cells)
        with self.progress.stage("outcome"):
            return self._finish(automaton, core, n_open)

    def _heal(
        self, automaton: Automaton, core: NativeCore | TwinCore, cue: tuple[np.ndarray, float], n_cells: int
    ) -> int:
        """Do the steps, the other ranks with them, from so many cells on; returns the sites that are open at the end."""
        n_fillable, n_open0 = int(np.count_nonzero(automaton.fillable)), int(np.count_nonzero(automaton.open0))
        n_open = n_fillable - n_cells
        try:
            while n_open and core.step < self.case.run.max_steps and not self.ranks.is_interrupted:
                self.ranks.share(True)
                n_open = self._step(core, cue, n_fillable, n_open0)
            if self.ranks.is_interrupted:
                raise KeyboardInterrupt
        except KeyboardInterrupt:
            if core.step > self.last_row:  # it came between a step and its row
                self._record(core, n_fillable, n_open0)
            self._save(core)
            raise
        finally:
            self.ranks.share(False)
        if self.ranks.size > 1:
            self.folder.note(f"Several ranks shared {self.n_shared} steps; the others were too short to be worth it.")
        return n_open

    def _step(self, core: NativeCore | TwinCore, cue: tuple[np.ndarray, float], n_fillable: int, n_open0: int) -> int:
        """Do a step and write its row; returns the sites that are open after it."""
        started = time.perf_counter()
        core.advance(1, *cue)
        self.seconds += time.perf_counter() - started
        self.n_shared += core.ranks_of_last_step > 1
        n_open, closed = self._record(core, n_fillable, n_open0)
        if time.perf_counter() - self.saved > CHECKPOINT_SECONDS:
            self._save(core)
        self.progress.update(closed, f"step {core.step}")
        return n_open

    def _record(self, core: NativeCore | TwinCore, n_fillable: int, n_open0: int) -> tuple[int, float]:
        """Write the row of the last step, and keep its front for the picture now and then."""
        n_edge, n_layer, _, _, n_cells = core.last
        n_open = n_fillable - n_cells
        closed = 1.0 - n_open / n_open0
        self.folder.record(_row(core.step, n_cells, n_open, closed, n_edge, n_layer))
        self.last_row = core.step
        if n_open and closed >= len(self.fronts) * FRONTS_EVERY:
            self.fronts.append(pack_rows(core.occupancy()))
            self.steps_of_fronts.append(core.step)
        return n_open, closed

    def _save(self, core: NativeCore | TwinCore) -> None:
        """Keep a checkpoint of the last step; its row has been written."""
        self.saved = time.perf_counter()
        arrays = {"occupancy": pack_rows(core.occupancy()), "fronts": np.array(self.fronts)}
        scalars = {"step": core.step, "steps_of_fronts": self.steps_of_fronts, "seconds": self.seconds}
        self.folder.save_checkpoint(core.step, arrays, scalars)

    def _start(self, automaton: Automaton) -> AutomatonState:
        kept = self.folder.checkpoint
        if kept is None:
            state = automaton.initial_state()
            self.fronts, self.steps_of_fronts = [pack_rows(state.occupancy)], [0]
            n_open = int(np.count_nonzero(automaton.open0))
            self.folder.record(_row(0, state.n_cells, n_open, 0.0, 0, 0))
            return state
        self.fronts, self.steps_of_fronts = list(kept.arrays["fronts"]), kept.scalars["steps_of_fronts"]
        self.seconds, self.last_row = kept.scalars["seconds"], kept.scalars["step"]
        return AutomatonState(unpack_rows(kept.arrays["occupancy"], automaton.lattice.shape), kept.scalars["step"])

    def _finish(self, automaton: Automaton, core: NativeCore | TwinCore, n_open: int) -> str:
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


def follow(case: AutomatonCase, ranks: Ranks) -> None:
    """Do the steps of the run that the first rank leads: what it asks of all, in its order."""
    automaton, cue = ranks.agree(lambda: _model(case))
    state: Any = ranks.share(ranks.agree(lambda: None))  # the first rank's
    core = ranks.agree(lambda: _core(case, automaton, state, ranks))
    try:
        while ranks.share(False):
            core.advance(1, *cue)
    except InvariantError:  # on all ranks alike: the first one, too, has this left to say
        ranks.share(False)
        raise


def _model(case: AutomatonCase) -> tuple[Automaton, tuple[np.ndarray, float]]:
    with _in_memory(case):
        automaton = automaton_of(case)
        return automaton, automaton.checked(cue_of(case))


def _core(case: AutomatonCase, automaton: Automaton, state: AutomatonState, ranks: Ranks) -> NativeCore | TwinCore:
    with _in_memory(case):
        return automaton.core(state, ranks=ranks)


@contextmanager
def _in_memory(case: AutomatonCase) -> Iterator[None]:
    try:
        yield
    except MemoryError:
        raise InputError(f"lattice.size {list(case.lattice.size)} does not fit into this machine's memory") from None


def _how(ranks: Ranks) -> str:
    together = f" on {ranks.size} ranks" if ranks.size > 1 else ""
    if not native.is_native:
        return f"The NumPy automaton did the steps{together}."
    return (
        f"The compiled automaton did the steps ({native.instruction_sets()[-1]}, {native.threads()} threads){together}."
    )


def _row(step: int, n_cells: int, n_open: int, closed: float, n_edge: int, n_layer: int) -> dict[str, float | int]:
    return {
        "step": step,
        "n_cells": n_cells,
        "n_open": n_open,
        "closed_fraction": closed,
        "n_edge_divisions": n_edge,
        "n_layer_divisions": n_layer,
    }
