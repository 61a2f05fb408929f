"""The one form in which a sentence reaches a terminal: a line without control characters and without endless words."""

from __future__ import annotations

import re

LONGEST, HEAD, TAIL = 300, 120, 60  # characters of a word that is shown whole; of a longer one, those at its ends


def printable(sentence: str) -> str:
    """Return a sentence on one line; what a terminal would obey or hide is escaped as in a Python string, long words are cut.

    Escaped is what Unicode does not call printable: control and format characters, and surrogates.
    """
    line = re.sub(rf"\S{{{LONGEST},}}", _shortened, re.sub(r"\s*\n\s*", " ", sentence.strip()))
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def _shortened(word: re.Match[str]) -> str:
    return f"{word[0][:HEAD]}...{word[0][-TAIL:]}"
