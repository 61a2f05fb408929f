"""Benchmark of a complete two-dimensional lumpectomy, the demo case."""

from __future__ import annotations

import time

import cicatrix

from ..kinds.registry import demo_case
from ..mechanics.body import compiled_variants
from ..runs.progress import Progress
from .measurement import Measurement


def road2d() -> list[Measurement]:
    """Run the demo from image to healed shape; return time per stage, Newton iterations and number of compiled kernels."""
    progress = Progress()
    start = time.perf_counter()
    results = cicatrix.simulate(demo_case(), progress=progress)
    total = time.perf_counter() - start
    rows = [Measurement(name, spent.wall, "s", f"{spent.cpu:.1f} s of CPU") for name, spent in progress.seconds.items()]
    cycles = len(results.history["cycle"]) - 1
    iterations = int(results.history["newton_iterations"].sum())
    return [
        *rows,
        Measurement("whole run", total, "s", "including compilation"),
        Measurement("healing cycles", cycles, "1"),
        Measurement("Newton iterations in the cycles", iterations, "1"),
        Measurement("compiled kernel variants", compiled_variants(), "1"),
    ]
