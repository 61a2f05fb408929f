"""Build the inputs over time, output times and initial states of a case of kind "signalling"."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...biology.culprits import not_finite
from ...biology.network_model import NetworkModel
from ...biology.scales import magnitudes
from ...biology.steady import N_TIMES, latin_hypercube
from ...biology.switches import instants
from ...core.errors import InputError
from ...core.units import hours_from_seconds, seconds_from_hours
from ...numerics.ode import Accuracy
from .case import SignallingCase

STARTS, SLOWNESS = 30, 100.0  # defaults: random initial states; longest time to a steady state over the slowest time

PER_STEP, LEAST_RELATIVE = 0.1, 1e-12  # share of the tolerances that a step may use; least relative error of a step


class Chunk(NamedTuple):
    """Time interval with constant inputs."""

    times_h: np.ndarray
    """Start, times of the rows, and end, which is repeated to fill the array (N_TIMES,)."""
    n_rows: int
    """Number of rows in the interval."""
    inputs: np.ndarray
    """Values of the inputs (n_inputs,)."""


def accuracy_of(case: SignallingCase, scale: np.ndarray) -> Accuracy:
    """Return the tolerances and method of time integration; absolute errors are relative to the scale (n_species,).

    Each step is held to a share of the tolerances that the case asks for, since the errors of steps add up.
    """
    asked = case.solver
    relative = max(PER_STEP * asked.relative_tolerance, LEAST_RELATIVE)
    absolute = jnp.asarray(PER_STEP * asked.absolute_tolerance * scale)
    return Accuracy(relative, absolute, asked.method, asked.max_steps)


def scale_of(case: SignallingCase, model: NetworkModel, laid: Sequence[Chunk]) -> np.ndarray:
    """Return the magnitude of every species (n_species,): its maximum activity, or an estimate from the network's rates."""
    if model.is_normalised:
        return np.where(model.high > 0.0, model.high, 1.0)
    inputs = {chunk.inputs.tobytes(): chunk.inputs for chunk in laid}.values()
    return magnitudes(model.law, model.start, inputs, seconds_from_hours(case.time.duration_h))


def begun(case: SignallingCase, model: NetworkModel) -> NetworkModel:
    """Return the model with the start that it has under the inputs at time 0."""
    start = model.law.begin(jnp.asarray(model.start), jnp.asarray(inputs_at(case, model, 0.0)))
    return model._replace(start=np.asarray(start))


def refuse_undefined(case: SignallingCase, model: NetworkModel) -> None:
    """Check that the rates are finite numbers at the start.

    Raises
    ------
    InputError
        If one is not; the message names the reaction, rule or species.
    """
    fault = not_finite(model.law, inputs_at(case, model, 0.0), model.start, 0.0)
    if fault:
        raise InputError(
            f"the network cannot start: at 0 h {fault}; give a start or parameters at which it is a number"
        )


def refuse_unknown(case: SignallingCase, model: NetworkModel) -> None:
    """Check the names that the case gives against those of the network.

    Raises
    ------
    InputError
        If a name is unknown (the message lists the known ones), a value is out of range, or an input changes after the end.
    """
    known, species = model.law.input_names, model.law.species
    for key, names, all_of in (
        ("set", case.set, known),
        ("steady.over", [case.steady.over] if case.steady.over else [], known),
        ("sensitivity.outputs", case.sensitivity.outputs, species),
    ):
        for name in names:
            if name not in all_of:
                kind = "input" if all_of is known else "species"
                raise InputError(f'{key} names "{name}", which is no {kind} of the network; known: {_listed(all_of)}')
    for name, schedule in case.set.items():
        _refuse_beyond(f"set.{name}", schedule.value, model)
        late = [t for t in schedule.time_h if t > case.time.duration_h]
        if late:
            raise InputError(f"set.{name} changes at {late[0]:g} h, after time.duration_h = {case.time.duration_h:g}")
    _refuse_beyond("steady.values", case.steady.values, model)


