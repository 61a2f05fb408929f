"""What a benchmark reports, and how it is timed."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple


class Measurement(NamedTuple):
    """One number of a benchmark: what, how much, in which unit, and a note such as "ceiling"."""

    what: str
    value: float
    unit: str
    note: str = ""


def best_of(work: Callable[[], object], repeats: int = 5, clock: Callable[[], float] = time.perf_counter) -> float:
    """Least seconds of some repeats: what else the machine does only adds."""
    seconds = []
    for _ in range(repeats):
        start = clock()
        work()
        seconds.append(clock() - start)
    return min(seconds)


@contextmanager
def one_core() -> Iterator[None]:
    """Hold this thread, and the processes that it starts, on one core where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
