"""Benchmark of checkpoints: time to save and to load one, compared with writing the same number of bytes to a file."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from ..files.atomic import write_bytes
from ..runs.checkpoints import load_checkpoint, npz_bytes, save_checkpoint
from .measurement import Measurement, best_of


def checkpoint() -> list[Measurement]:
    """Measure times to save and load a checkpoint of 10^6 lattice sites and 20 000 nodes, and to write its bytes to a file."""
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
