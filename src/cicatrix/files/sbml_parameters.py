"""Equations written as an SBML model of parameters alone, which every simulator of SBML understands in the same way."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ..biology.expressions import Expression, number
from .sbml_equations import Event
from .sbml_math import mathml

HEAD = '<sbml xmlns="http://www.sbml.org/sbml/level3/version2/core" level="3" version="2"><model id="equations">'
MATH = '<math xmlns="http://www.w3.org/1998/Math/MathML">{}</math>'
CLOCK = "the clock"  # a quantity of rate 1, so that there is always something to integrate


def parameters_text(
    start: Mapping[str, float],
    rates: Mapping[str, Expression],
    assigned: Mapping[str, Expression],
    events: Sequence[Event],
) -> tuple[str, dict[str, str]]:
    """Write a model, and return it with the id of each of its quantities.

    Species, compartments, reactions, stoichiometries and conversion factors are no part of it, and every quantity has an id of
    our own, so that none can be mistaken for a function, for the time or for another quantity.
    """
    rates = {**rates, CLOCK: number(1.0)}
    start = {**start, CLOCK: 0.0}
    ids = {one: f"q{k}" for k, one in enumerate(dict.fromkeys([*start, *rates, *assigned]))}
    parameters = "".join(_parameter(ids[one], start.get(one)) for one in ids)
    rules = [_rule("assignmentRule", ids[one], rule, ids) for one, rule in assigned.items()]
    rules += [_rule("rateRule", ids[one], rule, ids) for one, rule in rates.items()]
    body = (
        _list("Parameters", [parameters])
        + _list("Rules", rules)
        + _list("Events", [_event(one, ids) for one in events])
    )
    return f"{HEAD}{body}</model></sbml>", ids


def _list(name: str, parts: Iterable[str]) -> str:
    inside = "".join(parts)
    return f"<listOf{name}>{inside}</listOf{name}>" if inside else ""


def _parameter(id_of: str, value: float | None) -> str:
    words = {"inf": "INF", "-inf": "-INF", "nan": "NaN"}
    given = "" if value is None else f' value="{words.get(str(value), f"{value:.17g}")}"'
    return f'<parameter id="{id_of}"{given} constant="false"/>'


def _rule(word: str, variable: str, rule: Expression, ids: Mapping[str, str]) -> str:
    return f'<{word} variable="{variable}">{_math(rule, ids)}</{word}>'


def _math(rule: Expression, ids: Mapping[str, str], boolean: bool = False) -> str:
    return MATH.format(mathml(rule, ids, boolean))


def _event(event: Event, ids: Mapping[str, str]) -> str:
    flags = f'initialValue="{_word(event.starts_true)}" persistent="{_word(event.is_persistent)}"'
    delay = f"<delay>{_math(event.delay, ids)}</delay>" if event.delay else ""
    priority = f"<priority>{_math(event.priority, ids)}</priority>" if event.priority else ""
    pairs = event.assignments.items()
    changes = [f'<eventAssignment variable="{ids[one]}">{_math(rule, ids)}</eventAssignment>' for one, rule in pairs]
    trigger = f"<trigger {flags}>{_math(event.trigger, ids, True)}</trigger>"
    return (
        f'<event useValuesFromTriggerTime="{_word(event.at_trigger)}">{trigger}'
        f"{priority}{delay}{_list('EventAssignments', changes)}</event>"
    )


def _word(flag: bool) -> str:
    return str(bool(flag)).lower()
