"""Algebraic rules of SBML, 0 = f: each is solved for the one quantity that nothing else determines, where f is linear in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice

from ..biology.expressions import TIME, Expression, names_in, needed, number, substituted
from ..core.errors import InputError

ZERO, ONE = number(0.0), number(1.0)


def solved(
    rules: Sequence[Expression], candidates: Sequence[str], assigned: Mapping[str, Expression]
) -> dict[str, Expression]:
    """Return the formulas of the quantities that algebraic rules determine.

    Parameters
    ----------
    rules : sequence of Expression
        Formulas that are 0 at all times.
    candidates : sequence of str
        Quantities that nothing else determines.
    assigned : mapping
        Formulas of the quantities that assignment rules and reactions determine.

    Raises
    ------
    InputError
        If it is not clear which quantity a rule determines, or a rule is not linear in it.
    """
    if not rules:
        return {}
    inlined = [_inlined(rule, set(candidates), assigned) for rule in rules]
    ways = list(islice(_ways(inlined, list(candidates)), 2))
    if len(ways) != 1:
        of = ", ".join(sorted(set().union(*map(names_in, rules)) & set(candidates))) or "none"
        raise InputError(f"its algebraic rules do not say which quantity each of them determines (undetermined: {of})")
    return {unknown: _solution(rule, unknown) for unknown, rule in zip(ways[0], inlined)}


def _inlined(rule: Expression, candidates: set[str], assigned: Mapping[str, Expression]) -> Expression:
    """Replace names that depend on candidates by their formulas."""
    while True:
        hidden = {one for one in names_in(rule) & assigned.keys() if needed([one], assigned) & candidates}
        if not hidden:
            return rule
        rule = substituted(rule, {one: assigned[one] for one in hidden})


def _ways(rules: Sequence[Expression], candidates: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield every way to give each rule a candidate of its own."""
    if not rules:
        yield ()
        return
    for one in candidates:
        if one in names_in(rules[0]):
            rest = [other for other in candidates if other != one]
            yield from ((one, *way) for way in _ways(rules[1:], rest))


def _solution(rule: Expression, unknown: str) -> Expression:
    linear = _linear(rule, unknown)
    if linear is None:
        raise InputError(
            f'an algebraic rule is not linear in "{unknown}", which it determines; write it as an assignment rule'
        )
    slope, rest = linear
    return ("divide", ("minus", rest), slope)


def _linear(rule: Expression, unknown: str) -> tuple[Expression, Expression] | None:
    """Return a and b of f = a x + b, both without x; None if f has not this form."""
    if unknown not in names_in(rule):
        return ZERO, rule
    word, *parts = rule
    if word in ("name", TIME):
        return ONE, ZERO
    pairs = [_linear(part, unknown) for part in parts]
    if any(pair is None for pair in pairs):
        return None
    slopes, rests = [pair[0] for pair in pairs if pair], [pair[1] for pair in pairs if pair]
    if word in ("plus", "minus"):
        return (word, *slopes), (word, *rests)
    holding = [k for k, part in enumerate(parts) if unknown in names_in(part)]
    if word == "times" and len(holding) == 1:
        others = [part for k, part in enumerate(parts) if k != holding[0]]
        return ("times", slopes[holding[0]], *others), ("times", rests[holding[0]], *others)
    if word == "divide" and holding == [0]:
        return ("divide", slopes[0], parts[1]), ("divide", rests[0], parts[1])
    return None
