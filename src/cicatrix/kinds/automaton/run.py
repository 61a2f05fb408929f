"""Wound healing without mechanics: the automaton from a fresh wound to closure, on one process or on several MPI ranks."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...core import native
from ...core.errors import InputError, InvariantError
from ...core.posix_signals import deferred_signals
from ...core.ranks import Ranks
from ...healing.automaton import Automaton, AutomatonState, NativeCore, pack_rows, unpack_rows
from ...healing.reference import ReferenceCore
from ...runs.kind import Context, Drawing, End, Packed, Row, Simulation
from ...runs.quantity import Quantity
from .build import automaton_of, cue_of
from .case import AutomatonCase
from .figures import closure_figure

FRONTS_EVERY = 0.1  # fraction of the wound that closes between two fronts of the figure


class ClosureState(NamedTuple):
    """Cells after a step. They stay in the core that computes the steps until ``occupancy`` copies them."""

    step: int
    n_cells: int
    n_edge: int
    n_layer: int
    occupancy: Callable[[], np.ndarray]
    """Returns the sites that hold a cell, bool array of the lattice's shape; InvariantError once the core is a step ahead."""
    fronts: tuple[np.ndarray, ...]
    """Occupancies as rows of bits, one for every tenth of the wound that closed."""
    steps_of_fronts: tuple[int, ...]
    n_shared: int = 0
    """Number of steps whose work several ranks shared."""
    is_current: Callable[[], bool] = lambda: True
    """Returns whether the core has not gone beyond this step."""


