"""A signalling network by itself: over time, at rest, and what it owes to its parameters."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ...biology.courses import follow
from ...biology.network_model import Model
from ...biology.sensitivity import INPUT, Sensitivities, of_end, of_steady_state
from ...biology.steady import SteadyStates, steady_states
from ...core.errors import ConvergenceError
from ...core.units import hours_from_seconds, seconds_from_hours
from ...numerics.ode import Course
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .build import Chunk, accuracy_of, chunks, corners, inputs_at, longest_s, outputs_of, refuse_unknown, starts_of
from .case import SignallingCase
from .figures import branches_figure, courses_figure, sensitivities_figure, states_figure
from .network import read_model

CHECKPOINT_SECONDS = 10.0  # between two checkpoints; one more when the run is interrupted


class Mark(NamedTuple):
    """Where a run stands: at the end of a chunk."""

    chunk: int
    row: int
    y: np.ndarray
    n_steps: int


@dataclass
class SignallingRun:
    """One run; a checkpoint holds the state between two chunks of time, at each of which the solver starts anew."""

    case: SignallingCase
    folder: RunFolder
    progress: Progress
    saved: float = field(default_factory=time.perf_counter)

    def go(self) -> str:
        """Follow the network, find where it rests, differentiate; returns the sentence that ends the run."""
        with self.progress.stage("network"):
            refuse_unknown(self.case, self.model)
            for note in self.model.notes:
                self.folder.note(note)
        with self.progress.stage("course"):
            end = self._follow()
        with self.progress.stage("steady states"):
            found = self._search(end.y)
        with self.progress.stage("sensitivities"):
            derivatives = self._differentiate(found)
        with self.progress.stage("outcome"):
            return self._tell(end, found, derivatives)

    @cached_property
    def model(self) -> Model:
        """The network."""
        return read_model(self.case.network)

    @cached_property
    def last_inputs(self) -> np.ndarray:
        """Inputs at the end of the course (n_inputs,)."""
        return inputs_at(self.case, self.model, self.case.time.duration_h)

    def _follow(self) -> Mark:
        """Write a row per asked time."""
        laid = chunks(self.case, self.model)
        mark = self._kept()
        if mark is None:
            mark = Mark(0, 0, self.model.start, 0)
            self.folder.record(self._row(0, 0.0, mark.y))
        try:
            for number in range(mark.chunk, len(laid)):
                mark = self._pass(laid[number], mark)
                if time.perf_counter() - self.saved > CHECKPOINT_SECONDS:
                    self._save(mark)
                reached = laid[number].times_h[-1]
                self.progress.update(
                    (number + 1) / len(laid), f"{reached:.4g} h of {laid[-1].times_h[-1]:.4g} h simulated"
                )
        except (KeyboardInterrupt, ConvergenceError):
            self._save(mark)
            raise
        return mark

    def _pass(self, chunk: Chunk, mark: Mark) -> Mark:
        """Follow the network through a chunk; what was reached before a failure is written."""
        times = seconds_from_hours(chunk.times_h)
        done = follow(
            self.model.law, jnp.asarray(chunk.inputs), jnp.asarray(mark.y), jnp.asarray(times), accuracy_of(self.case)
        )
        states, n_steps = np.asarray(done.y), mark.n_steps + int(done.n_steps)
        rows = zip(chunk.times_h[1 : chunk.n_rows + 1], states[1:])
        for number, (time_h, y) in enumerate(rows, mark.row + 1):
            if np.isfinite(y).all():
                self.folder.record(self._row(number, float(time_h), y))
        if not done.is_done:
            raise self._failure(chunk, done)
        return Mark(mark.chunk + 1, mark.row + chunk.n_rows, states[-1], n_steps)

    def _failure(self, chunk: Chunk, done: Course) -> ConvergenceError:
        states, last = np.asarray(done.y), np.asarray(done.last)
        good = np.isfinite(states).all(axis=1)
        largest = int(np.argmax(np.abs(last)))
        taken = f"solver.max_steps = {int(done.n_steps)} were taken" if done.is_spent else "the solver gave up"
        hint = ' or take solver.method = "implicit"' if self.case.solver.method == "explicit" else ""
        return ConvergenceError(
            f"The network could not be followed beyond {hours_from_seconds(float(done.reached)):.6g} h, where "
            f"{self.model.law.species[largest]} is largest, {last[largest]:.4g}: {taken}; if no state grows without bound, "
            f"raise solver.max_steps{hint}.",
            [f"{t:.6g} h: largest {np.abs(y).max():g}" for t, y, ok in zip(chunk.times_h, states, good) if ok][-5:],
        )

    def _row(self, number: int, time_h: float, y: np.ndarray) -> dict[str, Any]:
        held = dict(zip(self.model.law.input_names, inputs_at(self.case, self.model, time_h)))
        return {
            "step": number,
            "time_h": time_h,
            **{name: float(value) for name, value in zip(self.model.law.species, y)},
            **{f"input_{name}": float(held[name]) for name in self.case.set},
        }

    def _save(self, mark: Mark) -> None:
        self.saved = time.perf_counter()
        scalars = {"row": mark.row, "chunk": mark.chunk, "n_steps": mark.n_steps}
        self.folder.save_checkpoint(mark.row, {"y": mark.y}, scalars)

    def _kept(self) -> Mark | None:
        kept = self.folder.checkpoint
        return kept and Mark(kept.scalars["chunk"], kept.scalars["row"], kept.arrays["y"], kept.scalars["n_steps"])

    def _search(self, end: np.ndarray) -> dict[float | None, SteadyStates]:
        """Steady states under the last inputs (None), then under every value of ``steady.over``; one start is the end."""
        if self.model.law.heeds_time:
            self.folder.note("The network heeds time itself: it has no steady states.")
            return {}
        starts = np.vstack([starts_of(self.case, self.model), end])
        waiting, scale = longest_s(self.case, self.model), np.maximum(self.model.high, 1e-9)
        found = {}
        for number, (value, inputs) in enumerate(self._inputs_searched()):
            found[value] = steady_states(self.model.law, inputs, starts, waiting, scale, accuracy_of(self.case))
            self.progress.update((number + 1) / (len(self.case.steady.values) + 1), "steady states")
        return found

    def _inputs_searched(self) -> Iterator[tuple[float | None, np.ndarray]]:
        yield None, self.last_inputs
        for value in self.case.steady.values:
            inputs = self.last_inputs.copy()
            inputs[self.model.law.input_names.index(self.case.steady.over)] = value
            yield value, inputs

    def _differentiate(self, found: dict[float | None, SteadyStates]) -> dict[str, Sensitivities]:
        """Of every stable state under the last inputs, and of the end of the course."""
        asked, derivatives = self.case.sensitivity.at, {}
        if asked in ("steady", "both") and found:
            for number, state in enumerate(found[None].stable, 1):
                by = of_steady_state(self.model.law, self.last_inputs, state.y)
                if by is None:
                    self.folder.note(
                        f"Steady state {number} has no derivatives: what is conserved decides where it is."
                    )
                else:
                    derivatives[f"state {number}"] = by
        if asked in ("end", "both"):
            at = corners(self.case)
            inputs = np.array([inputs_at(self.case, self.model, float(t)) for t in at[:-1]])
            times = seconds_from_hours(at)
            derivatives["end"] = of_end(self.model.law, inputs, self.model.start, times, accuracy_of(self.case))
        return derivatives

    def _tell(self, end: Mark, found: dict[float | None, SteadyStates], derivatives: dict[str, Sensitivities]) -> str:
        names = self.model.law.species
        history = self.folder.history()
        of_inputs = "input [1]" if self.model.is_normalised else "input"
        self.folder.save_figure("courses", courses_figure(history, names, tuple(self.case.set), of_inputs))
        told = {"n_solver_steps": Quantity(end.n_steps, "1", "of the course")}
        told["end"] = Quantity(dict(zip(names, end.y)), "1", f"at {history['time_h'][-1]:g} h")
        told |= _of_states(found, names, dict(zip(self.model.law.input_names, self.last_inputs)))
        self.folder.write_outcome(told)
        if found:
            self.folder.write_table("steady_states", *_states_table(found, names, self.case.steady.over))
            self.folder.save_figure("steady_states", states_figure(found[None], names))
        if len(found) > 1:
            branches = {value: one for value, one in found.items() if value is not None}
            self.folder.save_figure("steady_branches", branches_figure(branches, names, str(self.case.steady.over)))
        if derivatives:
            outputs = outputs_of(self.case, self.model)
            rows = list(_sensitivity_rows(derivatives, self.model, self.last_inputs, outputs))
            head = ["at", "output", "kind", "of", "value", "derivative", "relative"]
            self.folder.write_table("sensitivities", head, rows)
            self.folder.save_figure("sensitivities", sensitivities_figure(rows))
        return f"The network was followed for {history['time_h'][-1]:.6g} h. {_verdict(found.get(None))}"


def _verdict(found: SteadyStates | None) -> str:
    if found is None:
        return "It heeds time and has no steady states."
    n, unsettled = len(found.stable), int(np.sum(found.reached < 0))
    rest = f" {unsettled} of {len(found.reached)} starts did not come to rest." if unsettled else ""
    words = {0: "No stable steady state was found.", 1: "One stable steady state was found."}
    many = f"{n} stable steady states were found: where it starts decides."
    return words.get(n, many) + rest


def _of_states(
    found: dict[float | None, SteadyStates], names: tuple[str, ...], inputs: dict[str, float]
) -> dict[str, Quantity]:
    """Steady states as the outcome tells them, none hidden."""
    if not found:
        return {}
    here = found[None]
    under = ", ".join(f"{name} = {value:g}" for name, value in inputs.items()) or "no inputs"
    listed = [
        {
            "is_stable": state.is_stable,
            "n_starts": state.n_starts,
            "growth_per_h": seconds_from_hours(state.growth),
            "values": dict(zip(names, state.y)),
        }
        for state in here.states
    ]
    return {
        "n_stable_states": Quantity(len(here.stable), "1", f"from {len(here.reached)} starts under {under}"),
        "is_bistable": Quantity("yes" if len(here.stable) > 1 else "no", "", "whether the start decides"),
        "state_from_own_start": Quantity(_number(here.reached[0]), "1", "number of the state, from 1"),
        "state_from_end": Quantity(
            _number(here.reached[-1]), "1", "number of the state that the course leads to, from 1"
        ),
        "n_unsettled_starts": Quantity(int(np.sum(here.reached < 0)), "1", "which did not come to rest"),
        "n_conserved": Quantity(here.n_conserved, "1", "quantities that the network keeps: zero eigenvalues"),
        "steady_states": Quantity(listed, "1", "stable ones first; growth: largest real part of an eigenvalue"),
    }


def _number(state: int) -> int | None:
    return int(state) + 1 if state >= 0 else None


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
    derivatives: dict[str, Sensitivities], model: Model, inputs: np.ndarray, outputs: Any
) -> Iterator[list[Any]]:
    """State, output, kind and name of the parameter, its value, dy/dp, and p dy/dp; times are told in hours."""
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
