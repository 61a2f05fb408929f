"""The benchmark of wounds by fields: the round wound on 40 x 40 elements over two weeks, next to plain implicit Euler steps.

Seconds are those of the processor on one core, compilation apart.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator

from ..core.units import seconds_from_hours
from ..healing.continuum import Course, Tolerance
from ..kinds.wound.build import WoundModel, model_of
from ..kinds.wound.case import WoundCase
from ..numerics.bdf import LONGEST_RISE
from .measurement import Measurement, printed_on_one_core

END = seconds_from_hours(336.0)
PUBLISHED = "published C++ on its authors' machine: 88 s at dt = 1 h, 338 s at 0.25 h"
EULER_H = 4.0  # step of plain implicit Euler
REFERENCE = 1e-6  # time tolerance that stands for the truth


def wound() -> Iterator[Measurement]:
    """The round wound, in a process of its own that has one core."""
    return printed_on_one_core("-m", __name__)


def measured() -> Iterator[Measurement]:
    """Steps, factors of mechanics, seconds and error of the ring's area, adaptive and with plain implicit Euler steps."""
    case = WoundCase.model_validate({"benchmark": "circular-wound", "elements": 40})
    assert isinstance(case, WoundCase)
    start = time.process_time()
    _run(model_of(case), seconds_from_hours(5.0))
    yield Measurement("compilation and the first five hours", time.process_time() - start, "s")
    best = _followed(case, Tolerance(REFERENCE, 1e-8))[1]
    for name, tolerance in (("default", Tolerance(case.solver.time_tolerance, 1e-5)), ("loose", Tolerance(1e-3, 1e-4))):
        yield from _told(f"second order, {name}", *_followed(case, tolerance), best)
    yield from _told(f"implicit Euler, {EULER_H:g} h", *_euler(case), best)


def _followed(case: WoundCase, tolerance: Tolerance) -> tuple[float, float, Course, WoundModel]:
    model = model_of(case)
    model.solver.tolerance = tolerance
    start = time.process_time()
    first, last = _run(model, END)
    return time.process_time() - start, model.body.size(last.now.x) / model.body.size(first.now.x), last, model


def _run(model: WoundModel, end: float) -> tuple[Course, Course]:
    first = last = model.start(36.0)
    for reached in model.solver.follow(first, end):
        last = reached
    return first, last


def _euler(case: WoundCase) -> tuple[float, float, Course, WoundModel]:
    """Steps of one length, each from the state before alone."""
    model, step = model_of(case), seconds_from_hours(EULER_H)
    start = time.process_time()
    first = last = model.start(step)
    while last.time < END * (1.0 - 1e-9):
        alone = Course(last.past[:1], last.times[:1], step, last.taken)
        last = model.solver.step(alone, END)
    return time.process_time() - start, model.body.size(last.now.x) / model.body.size(first.now.x), last, model


def _told(
    name: str, seconds: float, ratio: float, last: Course, model: WoundModel, best: float
) -> Iterator[Measurement]:
    yield Measurement(f"{name}: seconds", seconds, "s", f"aim 10; {PUBLISHED}")
    yield Measurement(
        f"{name}: steps", last.taken, "1", f"{last.rejected} cut; a step rises by {LONGEST_RISE:g} at most"
    )
    yield Measurement(f"{name}: factors", model.solver.factorizations, "1", "of mechanics")
    yield Measurement(
        f"{name}: error", abs(ratio - best), "1", f"of the ring's area after two weeks, {ratio:.5f}; aim 1e-3"
    )


if __name__ == "__main__":
    for row in measured():
        print(json.dumps(row), flush=True)