class AutomatonRun(Simulation[ClosureState]):
    """Integrates the cellular automaton under a constant cue."""

    building, marching, on_ranks = "lattice", "heal", True

    def __init__(self, case: AutomatonCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        self.ranks = self.context.ranks
        self.automaton, self.cue = self.ranks.agree(lambda: model_of(case))
        self.n_fillable = int(np.count_nonzero(self.automaton.fillable))
        self.n_open0 = int(np.count_nonzero(self.automaton.open0))
        self.notes.append(_how(self.ranks))

    def start(self) -> ClosureState:
        """Return the fresh wound."""
        first = self.automaton.initial_state()
        return ClosureState(0, first.n_cells, 0, 0, lambda: first.occupancy, (pack_rows(first.occupancy),), (0,))

    def march(self, state: ClosureState) -> Iterator[ClosureState]:
        """Yield the cells after every step, until the wound is closed or the last step is done."""
        core = self.ranks.agree(lambda: _core(self.case, self.automaton, self._cells(state), self.ranks))
        while self._n_open(state) and core.step < self.case.run.max_steps:
            try:
                with deferred_signals():  # so that the step and its state are whole
                    core.advance(1, *self.cue)
                    state = self._after(core, state)
            except KeyboardInterrupt:
                if core.step > state.step:
                    state = self._after(core, state)
                yield state
                raise
            yield state
        if self.ranks.size > 1:
            self.notes.append(
                f"Several ranks shared {state.n_shared} steps; the others were too short to be worth sharing."
            )

    def _cells(self, state: ClosureState) -> AutomatonState:
        return AutomatonState(state.occupancy(), state.step)

    def _after(self, core: NativeCore | ReferenceCore, before: ClosureState) -> ClosureState:
        n_edge, n_layer, _, _, n_cells = core.last
        fronts, steps = before.fronts, before.steps_of_fronts
        n_open = self.n_fillable - n_cells
        if n_open and self._closed(n_open) >= len(fronts) * FRONTS_EVERY:
            fronts, steps = (*fronts, pack_rows(core.occupancy())), (*steps, core.step)
        step, n_shared = core.step, before.n_shared + (core.ranks_of_last_step > 1)

        def occupancy() -> np.ndarray:
            if core.step != step:
                raise InvariantError(f"the cells of step {step} are gone: step {core.step} was computed since")
            return core.occupancy()

        is_current = partial(_is_at, core, step)
        return ClosureState(step, n_cells, n_edge, n_layer, occupancy, fronts, steps, n_shared, is_current)

    def _n_open(self, state: ClosureState) -> int:
        return self.n_fillable - state.n_cells

    def _closed(self, n_open: int) -> float:
        return 1.0 - n_open / self.n_open0

    def rows(self, state: ClosureState) -> Iterator[Row]:
        """Return the numbers of cells, open sites and divisions after a step, as one row of the history."""
        n_open = self._n_open(state)
        yield {
            "step": state.step,
            "n_cells": state.n_cells,
            "n_open": n_open,
            "closed_fraction": self._closed(n_open) if state.step else 0.0,
            "n_edge_divisions": state.n_edge,
            "n_layer_divisions": state.n_layer,
        }

    def is_mark(self, state: ClosureState) -> bool:
        """Return whether the cells of this step are still there."""
        return state.is_current()

    def pack(self, state: ClosureState) -> Packed:
        """Return the occupancy, and the fronts for the figure."""
        counts = {"n_cells": state.n_cells, "n_edge": state.n_edge, "n_layer": state.n_layer}
        scalars = {"step": state.step, "steps_of_fronts": list(state.steps_of_fronts), "n_shared": state.n_shared}
        return {"occupancy": pack_rows(state.occupancy()), "fronts": np.array(state.fronts)}, scalars | counts

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> ClosureState:
        """Return the state whose occupancy and fronts are in a checkpoint."""
        occupancy = unpack_rows(arrays["occupancy"], self.automaton.lattice.shape)
        return ClosureState(
            scalars["step"],
            scalars["n_cells"],
            scalars["n_edge"],
            scalars["n_layer"],
            lambda: occupancy,
            tuple(arrays["fronts"]),
            tuple(scalars["steps_of_fronts"]),
            scalars["n_shared"],
        )

    def done(self, state: ClosureState) -> tuple[float, str]:
        """Return the fraction of the wound that is closed, and the step."""
        return self._closed(self._n_open(state)), f"step {state.step}"

    def outcome(self, end: End[ClosureState]) -> dict[str, Quantity]:
        """Return the steps to closure, and the hash of the last occupancy."""
        n_open, last = self._n_open(end.state), end.state.step
        bits = np.packbits(end.state.occupancy()).tobytes()
        closure = Quantity(None, "1", f"{n_open} sites still open") if n_open else Quantity(last, "1")
        return {
            "steps_to_closure": closure,
            "occupancy_sha256": Quantity(hashlib.sha256(bits).hexdigest(), "", "bits of the lattice in C order"),
            "n_sites": Quantity(self.automaton.lattice.n_sites, "1"),
        }

    def figures(self, end: End[ClosureState]) -> Mapping[str, Drawing]:
        """Return the function that draws the fronts of the wound, and its closure over time."""
        return {"closure": partial(self._closure, end)}

    def _closure(self, end: End[ClosureState]) -> Any:
        lattice, fillable = self.automaton.lattice, self.automaton.fillable
        fronts = [unpack_rows(front, lattice.shape) for front in end.state.fronts]
        return closure_figure(lattice, fillable, fronts, list(end.state.steps_of_fronts), end.history)

    def sentence(self, end: End[ClosureState]) -> str:
        """Return a sentence on when the wound closed, or which fraction is still open."""
        n_open, last = self._n_open(end.state), end.state.step
        if n_open:
            return f"The wound was still open after {last} steps: {n_open} of {end.history['n_open'][0]} sites."
        return f"The wound closed after {last} steps."


def _is_at(core: NativeCore | ReferenceCore, step: int) -> bool:
    return core.step == step


def model_of(case: AutomatonCase) -> tuple[Automaton, tuple[np.ndarray, float]]:
    """Build the automaton of a case, and its checked cue; InputError as :func:`.build.automaton_of` and ``cue_of``."""
    with _in_memory(case):
        automaton = automaton_of(case)
        return automaton, automaton.checked(cue_of(case))


def _core(case: AutomatonCase, automaton: Automaton, state: AutomatonState, ranks: Ranks) -> NativeCore | ReferenceCore:
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
