"""Run loop of every kind of case, on one process or on several MPI ranks.

All ranks integrate the same simulation synchronously; only the first one has a folder and writes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from functools import partial
from typing import Any, NamedTuple

from ..core.errors import ConvergenceError, InputError, StorageError
from ..core.posix_signals import deferred_signals
from ..core.ranks import Ranks
from .checkpoints import Checkpoint
from .kind import Context, Drawing, End, Simulation
from .progress import Progress, Seconds
from .results import RunFolder

CHECKPOINT_SECONDS = 10.0  # wall-clock time between two checkpoints
STEPS = "steps"  # entry of the manifest's seconds: time in ``march`` alone


def drive(
    kind: type[Simulation], case: Any, folder: RunFolder | None, progress: Progress, ranks: Ranks | None = None
) -> None:
    """Build a simulation, integrate it to its end, and write its results.

    The state is saved every :data:`CHECKPOINT_SECONDS`, at the end of the integration, on Ctrl-C, and when a solve fails.

    Parameters
    ----------
    kind : type of Simulation
        What to build: the class that simulates the case, as ``Simulation.of`` returns it.
    case : Case
        What to compute.
    folder : RunFolder or None
        Where to write; None on all ranks but the first.
    progress : Progress
        Receives the progress of the stages.
    ranks : Ranks, optional
        Processes that run the simulation together; a single one by default.
    """
    ranks = ranks or Ranks()
    checkpoint = ranks.share(folder.checkpoint if folder else None)
    with progress.stage(kind.building) if kind.building else nullcontext():
        simulation = kind(case, Context(progress, ranks, checkpoint))
    writer = _Writer(simulation, folder, progress) if folder else None
    if checkpoint is None:
        ranks.agree(writer.open if writer else _nothing)
        state = ranks.agree(simulation.start)
        ranks.agree(partial(writer.record, state) if writer else _nothing)
    else:
        state = ranks.agree(partial(_unpacked, simulation, checkpoint))
        if writer:
            writer.go_on(state)
    with progress.stage(kind.marching):
        state = _march(simulation, state, writer, ranks)
    if writer:
        writer.close(state)


def _unpacked(simulation: Simulation, checkpoint: Checkpoint) -> Any:
    try:
        return simulation.unpack(checkpoint.arrays, checkpoint.scalars)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"the checkpoint of cycle {checkpoint.cycle} holds no state of this case ({error}); start without --resume"
        ) from error


def _march(simulation: Simulation, state: Any, writer: _Writer | None, ranks: Ranks) -> Any:
    """Integrate to the end, record every state, and return the last one."""
    states = simulation.march(state)
    try:
        for state in _together(writer.timed(states) if writer else states, ranks):
            ranks.agree(partial(writer.take, state) if writer else _nothing)
    except (KeyboardInterrupt, ConvergenceError):
        if writer:
            with deferred_signals():
                writer.record(state)  # unless that was done before the interruption
                writer.save()
        raise
    if writer:
        writer.save()
    return state


def _together(states: Iterator[Any], ranks: Ranks) -> Iterator[Any]:
    """Yield states on all ranks in step, until the integration ends or the first rank is interrupted."""
    while True:
        if ranks.share(ranks.is_interrupted):
            raise KeyboardInterrupt
        try:
            state = next(states)
        except StopIteration:
            return
        yield state


def _nothing() -> None:
    """Do nothing; called by the other ranks while the first one writes, so that an error in writing is raised on all."""


class _Mark(NamedTuple):
    """A state from which a run can be resumed."""

    state: Any
    number: int
    """Number of the last row."""
    content: Mapping[str, Any]
    """What the run's folder held of history and fields."""


class _Writer:
    """Writes a simulation's states into a run's folder: rows, fields, notes, checkpoints, and results at the end."""

    def __init__(self, simulation: Simulation, folder: RunFolder, progress: Progress) -> None:
        self.simulation, self.folder, self.progress = simulation, folder, progress
        self._recorded: Any = None  # the last state whose rows are written
        self._mark: _Mark | None = None  # the last one, if it is later than the checkpoint
        self._number = folder.checkpoint.cycle if folder.checkpoint else None  # number of the last row
        self._saved_at = time.perf_counter()
        self._steps = progress.seconds.setdefault(STEPS, Seconds())
        self._note()

    def open(self) -> None:
        """Write image volumes, values that the model has determined, and the first figures, before the integration."""
        for name, volume in self.simulation.volumes().items():
            self.folder.save_volume(name, volume)
        if found := self.simulation.found():
            self.folder.found(**found)
        self._draw(self.simulation.first_figures())

    def go_on(self, state: Any) -> None:
        """Resume from a state whose rows and checkpoint were written in an earlier session."""
        self._recorded = state

    def timed(self, states: Iterator[Any]) -> Iterator[Any]:
        """Yield states, and add up the time that computing them takes."""
        while True:
            wall, cpu = time.perf_counter(), time.process_time()
            try:
                state = next(states)
            except StopIteration:
                return
            finally:
                self._steps.wall += time.perf_counter() - wall
                self._steps.cpu += time.process_time() - cpu
            yield state

    def take(self, state: Any) -> None:
        """Record a state that the integration yielded, and report the progress."""
        self.record(state)
        self.progress.update(*self.simulation.done(state))

    def record(self, state: Any) -> None:
        """Write the rows and fields of a state if not yet written, and a checkpoint if one is due."""
        if state is self._recorded:
            return
        with deferred_signals():
            for row in self.simulation.rows(state):
                self.folder.record(row)
                self._number = next(iter(row.values()))
            for fields in self.simulation.fields(state):
                self.folder.write_fields(fields)
            self._note()
            self._recorded = state
            if self._number is not None and self.simulation.is_mark(state):
                self._mark = _Mark(state, self._number, self.folder.content())
            if time.perf_counter() - self._saved_at > CHECKPOINT_SECONDS:
                self.save()

    def save(self) -> None:
        """Write a checkpoint of the last state from which a run can be resumed, unless it is saved already."""
        mark = self._mark
        if mark is None:
            return
        if not self.simulation.is_mark(mark.state):  # interrupted after a step and before its state came
            return
        self.folder.save_checkpoint(mark.number, *self.simulation.pack(mark.state), mark.content)
        self._mark, self._saved_at = None, time.perf_counter()

    def close(self, state: Any) -> None:
        """Write outcome, tables and surfaces, then the figures; a figure that cannot be drawn is noted and left out."""
        analysis = self.simulation.analyse(state)
        with self.progress.stage("outcome"):
            end = End(state, self.folder.history(), analysis)
            for fields in self.simulation.last_fields(end):
                self.folder.write_fields(fields)
            self.folder.write_outcome(self.simulation.outcome(end))
            for name, table in self.simulation.tables(end).items():
                self.folder.write_table(name, table.head, table.rows)
            for name, surface in self.simulation.surfaces(end).items():
                self.folder.write_surface(name, surface.points, surface.faces, surface.point_data)
            self._draw(self.simulation.figures(end))
            sentence = self.simulation.sentence(end)
            self._note()
            self.folder.finish(sentence)

    def _draw(self, figures: Any) -> None:
        draw: Drawing
        for name, draw in figures.items():
            try:
                self.folder.save_figure(name, draw())
            except StorageError:
                raise
            except Exception as error:
                self.folder.note(f"The figure {name} could not be drawn: {type(error).__name__}: {error}")

    def _note(self) -> None:
        for sentence in self.simulation.notes:
            self.folder.note(sentence)
        self.simulation.notes.clear()