def inputs_at(case: SignallingCase, model: NetworkModel, time_h: float) -> np.ndarray:
    """Return the values of the inputs (n_inputs,) that apply at a time."""
    values = model.inputs.copy()
    for name, schedule in case.set.items():
        number = int(np.searchsorted(schedule.time_h, time_h, side="right")) - 1
        if number >= 0:
            values[model.law.input_names.index(name)] = schedule.value[number]
    return values


def row_times(case: SignallingCase) -> np.ndarray:
    """Return the times of the history's rows [h]: 0, every multiple of ``time.step_h`` up to the duration, and the duration."""
    n = int(np.floor(case.time.duration_h / case.time.step_h * (1.0 + 1e-12)))
    times = rounded(np.arange(n + 1) * case.time.step_h, 15)  # so that a row coincides exactly with a change of inputs
    return times if np.isclose(times[-1], case.time.duration_h) else np.append(times, case.time.duration_h)


def rounded(times: np.ndarray, digits: int) -> np.ndarray:
    """Return times to a number of significant digits."""
    return np.array([float(f"{time:.{digits}g}") for time in times])


def corners(case: SignallingCase, model: NetworkModel) -> np.ndarray:
    """Return the start, the end, and every time at which an input changes or a formula switches [h]."""
    last = float(row_times(case)[-1])
    changes = {t for schedule in case.set.values() for t in schedule.time_h if 0.0 < t < last}
    times = np.array(sorted(changes | {0.0, last}))
    switches = [
        instants(model.law, inputs_at(case, model, start), *map(seconds_from_hours, (start, end)))
        for start, end in pairwise(map(float, times))
    ]
    return np.unique(np.concatenate([times, *map(hours_from_seconds, switches)]))


def chunks(case: SignallingCase, model: NetworkModel) -> list[Chunk]:
    """Divide the time course into intervals of constant inputs and few rows, at whose ends the solver restarts."""
    rows, laid = row_times(case), []
    for start, end in pairwise(corners(case, model)):
        inside = rows[(rows > start) & (rows <= end)]
        parts = [inside[i : i + N_TIMES - 2] for i in range(0, len(inside), N_TIMES - 2)] or [inside]
        for number, part in enumerate(parts):
            stop = end if number == len(parts) - 1 else part[-1]
            times = np.concatenate([[start], part, np.full(N_TIMES - 1 - len(part), stop)])
            laid.append(Chunk(times, len(part), inputs_at(case, model, float(start))))
            start = stop
    return laid


def starts_of(case: SignallingCase, model: NetworkModel, scale: np.ndarray) -> np.ndarray:
    """Return initial states of the search for steady states (n, n_species): the network's own, all low, all high, random.

    A species of unlimited amount is drawn from 0 to twice its scale (n_species,).
    """
    n = case.steady.starts
    if n is None:
        n = STARTS if model.is_normalised else 0
    high = model.high if model.is_normalised else 2.0 * scale
    low = np.zeros_like(high)
    ends = [low, high] if model.is_normalised else []
    rng = np.random.Generator(np.random.Philox(case.seed))
    return np.vstack([model.start, *ends, latin_hypercube(low, high, n, rng)])


def longest_s(case: SignallingCase, model: NetworkModel) -> float:
    """Return the longest time for which a network is integrated in search of a steady state [s]."""
    slowest = case.time.duration_h if model.slowest_h is None else model.slowest_h
    return seconds_from_hours(case.steady.longest_h or SLOWNESS * slowest)


def outputs_of(case: SignallingCase, model: NetworkModel) -> Sequence[int]:
    """Return the indices of the species whose sensitivities are computed."""
    return [model.law.species.index(name) for name in case.sensitivity.outputs] or range(len(model.law.species))


def _refuse_beyond(key: str, values: Iterable[float], model: NetworkModel) -> None:
    for value in values if model.is_normalised else ():
        if not 0.0 <= value <= 1.0:
            raise InputError(f"{key} must be in [0, 1]; got {value:g}")


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:30]) + (", ..." if len(names) > 30 else "") if names else "none"
