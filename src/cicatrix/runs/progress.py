"""What a long computation says about itself: named stages, how far, and how many seconds each took."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass
class Seconds:
    """Time spent in a stage [s]: on the wall clock, and by all threads of this process."""

    wall: float = 0.0
    cpu: float = 0.0


class Progress:
    """Times the stages and says nothing; a display fills in ``begin``, ``update`` and ``end``.

    Attributes
    ----------
    seconds : dict of str to Seconds
        Time per stage, in the order of first use; a stage entered again adds up.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, Seconds] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a block under a name; also counted when the block raises. Nested stages each count their whole time."""
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
        """Hear that a stage starts."""

    def update(self, fraction: float | None, text: str = "") -> None:
        """Hear how much of the innermost stage is done, 0 to 1 (None: as much as before), and a word on it."""

    def end(self, name: str) -> None:
        """Hear that a stage is over."""

    def close(self) -> None:
        """Put the terminal back as it was."""
