"""Progress of a long computation: named stages, the fraction done, and the seconds that each took."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass
class Seconds:
    """Time spent in a stage [s]: wall-clock time, and processor time of all threads of this process."""

    wall: float = 0.0
    cpu: float = 0.0


class Progress:
    """Timer of stages without output; a display overrides ``begin``, ``update`` and ``end``.

    Attributes
    ----------
    seconds : dict of str to Seconds
        Time per stage, in the order of first use; times of a stage that is entered again add up.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, Seconds] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the time of a block, also if it raises; a nested stage also counts for the stage around it."""
        self.begin(name)
        spent = self.seconds.setdefault(name, Seconds())
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            spent.wall += time.perf_counter() - wall
            spent.cpu += time.process_time() - cpu
            self.end(name)

    def begin(self, name: str) -> None:
        """Handle the start of a stage; does nothing here."""

    def update(self, fraction: float | None, text: str = "") -> None:
        """Handle the fraction done of the innermost stage, 0 to 1 (None: unchanged), and a text; does nothing here."""

    def end(self, name: str) -> None:
        """Handle the end of a stage; does nothing here."""

    def close(self) -> None:
        """Restore the terminal; does nothing here."""
