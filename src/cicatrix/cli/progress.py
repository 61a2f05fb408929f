"""Progress display on stderr: bars on a terminal, plain lines when the output is piped to a file."""

from __future__ import annotations

import sys
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from ..runs.progress import Progress

STEP = 0.1  # fraction of a stage between two plain lines


class PlainProgress(Progress):
    """Progress in plain lines: one when a stage starts, one per tenth of it, and one with its time when it ends."""

    def __init__(self, stream: TextIO):
        super().__init__()
        self._stream = stream
        self._stages: list[tuple[str, float]] = []  # name and the fraction last printed

    def begin(self, name: str) -> None:
        """Print the name of a stage that starts."""
        self._stages.append((name, 0.0))
        self._print(f"{name} ...")

    def update(self, fraction: float | None, text: str = "") -> None:
        """Print the fraction done if it has grown by a tenth since the last line."""
        if not self._stages or fraction is None:
            return
        name, printed = self._stages[-1]
        if fraction >= printed + STEP:
            self._stages[-1] = (name, fraction)
            self._print(f"{name}: {fraction:.0%} {text}".rstrip())

    def end(self, name: str) -> None:
        """Print the total time of the stage; repeated stages are summed."""
        self._stages.pop()
        self._print(f"{name}: {self.seconds[name].wall:.1f} s")

    def _print(self, line: str) -> None:
        print(line, file=self._stream, flush=True)


class BarProgress(Progress):
    """Progress as one live bar per stage."""

    def __init__(self, console: Console):
        super().__init__()
        columns = (TextColumn("{task.description:<24}"), BarColumn(), TextColumn("{task.fields[word]}"))
        self._bars = Bars(*columns, TimeElapsedColumn(), console=console)
        self._tasks: dict[str, TaskID] = {}
        self._open: list[str] = []
        self._bars.start()

    def begin(self, name: str) -> None:
        """Show the stage's bar."""
        if name not in self._tasks:
            self._tasks[name] = self._bars.add_task(name, total=None, word="")
        self._open.append(name)

    def update(self, fraction: float | None, text: str = "") -> None:
        """Update the bar of the innermost stage."""
        if self._open:
            total = None if fraction is None else 1.0
            self._bars.update(self._tasks[self._open[-1]], total=total, completed=fraction, word=text)

    def end(self, name: str) -> None:
        """Show the stage's bar as complete."""
        self._open.pop()
        self._bars.update(self._tasks[name], total=1.0, completed=1.0)

    def close(self) -> None:
        """Stop updating the bars and release the terminal."""
        self._bars.stop()


def make_progress(stream: TextIO | None = None) -> PlainProgress | BarProgress:
    """Return bars if the stream (default: stderr) is a terminal, plain lines otherwise."""
    target: TextIO = sys.stderr if stream is None else stream
    return BarProgress(Console(file=target)) if target.isatty() else PlainProgress(target)
