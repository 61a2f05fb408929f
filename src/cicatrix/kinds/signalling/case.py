"""Tables of a case of kind "signalling": plain data."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from ...cases.bounds import OUT_OF_RANGE, Integer, NotNegative, Number, Positive, Rule, bounds, fault
from ...cases.networks import NetworkTable
from ...cases.table import Case, Table

MAX_ROWS = 1_000_000  # largest number of rows of the history


def _ascend(times: tuple[float, ...]) -> bool:
    return bool(times) and all(earlier < later for earlier, later in pairwise(times))


ASCENDING = Rule("must be at least one time, ascending", _ascend)


class Schedule(Table):
    """Piecewise constant input: each value applies from its time on, and the network's own value before the first time."""

    time_h: Annotated[tuple[NotNegative, ...], AfterValidator(ASCENDING)]  # times of change, ascending
    value: tuple[Number, ...]  # value from each of these times on

    @model_validator(mode="after")
    def _as_many(self) -> Schedule:
        if len(self.value) != len(self.time_h):
            raise fault("value", f"must have as many values as time_h ({len(self.time_h)}); got {len(self.value)}")
        return self


def _held(value: Any) -> Any:
    """Turn a single number into a schedule that is constant in time."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return {"time_h": (0.0,), "value": (value,)}
    if isinstance(value, (dict, Schedule)):
        return value
    raise PydanticCustomError(
        OUT_OF_RANGE, "{words}", {"words": "must be a number, or a table of time_h and value, both lists"}
    )


class TimeTable(Table):
    """Duration of the time course, and time between rows."""

    duration_h: Positive = 48.0  # simulated time
    step_h: Positive = 0.5  # time between two rows of the history

    @model_validator(mode="after")
    def _not_too_many(self) -> TimeTable:
        if self.duration_h / self.step_h > MAX_ROWS:
            raise fault("step_h", f"must be at least duration_h / {MAX_ROWS:g}; got {self.step_h:g}")
        return self


class SteadyTable(Table):
    """Search for steady states with inputs at their values at the end of the time course.

    The search starts from the network's own initial state, from all activities low, from all high, and from a Latin hypercube.
    """

    starts: Annotated[Integer, bounds(least=0, most=100_000)] | None = None  # random starts; default 30, for SBML 0
    longest_h: Positive | None = None  # longest simulated time; default: 100 slowest time constants (SBML: duration_h)
    over: str | None = None  # input that is varied: steady states are computed at each of values
    values: tuple[Number, ...] = ()  # values of the input that is varied

    @model_validator(mode="after")
    def _belong_together(self) -> SteadyTable:
        if (self.over is None) != (not self.values):
            raise fault("values", "and over belong together: over names an input, values are what it is set to")
        return self


class SensitivityTable(Table):
    """Derivatives of activities with respect to every parameter."""

    outputs: tuple[str, ...] = ()  # species whose derivatives are computed; all by default
    at: Literal["steady", "end", "both", "none"] = "steady"  # in the steady state, at the end of the course, or both


class SignallingSolverTable(Table):
    """Method and accuracy of time integration."""

    method: Literal["implicit", "explicit"] = "implicit"  # implicit for stiff networks
    relative_tolerance: Annotated[Number, bounds(least=1e-12, most=1e-2)] = 1e-6  # relative error of the species
    absolute_tolerance: Annotated[Number, bounds(least=1e-16, most=1.0)] = (
        1e-9  # absolute error over a species' magnitude
    )
    max_steps: Annotated[Integer, bounds(least=10, most=100_000_000)] = (
        100_000  # time steps between two changes of inputs
    )


class SignallingRunTable(Table):
    """Seed of the random initial states."""

    seed: Annotated[Integer, bounds(least=0, below=2**63)] = 1  # equal seeds give equal initial states


class SignallingCase(Case):
    """Time course, steady states and parameter sensitivities of a signalling network."""

    files: ClassVar[tuple[str, ...]] = ("network.species", "network.reactions", "network.sbml")
    kind: Literal["signalling"] = "signalling"  # kind of the case
    network: NetworkTable
    set: dict[str, Annotated[Schedule, BeforeValidator(_held)]] = Field(default_factory=dict)  # inputs by name
    time: TimeTable = TimeTable()
    steady: SteadyTable = SteadyTable()
    sensitivity: SensitivityTable = SensitivityTable()
    solver: SignallingSolverTable = SignallingSolverTable()
    run: SignallingRunTable = SignallingRunTable()

    @property
    def seed(self) -> int:
        """Seed of the random initial states."""
        return self.run.seed
