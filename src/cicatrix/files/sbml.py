"""Reading of reaction networks from SBML: rate laws of our own where the model has such, else a model for libroadrunner."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..biology.expressions import TIME, Expression, evaluate, name, names_in, needed, number, ordered
from ..biology.kinetics import Kinetics
from ..biology.network_model import NetworkModel
from ..biology.roadrunner import DelegatedNetwork, refuse_without_engine
from ..core.errors import InputError
from .sbml_document import MISSING, read_document
from .sbml_equations import Equations, Event
from .sbml_parameters import parameters_text
from .sbml_time import seconds_of
from .sbml_translation import equations_of

__all__ = ["MISSING", "Changes", "read_sbml"]
CHANCE = (
    "Events of one instant follow each other by priority, and at random where that is equal: two runs may then differ."
)
LARGEST_RATE = 1e150  # a rate beyond which nothing can be integrated
Changes = Mapping[str, Sequence[tuple[float, float]]]
"""Constants that change from outside: time [s] and value from then on; empty for those that are only varied between runs."""


def read_sbml(path: Path, time_unit: str | None = None, changes: Changes | None = None) -> NetworkModel:
    """Read a model of SBML Level 1, 2 or 3.

    Parameters
    ----------
    path : Path
        The file.
    time_unit : str, optional
        Unit of time of the model: "s", "min", "h" or "d"; by default the unit that the file states.
    changes : Changes, optional
        Constants that the case sets. Initial assignments of other constants, and of initial values, follow them; their own are
        without effect.

    Returns
    -------
    NetworkModel
        Its law is :class:`.Kinetics`, or a :class:`.DelegatedNetwork` where the model has features beyond it.

    Raises
    ------
    InputError
        If libsbml is not installed, the file is not valid, or the model uses features that are not supported; they are named.
    """
    changes = changes or {}
    document = read_document(path)
    seconds, notes = seconds_of(document.getModel(), time_unit)
    try:
        equations = equations_of(document.getModel(), set())
        if equations.features and changes.keys() & set(equations.volumes.values()):
            equations = equations_of(document.getModel(), {*changes} & set(equations.volumes.values()))
        if not equations.columns and not equations.rates:
            raise InputError(
                "nothing changes in this model: it has no reaction, no rule and no event that changes a quantity"
            )
        build = _delegated if equations.features else _kinetics
        model = build(equations, seconds, changes)
    except RecursionError:
        raise InputError(
            f"{path}: a formula is nested too deep to be evaluated; split it into assignment rules"
        ) from None
    except InputError as error:
        joint = " " if str(error).startswith(("uses ", "gives ")) else ": "
        raise InputError(f"{path}{joint}{error}") from None
    return model._replace(notes=(*equations.notes, *notes, *model.notes))


def _starting(equations: Equations, free: Iterable[str]) -> dict[str, Expression]:
    """Return the formulas of all values at time 0; constants that the case sets have the value that the file gives them."""
    own = {**equations.given, **equations.initial, **equations.assigned}
    values = _evaluated(own, [one for one in free if one in own])
    return own | {one: number(values[one]) for one in values if one in free and one in equations.constants()}


def _evaluated(rules: Mapping[str, Expression], asked: Iterable[str], states: Iterable[str] = ()) -> dict[str, float]:
    """Evaluate names, and all on which they depend, at time 0; those in ``states`` must be finite."""
    found: dict[str, float] = {TIME: 0.0}
    asked = needed(asked, rules)
    for one, rule in ordered({one: rule for one, rule in rules.items() if one in asked}, {TIME}):
        found[one] = float(np.asarray(evaluate(rule, found)))
    for one in states:
        if not np.isfinite(found[one]):
            raise InputError(f'"{one}" starts at {found[one]}, which is not a finite number')
    return found


def _refuse_odd_rates(equations: Equations, start: Mapping[str, Expression]) -> None:
    """Refuse a model whose rates at time 0 are no numbers or beyond all measure; the message names the reaction or the rule."""
    asked = {f"rate {one}": rule for one, rule in equations.rates.items()}
    values = _evaluated({**start, **asked}, asked)
    for of, rule in equations.rates.items():
        if abs(values[f"rate {of}"]) < LARGEST_RATE:
            continue
        reactions = [one for one in names_in(rule) if one in equations.assigned and not abs(values[one]) < LARGEST_RATE]
        words = f'reaction or rule "{min(reactions)}"' if reactions else f'the rate of "{of}"'
        value = values[min(reactions)] if reactions else values[f"rate {of}"]
        raise InputError(
            f"{words} is {value:g} at time 0; its formula must give a finite number there (a piecewise needs an otherwise)"
        )


def _kinetics(equations: Equations, seconds: float, changes: Changes) -> NetworkModel:
    """Return the rate laws of a model, its constants and its start."""
    start, states = _starting(equations, changes), [*equations.rates]
    derived = equations.derived({*changes}) | _followers(equations, start, changes)
    constants = [one for one in equations.constants() if one not in derived]
    values = _evaluated(start, [*constants, *states], states)
    _refuse_odd_rates(equations, start)
    assigned = ordered({**equations.assigned, **derived}, {*constants, *states, TIME})
    used = needed(states, {one: rule for one, rule in (start | derived).items() if one not in constants}) - {*constants}
    law = Kinetics(
        species=tuple(states),
        input_names=tuple(constants),
        values=np.array([values[one] for one in constants]),
        assigned=assigned,
        rates=tuple(equations.rates.values()),
        seconds=seconds,
        initial=ordered({one: rule for one, rule in (start | derived).items() if one in used}, {*constants, TIME}),
        volumes=tuple(equations.volumes.get(one, "") for one in states),
        shown=tuple(one for one in _columns(equations, derived) if one not in equations.rates),
    )
    at_start = np.array([values[one] for one in states])
    high = np.where(at_start > 0.0, 2.0 * at_start, 1.0)
    return NetworkModel(law, at_start, np.asarray(law.values), high, None, False)


def _columns(equations: Equations, derived: Mapping[str, Expression]) -> tuple[str, ...]:
    """Return the columns of a result: those of the model, and the constants that follow other constants."""
    return tuple(dict.fromkeys([*equations.columns, *derived]))


def _followers(equations: Equations, start: Mapping[str, Expression], changes: Changes) -> dict[str, Expression]:
    """Return the concentrations of constant species in compartments that the case sets: their amounts stay."""
    follow = {one: of for one, of in equations.volumes.items() if of in changes and one not in changes}
    held = {one: of for one, of in follow.items() if one in equations.constants()}
    values = _evaluated(start, [*held, *held.values()])
    return {one: ("divide", number(values[one] * values[of]), name(of)) for one, of in held.items()}


def _delegated(equations: Equations, seconds: float, changes: Changes) -> NetworkModel:
    """Return a model for libroadrunner, with the changes of constants as events."""
    refuse_without_engine()
    known = {one: steps for one, steps in changes.items() if one in equations.constants()}
    start = _starting(equations, known)
    sizes = set(equations.volumes.values())
    first = {one: dict(steps)[0.0] for one, steps in known.items() if 0.0 in dict(steps)}
    derived = equations.derived({*known})
    constants = [one for one in equations.constants() if one not in derived]
    file = _evaluated(start, [*constants, *equations.rates], equations.rates)
    start |= {one: number(value) for one, value in first.items() if one not in sizes}
    values = _evaluated(start, [one for one in equations.given if one not in equations.assigned]) | {
        one: value for one, value in first.items() if one in sizes
    }
    _refuse_odd_rates(
        equations, {**start, **{one: number(value) for one, value in values.items() if one in equations.given}}
    )
    kept = {one: value for one, value in values.items() if one in equations.given and one not in derived}
    events = [*equations.events, *_steps(known, seconds)]
    text, ids = parameters_text(kept, equations.rates, {**equations.assigned, **derived}, events)
    features, shown = ", ".join(equations.features), _columns(equations, derived)
    has_jumps = bool(events) or "<piecewise>" in text
    law = DelegatedNetwork(shown, tuple(constants), text, tuple(ids[one] for one in shown), has_jumps, seconds)
    note = f"libroadrunner simulates this model, since it has {features}; steady states and sensitivities are not computed."
    columns = np.array([np.nan for _ in shown])
    notes = (CHANCE, note) if len(equations.events) > 1 else (note,)
    return NetworkModel(law, columns, np.array([file[one] for one in constants]), columns, None, False, notes)


def _steps(known: Changes, seconds: float) -> list[Event]:
    """Return the changes of constants after time 0 as events."""
    return [
        Event(("geq", (TIME,), number(at / seconds)), {one: number(value)}, priority=number(1e9), starts_true=False)
        for one, steps in known.items()
        for at, value in steps
        if at > 0.0
    ]
