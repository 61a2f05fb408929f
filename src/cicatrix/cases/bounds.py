"""Checked number types of case files: a number that is out of range is refused with a sentence.

The sentence is only its second half ("must be at least 0 and below 0.5"); whoever reports it puts the key before
it and the value after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Annotated

from pydantic import AfterValidator, Strict
from pydantic_core import PydanticCustomError

OUT_OF_RANGE = "out_of_range"  # the reporter adds the key and the value
FAULT = "fault"  # a whole sentence about the key in the context


def fault(key: str, sentence: str) -> PydanticCustomError:
    """Make the error of a rule that ties several keys: ``key`` is the one to change, relative to its table."""
    return PydanticCustomError(FAULT, "{sentence}", {"key": key, "sentence": sentence})


def _words(least: float | None, most: float | None, above: float | None, below: float | None) -> str:
    bounds = (("at least", least), ("above", above), ("at most", most), ("below", below))
    return "must be " + (" and ".join(f"{word} {value:g}" for word, value in bounds if value is not None))


def limits(
    *, least: float | None = None, most: float | None = None, above: float | None = None, below: float | None = None
) -> AfterValidator:
    """Bounds of a number, closed (``least``, ``most``) or open (``above``, ``below``); infinity and NaN never pass."""
    words = _words(least, most, above, below)

    def check(value: float) -> float:
        inside = (
            (least is None or value >= least)
            and (above is None or value > above)
            and (most is None or value <= most)
            and (below is None or value < below)
        )
        if not inside:
            raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": words})
        return _finite(value)

    return AfterValidator(check)


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": "must be a finite number"})
    return value


def _has_length(n: int) -> Callable[[tuple[float, ...]], tuple[float, ...]]:
    def check(values: tuple[float, ...]) -> tuple[float, ...]:
        if len(values) != n:
            raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": f"must be a list of {n} numbers"})
        return values

    return check


def _ascending(values: tuple[float, ...]) -> tuple[float, ...]:
    if any(later <= earlier for earlier, later in pairwise(values)):
        raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": "must ascend"})
    return values


def _rising(times: tuple[float, ...]) -> tuple[float, ...]:
    if len(times) < 2 or any(later <= earlier for earlier, later in pairwise(times)):
        raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": "must be at least two times that ascend"})
    return times


Number = Annotated[float, Strict(), AfterValidator(_finite)]
Positive = Annotated[float, Strict(), limits(above=0.0)]
NotNegative = Annotated[float, Strict(), limits(least=0.0)]
Probability = Annotated[float, Strict(), limits(least=0.0, most=1.0)]
PoissonRatio = Annotated[float, Strict(), limits(least=0.0, below=0.5)]
Integer = Annotated[int, Strict()]
Vector = Annotated[tuple[Number, ...], AfterValidator(_has_length(3))]
Ascending = Annotated[tuple[Positive, ...], AfterValidator(_ascending)]
Times = Annotated[tuple[Number, ...], AfterValidator(_rising)]
