"""Numbers as people and spreadsheets write them: decimal point or comma, grouped thousands; nothing is guessed."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

MINUS = "\N{MINUS SIGN}"
EXPONENT = r"(?:[eE][+-]?[0-9]+)?"
PLAIN = re.compile(rf"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+){EXPONENT}")  # linear: no run of digits can be split
EITHER = re.compile(rf"[+-]?(?=[.,]*[0-9])([0-9.,]+){EXPONENT}")
ONE_GROUP = re.compile(r"[1-9][0-9]{0,2}[.,][0-9]{3}")  # 1,234: thousands, or three decimals
SPACED = re.compile(r"(?<=[0-9])['\N{RIGHT SINGLE QUOTATION MARK}\u00a0\u2009\u202f](?=[0-9]{3}(?![0-9]))")  # 1'234
OTHER = {".": ",", ",": "."}


def without_underscore(text: str) -> str:
    """Return the text of a number of a file format, for Python to read: ValueError for "1_0", which it would take for 10."""
    if "_" in text:
        raise ValueError(f'"{text}" is not a number')
    return text


class Numerals(NamedTuple):
    """How the numbers of a table are written."""

    mark: str = "."
    """Decimal mark, point or comma; empty if the numbers leave both open."""
    is_grouped: bool = False
    """Whether the other mark is seen to group thousands, as in 12,345.6 or 1,234,567."""

    def number(self, text: str) -> float:
        """Return the number that a text writes.

        Raises
        ------
        ValueError
            If it is no finite number, or may be one of two; the message tells which, and follows the text.
        """
        text = _plain(text)
        if PLAIN.fullmatch(text) and self.mark != ",":
            return _finite(text)
        if not EITHER.fullmatch(text):
            raise ValueError("is not a number")
        mark, group = self.mark or ".", OTHER[self.mark or "."]
        if group in text and not (self.is_grouped and _is_grouped(text, mark, group)):
            raise ValueError(self._refusal(text))
        plain = text.replace(group, "").replace(mark, ".")
        if not PLAIN.fullmatch(plain):
            raise ValueError("is not a number")
        return _finite(plain)

    def _refusal(self, text: str) -> str:
        if ONE_GROUP.fullmatch(text.lstrip("+-")):
            decimal, thousands = re.sub("[.,]", ".", text), re.sub("[.,]", "", text)
            return f"may be {decimal} or {thousands}: write one of the two"
        words = {".": "point", ",": "comma"}
        return f"is not a number with a decimal {words[self.mark or '.']}, as in other cells"


def numerals_of(texts: Sequence[str]) -> Numerals:
    """Judge from all numbers of a table how they are written; of two marks in use, take the more frequent one."""
    if not any("," in text or text.count(".") > 1 for text in texts):
        return Numerals()
    texts = [_plain(text) for text in texts]
    votes = [_vote(text) for text in texts]
    points, commas = votes.count("."), votes.count(",")
    mark = "" if points == commas == 0 else "." if points >= commas else ","
    group = OTHER.get(mark, "")
    return Numerals(mark, any(_shows_groups(text, group) for text in texts if group and group in text))


def _plain(text: str) -> str:
    """Return a text with the minus of a keyboard and without spaces or apostrophes between thousands."""
    return SPACED.sub("", text.replace(MINUS, "-"))


def _vote(text: str) -> str:
    """Return the decimal mark that a text can only have; empty if it tells nothing."""
    body = EITHER.fullmatch(text)
    if not body or ONE_GROUP.fullmatch(body[1]):
        return ""
    points, commas = body[1].count("."), body[1].count(",")
    if points and commas:
        return "." if body[1].rfind(".") > body[1].rfind(",") else ","
    if points + commas == 1:
        return "." if points else ","
    return "," if points else "." if commas else ""  # 1.234.567 or 1,234,567: what is repeated groups thousands


def _shows_groups(text: str, group: str) -> bool:
    body = EITHER.fullmatch(text)
    return bool(body) and (text.count(group) > 1 or OTHER[group] in text) and _is_grouped(text, OTHER[group], group)


def _is_grouped(text: str, mark: str, group: str) -> bool:
    g, m = re.escape(group), re.escape(mark)
    return bool(re.fullmatch(rf"[+-]?[1-9][0-9]{{0,2}}(?:{g}[0-9]{{3}})+(?:{m}[0-9]*)?{EXPONENT}", text))


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError("is too large for a number")
    return value
