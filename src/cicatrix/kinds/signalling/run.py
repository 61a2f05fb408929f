"""A signalling network without tissue: its time course, steady states and parameter sensitivities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ...biology.courses import integrate, results
from ...biology.culprits import fastest, not_finite
from ...biology.network_model import NetworkModel
from ...biology.roadrunner import DelegatedNetwork
from ...biology.sensitivity import INPUT, Sensitivities, of_end, of_steady_state
from ...biology.steady import SteadyStates, steady_states
from ...biology.switches import depends_on_constants
from ...core.errors import ConvergenceError
from ...core.units import hours_from_seconds, seconds_from_hours
from ...numerics.ode import Solution
from ...runs.kind import Context, Drawing, End, Packed, ResultTable, Row, Simulation
from ...runs.quantity import Quantity
from .build import (
    Chunk,
    accuracy_of,
    begun,
    chunks,
    corners,
    inputs_at,
    longest_s,
    outputs_of,
    refuse_undefined,
    refuse_unknown,
    rounded,
    scale_of,
    starts_of,
)
from .case import SignallingCase
from .delegated import DelegatedRun
from .figures import branches_figure, courses_figure, sensitivities_figure, states_figure
from .network import read_model
from .verdict import notes_of, outcomes_of, verdict_of

BEYOND_ALL = (
    1e30  # a species that would change by this multiple of its magnitude within the course is not one of nature
)

SHIFTED = "Derivatives at the end leave out that constants move the instants at which formulas switch."


class NetworkState(NamedTuple):
    """State of the network after an interval of constant inputs (chunk), with its rows; the solver restarts at each chunk."""

    chunk: int
    """Number of the next chunk."""
    row: int
    """Number of the last row."""
    y: np.ndarray
    """Activities or concentrations of the species (n_species,)."""
    n_steps: int
    """Steps of the solver so far."""
    new: tuple[tuple[int, float, np.ndarray], ...] = ()
    """Number, time [h] and values of every row of the chunk: species, and what else is shown."""
    is_whole: bool = True
    """Whether the solver reached the end of the chunk."""


class Analysis(NamedTuple):
    """Results computed from the complete time course."""

    found: dict[float | None, SteadyStates]
    """Steady states by value of the input that ``steady.over`` names; key None for the inputs at the end of the time course."""
    derivatives: dict[str, Sensitivities]
    """Sensitivities; the key names the state at which they are computed, such as "state 1" or "end"."""


class SignallingRun(Simulation[NetworkState]):
    """Integrates a network through chunks of time, then computes its steady states and sensitivities."""

    building, marching = "network", "course"

    def __init__(self, case: SignallingCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        model = read_model(case)
        refuse_unknown(case, model)
        self.model = begun(case, model)
        refuse_undefined(case, self.model)
        self.notes = list(model.notes)
        self.chunks = chunks(case, self.model)
        self.names = (*model.law.species, *model.law.shown)
        self.scale = scale_of(case, self.model, self.chunks)
        self.accuracy = accuracy_of(case, self.scale)

    @classmethod
    def of(cls, case: SignallingCase) -> type[Simulation]:
        """Return the class that simulates a case: another one, if its SBML file is beyond rate laws."""
        if case.network.sbml is None:
            return cls
        return DelegatedRun if isinstance(read_model(case).law, DelegatedNetwork) else cls

    @cached_property
    def last_inputs(self) -> np.ndarray:
        """Inputs at the end of the course (n_inputs,)."""
        return inputs_at(self.case, self.model, self.case.time.duration_h)

    def start(self) -> NetworkState:
        """Return the initial state that the network's files give."""
        first = self._results(self.model.start[None], self.chunks[0].inputs, np.zeros(1))
        return NetworkState(0, 0, self.model.start, 0, ((0, 0.0, first[0]),))

    def march(self, state: NetworkState) -> Iterator[NetworkState]:
        """Yield the network after every chunk; if a chunk fails, yield the part that was computed, then raise the error."""
        for chunk in self.chunks[state.chunk :]:
            state, failure = self._pass(chunk, state)
            yield state
            if failure is not None:
                raise failure

    def _results(self, states: np.ndarray, before: np.ndarray, times_h: np.ndarray) -> np.ndarray:
        """Return the values (n_times, n_names) of rows from the states under the inputs ``before`` the rows' times."""
        inputs = np.array([inputs_at(self.case, self.model, float(time_h)) for time_h in times_h])
        times = rounded(seconds_from_hours(times_h), 12)  # so that a formula switches at a row that the case puts there
        return np.asarray(results(self.model.law, *map(jnp.asarray, (states, before, inputs, times))))

    def _pass(self, chunk: Chunk, at: NetworkState) -> tuple[NetworkState, ConvergenceError | None]:
        times = seconds_from_hours(chunk.times_h)
        before = self.chunks[max(at.chunk - 1, 0)].inputs
        start = self.model.law.carried(*map(jnp.asarray, (at.y, before, chunk.inputs)))
        done = integrate(self.model.law, jnp.asarray(chunk.inputs), start, jnp.asarray(times), self.accuracy)
        states, n_steps = np.asarray(done.y), at.n_steps + int(done.n_steps)
        values = self._results(states, chunk.inputs, chunk.times_h)
        rows = zip(chunk.times_h[1 : chunk.n_rows + 1], values[1:])
        new = tuple(
            (number, float(time_h), y)
            for number, (time_h, y) in enumerate(rows, at.row + 1)
            if np.isfinite(y[: len(self.model.start)]).all()
        )
        failure = None if done.is_done else self._failure(chunk, done)
        return NetworkState(at.chunk + 1, at.row + chunk.n_rows, states[-1], n_steps, new, failure is None), failure

    def is_mark(self, state: NetworkState) -> bool:
        """Return whether the chunk was integrated to its end."""
        return state.is_whole

    def _failure(self, chunk: Chunk, done: Solution) -> ConvergenceError:
        states, last = np.asarray(done.y), np.asarray(done.last)
        good = np.isfinite(states).all(axis=1)
        largest = int(np.argmax(np.abs(last)))
        return ConvergenceError(
            f"The network could not be followed beyond {hours_from_seconds(float(done.reached)):.6g} h, where "
            f"{self.model.law.species[largest]} is largest, {last[largest]:.4g}: "
            f"{self._undefined_after(chunk, done) or self._too_fast(chunk, done)}.",
            [f"{t:.6g} h: largest {np.abs(y).max():g}" for t, y, ok in zip(chunk.times_h, states, good) if ok][-5:],
        )

    def _undefined_after(self, chunk: Chunk, done: Solution) -> str | None:
        """Name the formula that is not a number when or soon after the solver stopped, at the state that it reached."""
        at, end = float(done.reached), float(seconds_from_hours(self.chunks[-1].times_h[-1]))
        faults = (
            not_finite(self.model.law, chunk.inputs, np.asarray(done.last), time)
            for time in (at, at + 1e-6 * (end - at))
        )
        return next((f"{fault} from there on" for fault in faults if fault), None)

    def _too_fast(self, chunk: Chunk, done: Solution) -> str:
        taken = f"solver.max_steps = {int(done.n_steps)} were taken" if done.out_of_steps else "the solver gave up"
        hint = ' or take solver.method = "implicit"' if self.case.solver.method == "explicit" else ""
        last, at = np.asarray(done.last), float(done.reached)
        blamed, pace = fastest(self.model.law, chunk.inputs, last, at, self.scale)
        if pace * seconds_from_hours(self.case.time.duration_h) > BEYOND_ALL:
            return f"{blamed}, out of all proportion to its magnitude: check its parameters and units"
        return f"{taken}, and {blamed}; if no state grows without bound, raise solver.max_steps{hint}"

    def rows(self, state: NetworkState) -> Iterator[Row]:
        """Return the rows of the chunk: species, and the inputs that the case sets."""
        for number, time_h, y in state.new:
            inputs = dict(zip(self.model.law.input_names, inputs_at(self.case, self.model, time_h)))
            yield {
                "step": number,
                "time_h": time_h,
                **{name: float(value) for name, value in zip(self.names, y)},
                **{f"input_{name}": float(inputs[name]) for name in self.case.set},
            }

    def pack(self, state: NetworkState) -> Packed:
        """Return the species as an array, and the numbers of chunk, row and solver steps, for a checkpoint."""
        return {"y": state.y}, {"row": state.row, "chunk": state.chunk, "n_steps": state.n_steps}

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> NetworkState:
        """Return the state in a checkpoint."""
        return NetworkState(scalars["chunk"], scalars["row"], arrays["y"], scalars["n_steps"])

    def done(self, state: NetworkState) -> tuple[float, str]:
        """Return the fraction of the time intervals that is computed, and the simulated time."""
        reached = self.chunks[state.chunk - 1].times_h[-1] if state.chunk else 0.0
        return state.chunk / len(self.chunks), f"{reached:.4g} h of {self.chunks[-1].times_h[-1]:.4g} h simulated"

    def analyse(self, state: NetworkState) -> Analysis:
        """Return steady states and sensitivities."""
        with self.context.progress.stage("steady states"):
            found = self._search(state.y)
        if found:
            self.notes += notes_of(found[None], self.model)
        with self.context.progress.stage("sensitivities"):
            return Analysis(found, self._differentiate(found))

    def _search(self, end: np.ndarray) -> dict[float | None, SteadyStates]:
        """Find steady states for the inputs at the end of the course (key None) and each value of the varied input (key: value).

        ``end``, the state at the end of the course, is one of the initial states of the search.
        """
        if self.model.law.is_time_dependent:
            self.notes.append("The rates of the network depend on time, so it has no steady states.")
            return {}
        starts = np.vstack([starts_of(self.case, self.model, self.scale), end])
        waiting = longest_s(self.case, self.model)
        found = {}
        for number, (value, inputs) in enumerate(self._inputs_searched()):
            found[value] = steady_states(self.model.law, inputs, starts, waiting, self.scale, self.accuracy)
            self.context.progress.update((number + 1) / (len(self.case.steady.values) + 1), "steady states")
        return found

    def _inputs_searched(self) -> Iterator[tuple[float | None, np.ndarray]]:
        yield None, self.last_inputs
        for value in self.case.steady.values:
            inputs = self.last_inputs.copy()
            inputs[self.model.law.input_names.index(self.case.steady.over)] = value
            yield value, inputs

    def _differentiate(self, found: dict[float | None, SteadyStates]) -> dict[str, Sensitivities]:
        """Differentiate the stable steady states for the final inputs, and the final state, with respect to the parameters."""
        asked, derivatives = self.case.sensitivity.at, {}
        if asked in ("steady", "both") and found:
            for number, state in enumerate(found[None].stable, 1):
                by = of_steady_state(self.model.law, self.last_inputs, state.y, self.scale)
                if by is None:
                    self.notes.append(
                        f"Steady state {number} has no derivatives: it depends on the values of conserved quantities."
                    )
                else:
                    derivatives[f"state {number}"] = by
        if asked in ("end", "both"):
            at = corners(self.case, self.model)
            if depends_on_constants(self.model.law):
                self.notes.append(SHIFTED)
            inputs = np.array([inputs_at(self.case, self.model, float(t)) for t in at[:-1]])
            times = seconds_from_hours(at)
            derivatives["end"] = of_end(self.model.law, inputs, self.model.start, times, self.accuracy)
        return derivatives

    def outcome(self, end: End[NetworkState]) -> dict[str, Quantity]:
        """Return the species at the end, and every steady state."""
        hours = end.history["time_h"][-1]
        outcome = {"engine": Quantity("cicatrix", "", "program that integrated the network")}
        outcome["n_solver_steps"] = Quantity(end.state.n_steps, "1", "of the course")
        last = {name: float(end.history[name][-1]) for name in self.names}
        outcome["end"] = Quantity(last, "1", f"at {hours:g} h")
        self._note_coarse(end.history)
        found = end.analysis.found.get(None)
        return outcome | (outcomes_of(found, self.model, self.last_inputs) if found else {})

    def _note_coarse(self, history: Mapping[str, np.ndarray]) -> None:
        """Note the species that stay so small that their absolute tolerance is coarser than the relative one."""
        peaks = np.array([np.max(np.abs(history[name])) for name in self.model.law.species])
        asked, is_seen = self.case.solver, (peaks > 0.0) & ~np.full(len(peaks), self.model.is_normalised)
        is_coarse = asked.absolute_tolerance * self.scale > asked.relative_tolerance * peaks
        for k in np.flatnonzero(is_seen & is_coarse):
            self.notes.append(
                f'"{self.model.law.species[k]}" stays below {peaks[k]:.2g}, far below the magnitude of {self.scale[k]:.2g} that '
                f"was estimated for it: lower solver.absolute_tolerance if its digits matter."
            )

    def tables(self, end: End[NetworkState]) -> Mapping[str, ResultTable]:
        """Return steady states and sensitivities, row by row."""
        found, derivatives = end.analysis
        tables = {}
        if any(one.states for one in found.values()):
            tables["steady_states"] = ResultTable(*_states_table(found, self.model.law.species, self.case.steady.over))
        if rows := self._sensitivities(derivatives):
            head = ["at", "output", "kind", "of", "value", "derivative", "relative"]
            tables["sensitivities"] = ResultTable(head, rows)
        return tables

    def _sensitivities(self, derivatives: dict[str, Sensitivities]) -> list[list[Any]]:
        outputs = outputs_of(self.case, self.model)
        return list(_sensitivity_rows(derivatives, self.model, self.last_inputs, outputs))

    def figures(self, end: End[NetworkState]) -> Mapping[str, Drawing]:
        """Return the functions that draw time courses and, where there are any, steady states, branches and sensitivities."""
        found, derivatives = end.analysis
        names, unit = self.model.law.species, " [1]" if self.model.is_normalised else ""
        drawings: dict[str, Drawing] = {
            "courses": partial(courses_figure, end.history, self.names, tuple(self.case.set), unit)
        }
        if found and found[None].states:
            drawings["steady_states"] = partial(states_figure, found[None], names, unit)
        branches = {value: one for value, one in found.items() if value is not None and one.states}
        if branches:
            drawings["steady_branches"] = partial(branches_figure, branches, names, str(self.case.steady.over), unit)
        if rows := self._sensitivities(derivatives):
            drawings["sensitivities"] = partial(sensitivities_figure, rows)
        return drawings

    def sentence(self, end: End[NetworkState]) -> str:
        """Return a sentence on how long the network was integrated, and how many steady states were found."""
        verdict = verdict_of(end.analysis.found.get(None), self.model)
        return f"The network was simulated over {end.history['time_h'][-1]:.6g} h. {verdict}"


