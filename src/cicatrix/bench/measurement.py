"""What a benchmark reports, and how it is timed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from ..core.errors import CicatrixError


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


def printed_on_one_core(*arguments: str) -> Iterator[Measurement]:
    """What Python prints with these arguments, a measurement per line, as it comes: in a process of its own that has one core.

    Raises
    ------
    CicatrixError
        If it ends otherwise than well, with its last line.
    """
    with one_core(), tempfile.TemporaryFile("w+") as told:
        with subprocess.Popen([sys.executable, *arguments], stdout=subprocess.PIPE, stderr=told, text=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                yield Measurement(*json.loads(line))
        told.seek(0)
        if process.returncode:
            raise CicatrixError(f"the benchmark ended with {told.read().strip().splitlines()[-1:]}")
