"""Benchmark of the continuum wound model, compared with implicit Euler steps: circular wound, 40 x 40 elements, two weeks.

All times are CPU seconds on one core, without compilation.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator

from ..core.units import seconds_from_hours
from ..healing.continuum import IntegratorState, Tolerance
from ..kinds.wound.build import WoundModel, model_of
from ..kinds.wound.case import WoundCase
from ..numerics.bdf import LONGEST_RISE
from .measurement import Measurement, printed_on_one_core

END = seconds_from_hours(336.0)
PUBLISHED = "published C++ on its authors' machine: 88 s at dt = 1 h, 338 s at 0.25 h"
EULER_H = 4.0  # h: fixed step of implicit Euler
REFERENCE = 1e-6  # time tolerance of the reference solution


def wound() -> Iterator[Measurement]:
    """Run the benchmark in a separate process pinned to one core; yield its measurements."""
    return printed_on_one_core("-m", __name__)


def measured() -> Iterator[Measurement]:
    """Measure number of steps, factorisations of the stiffness matrix, time and error, for adaptive and for implicit Euler steps.

    The error is that of the area enclosed by the ring of tracked points.
    """
    case = WoundCase.model_validate({"benchmark": "circular-wound", "elements": 40})
    assert isinstance(case, WoundCase)
    start = time.process_time()
    _run(model_of(case), seconds_from_hours(5.0))
    yield Measurement("compilation and the first five hours", time.process_time() - start, "s")
    best = _integrated(case, Tolerance(REFERENCE, 1e-8))[1]
    for name, tolerance in (("default", Tolerance(case.solver.time_tolerance, 1e-5)), ("loose", Tolerance(1e-3, 1e-4))):
        yield from _measurements(f"second order, {name}", *_integrated(case, tolerance), best)
    yield from _measurements(f"implicit Euler, {EULER_H:g} h", *_euler(case), best)


def _integrated(case: WoundCase, tolerance: Tolerance) -> tuple[float, float, IntegratorState, WoundModel]:
    model = model_of(case)
    model.solver.tolerance = tolerance
    start = time.process_time()
    first, last = _run(model, END)
    return time.process_time() - start, model.body.size(last.now.x) / model.body.size(first.now.x), last, model


def _run(model: WoundModel, end: float) -> tuple[IntegratorState, IntegratorState]:
    first = last = model.start(36.0)
    for reached in model.solver.integrate(first, end):
        last = reached
    return first, last


def _euler(case: WoundCase) -> tuple[float, float, IntegratorState, WoundModel]:
    """Integrate the model of a case with implicit Euler steps of constant length."""
    model, step = model_of(case), seconds_from_hours(EULER_H)
    start = time.process_time()
    first = last = model.start(step)
    while last.time < END * (1.0 - 1e-9):
        alone = IntegratorState(last.past[:1], last.times[:1], step, last.n_accepted)
        last = model.solver.step(alone, END)
    return time.process_time() - start, model.body.size(last.now.x) / model.body.size(first.now.x), last, model


def _measurements(
    name: str, seconds: float, ratio: float, last: IntegratorState, model: WoundModel, best: float
) -> Iterator[Measurement]:
    yield Measurement(f"{name}: seconds", seconds, "s", f"aim 10; {PUBLISHED}")
    yield Measurement(
        f"{name}: steps",
        last.n_accepted,
        "1",
        f"{last.n_rejected} rejected; a step is at most {LONGEST_RISE:g} times the one before",
    )
    yield Measurement(f"{name}: factors", model.solver.factorizations, "1", "factorisations of the mechanics")
    yield Measurement(
        f"{name}: error", abs(ratio - best), "1", f"in the area ratio after two weeks, {ratio:.5f}; aim 1e-3"
    )


if __name__ == "__main__":
    for row in measured():
        print(json.dumps(row), flush=True)
