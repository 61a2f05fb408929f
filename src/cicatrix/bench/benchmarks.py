"""Registry of the benchmarks by name; a benchmark is imported only when it runs, so that ``cicatrix --help`` imports none."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module

from .measurement import Measurement

# name on the command line -> modules of this folder; in each module the function of the same name yields the measurements,
# including hardware limits and other programs
BENCHMARKS: dict[str, tuple[str, ...]] = {
    "checkpoint": ("checkpoint",),
    "road2d": ("road2d",),
    "automaton": ("automaton",),
    "mechanics": ("mechanics",),
    "laws": ("laws",),
    "cells": ("cells", "networks"),
    "wound": ("wound",),
    "start": ("start",),
}


def measurements(name: str) -> Iterator[Measurement]:
    """Run the benchmark of the given name; yield each measurement as soon as it is made."""
    for module in BENCHMARKS[name]:
        yield from getattr(import_module(f".{module}", __package__), module)()
