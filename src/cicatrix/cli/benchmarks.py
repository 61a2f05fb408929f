"""The benchmarks by name: each returns its measurements, ceiling and peers included."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..io.atomic import write_bytes
from ..io.checkpoints import load_checkpoint, npz_bytes, save_checkpoint


class Measurement(NamedTuple):
    """One number of a benchmark: what, how much, in which unit, and a note such as "ceiling"."""

    what: str
    value: float
    unit: str
    note: str = ""


def checkpoint() -> list[Measurement]:
    """Save and load the state of a 10^6-site lattice and a 20 000-node body; ceiling: writing the same bytes."""
    rng = np.random.Generator(np.random.Philox(1))
    arrays = {"occupancy": rng.random((1000, 1000)) < 0.5, "displacement_mm": rng.random((20_000, 2))}
    content = npz_bytes(arrays)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write = _best(lambda: write_bytes(folder / "raw", content))
        save = _best(lambda: save_checkpoint(folder, 1, arrays))
        load = _best(lambda: load_checkpoint(folder))
    return [
        Measurement("write the bytes alone", write, "s", "ceiling"),
        Measurement("save a checkpoint", save, "s"),
        Measurement("load a checkpoint", load, "s"),
        Measurement("size", len(content) * 1e-6, "MB"),
    ]


def _best(work: Callable[[], object], repeats: int = 5) -> float:
    """Least seconds of some repeats: what else the machine does only adds."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


BENCHMARKS: dict[str, Callable[[], list[Measurement]]] = {"checkpoint": checkpoint}
