"""Checked number types of case files: a number that is out of range is refused with a sentence.

A type gives only the middle of the sentence ("must be at least 0 and below 0.5"); the code that reports it puts the key before
it and the value after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

from pydantic import AfterValidator, Strict
from pydantic_core import PydanticCustomError

OUT_OF_RANGE = "out_of_range"  # error of one value: the reporter adds the key and the value
FAULT = "fault"  # error of several keys: its context has the key to change and a sentence about it


def fault(key: str, sentence: str) -> PydanticCustomError:
    """Return the error for a rule that several keys violate together; ``key`` is the key to change, relative to its table."""
    return PydanticCustomError(FAULT, "{sentence}", {"key": key, "sentence": sentence})


@dataclass(frozen=True)
class Rule:
    """A condition on a value, and the words of the sentence that refuses another value ("must be above 0")."""

    words: str
    holds: Callable[[Any], bool]

    def __call__(self, value: Any) -> Any:
        """Return the value if it meets the condition, else raise an error."""
        if not self.holds(value):
            raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": self.words})
        return value


def _words(least: float | None, most: float | None, above: float | None, below: float | None) -> str:
    pairs = (("at least", least), ("above", above), ("at most", most), ("below", below))
    return "must be " + (" and ".join(f"{word} {value:g}" for word, value in pairs if value is not None))


def bounds(
    *, least: float | None = None, most: float | None = None, above: float | None = None, below: float | None = None
) -> AfterValidator:
    """Make a check of a number's bounds, closed (``least``, ``most``) or open (``above``, ``below``); NaN meets none of them."""

    def is_inside(value: float) -> bool:
        return (
            (least is None or value >= least)
            and (above is None or value > above)
            and (most is None or value <= most)
            and (below is None or value < below)
        )

    return AfterValidator(Rule(_words(least, most, above, below), is_inside))


def _ascend(values: tuple[float, ...]) -> bool:
    return all(earlier < later for earlier, later in pairwise(values))


FINITE = AfterValidator(Rule("must be a finite number", math.isfinite))
Number = Annotated[float, Strict(), FINITE]
Positive = Annotated[float, Strict(), bounds(above=0.0), FINITE]
NotNegative = Annotated[float, Strict(), bounds(least=0.0), FINITE]
Probability = Annotated[float, Strict(), bounds(least=0.0, most=1.0), FINITE]
PoissonRatio = Annotated[float, Strict(), bounds(least=0.0, below=0.5), FINITE]
Integer = Annotated[int, Strict()]
Vector = Annotated[tuple[Number, ...], AfterValidator(Rule("must be a list of 3 numbers", lambda v: len(v) == 3))]
Ascending = Annotated[tuple[Positive, ...], AfterValidator(Rule("must ascend", _ascend))]
Times = Annotated[
    tuple[Number, ...],
    AfterValidator(Rule("must be at least two times that ascend", lambda times: len(times) >= 2 and _ascend(times))),
]
