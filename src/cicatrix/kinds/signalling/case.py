"""What a case of kind "signalling" says: plain data."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from ...cases.bounds import OUT_OF_RANGE, Integer, NotNegative, Number, Positive, fault, limits
from ...cases.networks import NetworkTable
from ...cases.table import Case, Table

MOST_ROWS = 1_000_000


def _rising(times: tuple[float, ...]) -> tuple[float, ...]:
    if not times or any(later <= earlier for earlier, later in pairwise(times)):
        raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": "must be one time at least, and ascend"})
    return times


class Schedule(Table):
    """Values of an input, each from its time on; before the first time the network's own value holds."""

    time_h: Annotated[tuple[NotNegative, ...], AfterValidator(_rising)]
    value: tuple[Number, ...]

    @model_validator(mode="after")
    def _as_many(self) -> Schedule:
        if len(self.value) != len(self.time_h):
            raise fault("value", f"must have as many values as time_h ({len(self.time_h)}); got {len(self.value)}")
        return self


def _held(value: Any) -> Any:
    """A number alone holds all the time."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return {"time_h": (0.0,), "value": (value,)}
    if isinstance(value, (dict, Schedule)):
        return value
    raise PydanticCustomError(
        OUT_OF_RANGE, "{words}", {"words": "must be a number, or a table of time_h and value, both lists"}
    )


class TimeTable(Table):
    """How long, and when to write a row."""

    duration_h: Positive = 48.0
    step_h: Positive = 0.5

    @model_validator(mode="after")
    def _not_too_many(self) -> TimeTable:
        if self.duration_h / self.step_h > MOST_ROWS:
            raise fault("step_h", f"must be at least duration_h / {MOST_ROWS:g}; got {self.step_h:g}")
        return self


class SteadyTable(Table):
    """Steady states under the last inputs, from the network's own start, from all low, all high, and from a Latin hypercube."""

    starts: Annotated[Integer, limits(least=0, most=100_000)] | None = None  # of the hypercube; left out: 30, of SBML 0
    longest_h: Positive | None = None  # left out: 100 times the slowest time; of SBML 100 times time.duration_h
    over: str | None = None  # an input that is given each of some values
    values: tuple[Number, ...] = ()

    @model_validator(mode="after")
    def _belong_together(self) -> SteadyTable:
        if (self.over is None) != (not self.values):
            raise fault("values", "and over belong together: an input, and the values that it is given")
        return self


class SensitivityTable(Table):
    """Derivatives by every parameter."""

    outputs: tuple[str, ...] = ()  # species; none said: all of them
    at: Literal["steady", "end", "both", "none"] = "steady"


class SolverTable(Table):
    """How exactly the courses are followed."""

    method: Literal["implicit", "explicit"] = "implicit"
    relative_tolerance: Annotated[Number, limits(least=1e-12, most=1e-2)] = 1e-6
    absolute_tolerance: Annotated[Number, limits(least=1e-16, most=1.0)] = 1e-9
    max_steps: Annotated[Integer, limits(least=10, most=100_000_000)] = 100_000  # between two changes of inputs


class RunTable(Table):
    """Seed of the starts."""

    seed: Annotated[Integer, limits(least=0, below=2**63)] = 1


class SignallingCase(Case):
    """A signalling network by itself: over time, at rest, and what it owes to its parameters."""

    files: ClassVar[tuple[str, ...]] = ("network.species", "network.reactions", "network.sbml")
    kind: Literal["signalling"] = "signalling"
    network: NetworkTable
    set: dict[str, Annotated[Schedule, BeforeValidator(_held)]] = Field(default_factory=dict)
    time: TimeTable = TimeTable()
    steady: SteadyTable = SteadyTable()
    sensitivity: SensitivityTable = SensitivityTable()
    solver: SolverTable = SolverTable()
    run: RunTable = RunTable()

    @property
    def seed(self) -> int:
        """Of the starts."""
        return self.run.seed
