"""Measurements that the benchmarks report, and how they are timed."""

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
    """One result of a benchmark: its name, value and unit, and a note, such as "ceiling" for a hardware limit."""

    what: str
    value: float
    unit: str
    note: str = ""


def best_of(work: Callable[[], object], repeats: int = 5, clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the shortest time of several calls of ``work`` [s]: other load on the machine can only lengthen a time."""
    seconds = []
    for _ in range(repeats):
        start = clock()
        work()
        seconds.append(clock() - start)
    return min(seconds)


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this thread and the processes it starts to one core, if the operating system allows it."""
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
    """Run Python with the given arguments in a process pinned to one core; yield each measurement as the process prints it.

    The process prints one measurement per line, as JSON.

    Raises
    ------
    CicatrixError
        If the process fails; the message contains the last line of the process's stderr.
    """
    with one_core(), tempfile.TemporaryFile("w+") as errors:
        with subprocess.Popen(
            [sys.executable, *arguments], stdout=subprocess.PIPE, stderr=errors, text=True
        ) as process:
            assert process.stdout is not None
            for line in process.stdout:
                yield Measurement(*json.loads(line))
        errors.seek(0)
        if process.returncode:
            raise CicatrixError(f"the benchmark failed with {errors.read().strip().splitlines()[-1:]}")