def _states_table(
    found: dict[float | None, SteadyStates], names: tuple[str, ...], over: str | None
) -> tuple[list[str], list[list[Any]]]:
    head = [*([f"input_{over}"] if over else []), "state", "is_stable", "n_starts", *names]
    rows = []
    for value, states in found.items():
        for number, state in enumerate(states.states, 1):
            first = ["last" if value is None else value] if over else []
            rows.append([*first, number, int(state.is_stable), state.n_starts, *map(float, state.y)])
    return head, rows


def _sensitivity_rows(
    derivatives: dict[str, Sensitivities], model: NetworkModel, inputs: np.ndarray, outputs: Any
) -> Iterator[list[Any]]:
    """Yield rows of state, output, kind and name of the parameter, its value, dy/dp, and p dy/dp; times are in hours."""
    kinds = dict(model.law.differentiable) | {INPUT: model.law.input_names}
    for at, by in derivatives.items():
        for kind, columns in by.items():
            values = inputs if kind == INPUT else np.asarray(getattr(model.law, kind))
            per = seconds_from_hours(1.0) if kind == "tau" else 1.0
            for i in outputs:
                for k, name in enumerate(kinds[kind]):
                    value, slope = float(values[k]) / per, float(columns[i, k]) * per
                    word = "tau_h" if kind == "tau" else kind
                    yield [at, model.law.species[i], word, name, value, slope, value * slope]
