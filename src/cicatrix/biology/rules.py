"""Rules of a signalling network as text: ``TGFB & !smad7 => smad3``, or as Netflux has it, ``TGFB AND NOT smad7 -> smad3``."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from typing import NamedTuple, NoReturn

from ..core.errors import InputError

TOKEN = re.compile(r"\s*(=+>|-+>|&|!|[A-Za-z0-9_]+|\S)")
ARROWS = {"=>", "->", "\u21d2", "\u2192"}  # spreadsheets turn the first two into the others
AND, NOT = {"&", "+", "AND"}, {"!", "NOT"}
NAME = re.compile(r"[A-Za-z0-9_]+")
HINTS = {
    "|": "OR is two reactions with the same target",
    "&&": "AND is a single &",
    "OR": "OR is two reactions with the same target",
    "~": "NOT is written !",
    "-": "a species is written with letters, digits and _",
    "=": "an arrow is written =>",
    ">": "an arrow is written =>",
}


class RuleFactor(NamedTuple):
    """A species that activates a reaction, or inhibits it if negated."""

    species: str
    is_negated: bool


class Rule(NamedTuple):
    """Reaction in which all factors together (AND) act on the target; a reaction without factors is an input."""

    factors: tuple[RuleFactor, ...]
    target: str

    @property
    def is_input(self) -> bool:
        """Whether the reaction has no factors, so that it is an input of the network."""
        return not self.factors

    def __str__(self) -> str:
        """Return the rule as text."""
        left = " & ".join(("!" if factor.is_negated else "") + factor.species for factor in self.factors)
        return f"{left} => {self.target}".strip()


class _Token(NamedTuple):
    text: str
    column: int
    """Column of the token's first character, counted from 1."""


def parse_rule(text: str) -> Rule:
    """Parse a rule: factors joined by ``&``, inhibiting ones after ``!``, then ``=>`` and one target; ``=> TGFB`` is an input.

    As in the program Netflux, AND may also be ``+`` or ``AND``, NOT ``NOT``, and the arrow ``->``.

    Raises
    ------
    InputError
        If the rule is not valid. The message gives the column, what was found and what was expected; the caller puts the
        name of the reaction before it.
    """
    tokens = [_Token(found[1], found.start(1) + 1) for found in TOKEN.finditer(text)]
    tokens.append(_Token("", len(text.rstrip()) + 1))
    factors, i = [], 0
    while not _is_arrow(tokens[i].text):
        if factors:
            i = _passed(text, tokens, i, AND, '"&" or "=>"')
        is_negated = tokens[i].text in NOT
        i += is_negated
        factors.append(RuleFactor(_name(text, tokens, i), is_negated))
        i += 1
    target = _name(text, tokens, i + 1)
    _passed(text, tokens, i + 2, {""}, "one target and then the end of the rule")
    return Rule(tuple(factors), target)


def unknown_species(name: str, known: Iterable[str], kind: str = "species") -> str:
    """Return the message that a name (of a species, or another ``kind``) is unknown, with the most similar known name."""
    lower = {one.lower(): one for one in known}
    near = difflib.get_close_matches(name.lower(), lower, n=1)
    if near:
        return f'names the unknown {kind} "{name}"; did you mean "{lower[near[0]]}"?'
    listed = sorted(lower.values())
    return f'names the unknown {kind} "{name}"; known: {", ".join(listed[:20]) or "none"}{", ..." if len(listed) > 20 else ""}'


def _is_arrow(token: str) -> bool:
    """Return whether a token is an arrow, long or short."""
    return re.sub("[=-]+(?=.>)", "", token) in ARROWS


def _name(text: str, tokens: list[_Token], i: int) -> str:
    if not NAME.fullmatch(tokens[i].text):
        _refuse(text, tokens[i], "a species")
    return tokens[i].text


def _passed(text: str, tokens: list[_Token], i: int, expected: set[str], words: str) -> int:
    if tokens[i].text not in expected:
        _refuse(text, tokens[i], words)
    return i + 1


def _refuse(text: str, token: _Token, expected: str) -> NoReturn:
    found = f'found "{token.text}"' if token.text else "found its end"
    at = token.column - 1
    is_sign = bool(token.text) and not NAME.fullmatch(token.text)
    pieces = (text[at - 1 : at + 1], text[at : at + 2], token.text) if is_sign else (token.text,)
    hint = next((HINTS[piece] for piece in pieces if piece in HINTS), "")
    raise InputError(
        f'has the rule "{text}", which does not parse at column {token.column}: {expected} expected, {found}'
        f"{f' ({hint})' if hint else ''}"
    )
