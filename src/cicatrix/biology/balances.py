"""Sums of species that a network keeps or lets grow for ever, found exactly from the expressions of its rates."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple, TypeVar

import numpy as np

from .kinetics import TIME, Expression, Kinetics, evaluate
from .network import RateLaw

Key = TypeVar("Key")

Monomial = frozenset
"""Product of bases as pairs of base and exponent; a base is a name, or an expression that is not taken apart further."""
Form = dict[Monomial, Fraction]
"""Linear combination of monomials; a number is a multiple of :data:`ONE`."""
ONE: Monomial = frozenset()
MAX_TERMS = 256  # longer products are not multiplied out


class Balances(NamedTuple):
    """Sums of species whose rate of change does not depend on the state."""

    conserved: np.ndarray
    """Weights of each sum that stays constant (n_conserved, n_species)."""
    growing: np.ndarray
    """Weights of each sum that changes at a constant rate other than 0 (n_growing, n_species); a network with one never rests."""
    growth: np.ndarray
    """Rates of change of those sums (n_growing,) [1/s]."""


def balances_of(law: RateLaw, inputs: np.ndarray) -> Balances:
    """Find all linear sums of species that the rates keep under inputs (n_inputs,), by exact elimination in rational numbers.

    Every rate is written as a linear combination of distinct terms. The left null space of the coefficients of the terms that
    depend on the state contains that of the stoichiometric matrix, since a reaction is a sum of terms, and it exists for
    rate rules as well, which have no stoichiometry. Sums that are not linear in the species are not found. A network of Hill
    functions keeps no sum, since each of its species decays by itself.
    """
    if not isinstance(law, Kinetics):
        return _without(len(law.species))
    forms: dict[str, Form] = {name: _number(value) for name, value in zip(law.input_names, inputs)}
    for name, expression in law.assigned:
        forms[name] = _form(expression, forms)
    rows = [_form(rate, forms) for rate in law.rates]
    sums = _null_space([{term: c for term, c in row.items() if term != ONE} for row in rows])
    drifts = [sum((w * rows[i].get(ONE, Fraction(0)) for i, w in one.items()), Fraction(0)) for one in sums]
    return _split(sums, drifts, len(rows), law.seconds)


def _without(n_species: int) -> Balances:
    return Balances(np.zeros((0, n_species)), np.zeros((0, n_species)), np.zeros(0))


def _split(sums: list[dict[int, Fraction]], drifts: list[Fraction], n: int, seconds: float) -> Balances:
    """Separate the sums of zero drift from one that drifts, which is subtracted from the others that do."""
    first = next((k for k, drift in enumerate(drifts) if drift), None)
    if first is None:
        return _without(n)._replace(conserved=_dense(sums, n))
    of, pace = sums[first], drifts[first]
    kept = [_less(one, of, drift / pace) for k, (one, drift) in enumerate(zip(sums, drifts)) if k != first]
    least = min(abs(w) for w in of.values())
    return Balances(_dense(kept, n), _dense([of], n), np.array([float(pace / least) / seconds]))


def _dense(sums: list[dict[int, Fraction]], n: int) -> np.ndarray:
    dense = np.zeros((len(sums), n))
    for row, one in zip(dense, sums):
        least = min(abs(w) for w in one.values())
        for i, w in one.items():
            row[i] = float(w / least)
    return dense


def _null_space(rows: list[Form]) -> list[dict[int, Fraction]]:
    """Return a basis of the vectors w with w . rows = 0.

    Rows are eliminated from the last one on: reactants tend to be listed before products, and w then tends to be positive.
    """
    pivots: list[tuple[Monomial, Form, dict[int, Fraction]]] = []
    null = []
    for number, row in reversed(list(enumerate(rows))):
        left, made = dict(row), {number: Fraction(1)}
        for term, of, by in pivots:
            if share := left.get(term):
                left, made = _less(left, of, share), _less(made, by, share)
        if not left:
            null.append(made)
            continue
        term = next(iter(left))
        scale = left[term]
        pivots.append((term, {t: c / scale for t, c in left.items()}, {i: w / scale for i, w in made.items()}))
    return null[::-1]


def _less(one: Mapping[Key, Fraction], other: Mapping[Key, Fraction], share: Fraction) -> dict[Key, Fraction]:
    """Return one - share * other, without entries of 0."""
    left = dict(one)
    for key, value in other.items():
        left[key] = left.get(key, Fraction(0)) - share * value
    return {key: value for key, value in left.items() if value}


def _form(expression: Expression, known: Mapping[str, Form]) -> Form:
    """Return an expression as a linear combination of monomials."""
    word, *parts = expression
    if word == "number":
        return _number(parts[0])
    if word == "name":
        return known[parts[0]] if parts[0] in known else _base(expression)
    if word == TIME or not all(isinstance(part, tuple) for part in parts):
        return _base(expression)
    forms = [_form(part, known) for part in parts]
    if word == "plus":
        return _sum([(form, Fraction(1)) for form in forms])
    if word == "minus":
        return _sum([(forms[0], Fraction(1 if len(forms) == 2 else -1)), *((form, Fraction(-1)) for form in forms[1:])])
    if word == "times":
        return _product(forms)
    if word == "divide":
        return _quotient(*forms)
    return _opaque(word, forms)


def _number(value: float) -> Form:
    """Return a number as a form, by its decimal digits; one that is not finite is a base of its own."""
    if not math.isfinite(value):
        return _base(("number", repr(value)))
    exact = Fraction(repr(float(value)))
    return {ONE: exact} if exact else {}


def _base(base: tuple) -> Form:
    return {frozenset({(base, 1)}): Fraction(1)}


def _sum(parts: Sequence[tuple[Form, Fraction]]) -> Form:
    total: Form = {}
    for form, sign in parts:
        total = _less(total, form, -sign)
    return total


def _product(forms: Sequence[Form]) -> Form:
    total: Form = {ONE: Fraction(1)}
    for form in forms:
        if len(total) * len(form) > MAX_TERMS:
            form = _base(("form", frozenset(form.items())))
        terms: Form = {}
        for a, x in total.items():
            for b, y in form.items():
                both = _times(a, b)
                terms[both] = terms.get(both, Fraction(0)) + x * y
        total = {term: c for term, c in terms.items() if c}
    return total


def _quotient(above: Form, below: Form) -> Form:
    if len(below) != 1:
        whole = frozenset({(("form", frozenset(below.items())), -1)})
        return _product([above, {whole: Fraction(1)}])
    ((term, c),) = below.items()
    return _product([above, {frozenset((base, -power) for base, power in term): 1 / c}])


def _times(a: Monomial, b: Monomial) -> Monomial:
    powers = Counter(dict(a))
    powers.update(dict(b))
    return frozenset((base, power) for base, power in powers.items() if power)


def _opaque(word: str, forms: Sequence[Form]) -> Form:
    """Return a function of forms: a number if all of them are numbers, else a base of its own."""
    if all(form.keys() <= {ONE} for form in forms):
        numbers = [("number", float(form.get(ONE, Fraction(0)))) for form in forms]
        return _number(float(np.asarray(evaluate((word, *numbers), {}))))
    return _base((word, *(frozenset(form.items()) for form in forms)))
