"""The benchmarks by name: each gives its measurements, ceiling and peers included."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from pathlib import Path

import numpy as np

import cicatrix

from ..files.atomic import write_bytes
from ..kinds.registry import demo_case
from ..runs.checkpoints import load_checkpoint, npz_bytes, save_checkpoint
from ..runs.progress import Progress
from .measurement import Measurement, best_of


def checkpoint() -> list[Measurement]:
    """Save and load the state of a 10^6-site lattice and a 20 000-node body; ceiling: writing the same bytes."""
    rng = np.random.Generator(np.random.Philox(1))
    arrays = {"occupancy": rng.random((1000, 1000)) < 0.5, "displacement_mm": rng.random((20_000, 2))}
    content = npz_bytes(arrays)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write = best_of(lambda: write_bytes(folder / "raw", content))
        save = best_of(lambda: save_checkpoint(folder, 1, arrays))
        load = best_of(lambda: load_checkpoint(folder))
    return [
        Measurement("write the bytes alone", write, "s", "ceiling"),
        Measurement("save a checkpoint", save, "s"),
        Measurement("load a checkpoint", load, "s"),
        Measurement("size", len(content) * 1e-6, "MB"),
    ]


def road2d() -> list[Measurement]:
    """The demo's road from image to healed shape: seconds per stage, Newton iterations, kernels compiled on the way."""
    progress = Progress()
    start = time.perf_counter()
    results = cicatrix.simulate(demo_case(), progress=progress)
    total = time.perf_counter() - start
    rows = [Measurement(name, spent.wall, "s", f"{spent.cpu:.1f} s of CPU") for name, spent in progress.seconds.items()]
    cycles = len(results.history["cycle"]) - 1
    iterations = int(results.history["newton_iterations"].sum())
    return [
        *rows,
        Measurement("whole road", total, "s", "compilation included"),
        Measurement("healing cycles", cycles, "1"),
        Measurement("Newton iterations in the cycles", iterations, "1"),
        Measurement("compiled kernel variants", import_module("cicatrix.mechanics.body").compiled_variants(), "1"),
    ]


def automaton() -> Iterator[Measurement]:
    """The automaton: cycles and closure on 10^6 to 10^8 sites, next to twin, dense stencil, Mesa and ceilings."""
    return import_module(".automaton", __package__).automaton()


def mechanics() -> Iterator[Measurement]:
    """Equilibrium of a half-ellipsoid breast at three sizes, next to CalculiX."""
    return import_module(".mechanics", __package__).mechanics()


def laws() -> Iterator[Measurement]:
    """Stress and tangent of every law per point, on one core, next to NumPy and jaxmat."""
    return import_module(".laws", __package__).laws()


def cells() -> Iterator[Measurement]:
    """Adhesion at 10^6 substrates, bonds at random, and networks of 100 species, next to SciPy and libroadrunner."""
    yield from import_module(".cells", __package__).cells()
    yield from import_module(".networks", __package__).networks()


def wound() -> Iterator[Measurement]:
    """A round wound by fields over two weeks: steps, factors, seconds and error, next to plain implicit Euler steps."""
    return import_module(".wound", __package__).wound()


BENCHMARKS: dict[str, Callable[[], Iterable[Measurement]]] = {
    "checkpoint": checkpoint,
    "road2d": road2d,
    "automaton": automaton,
    "mechanics": mechanics,
    "laws": laws,
    "cells": cells,
    "wound": wound,
}
