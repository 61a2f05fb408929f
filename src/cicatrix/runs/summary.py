"""Results of a run in a few lines: as text for a terminal, and as HTML for a notebook."""

from __future__ import annotations

import html
import textwrap
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .quantity import Quantity
    from .results import Results

COLUMNS, NUMBERS = 100, 8  # largest length of a line; largest number of outcomes


def text_of(results: Results) -> str:
    """Return a summary of at most 15 lines of 100 columns: kind, status, size of the history, main outcomes and folder."""
    state, sentence = results.status
    lines = [f"Results of a run of kind {results.kind}: {state}"]
    lines += textwrap.wrap(sentence, COLUMNS, max_lines=2, placeholder=" ...")
    lines.append(f"history: {_size(results)}")
    lines += [f"  {name:<30} {quantity!r}" for name, quantity in _main(results)]
    left = len(results.outcome) - len(_main(results))
    if left:
        lines.append(f"  and {left} more in .outcome")
    lines.append(f"folder: {_place(results)}")
    return "\n".join(line if len(line) <= COLUMNS else f"{line[: COLUMNS - 4]} ..." for line in lines)


def html_of(results: Results) -> str:
    """Return the same summary as HTML, with the outcomes as a table; all text is escaped."""
    state, sentence = results.status
    head = f"<p><b>{html.escape(results.kind)}: {html.escape(state)}</b><br>{html.escape(sentence)}</p>"
    rows = "".join(f"<tr>{''.join(_cells(name, quantity))}</tr>" for name, quantity in _main(results))
    left = len(results.outcome) - len(_main(results))
    more = f"<p>and {left} more in <code>.outcome</code></p>" if left else ""
    foot = f"<p>history: {html.escape(_size(results))}<br>folder: {html.escape(_place(results))}</p>"
    return f"{head}<table>{rows}</table>{more}{foot}"


def _main(results: Results) -> list[tuple[str, Quantity]]:
    """Return the first outcomes; those with a dot in the name (of one position or visit) are sorted behind all others."""
    return sorted(results.outcome.items(), key=lambda item: "." in item[0])[:NUMBERS]


def _cells(name: str, quantity: Quantity) -> Iterator[str]:
    value = repr(type(quantity)(quantity.value, quantity.unit))
    for text in (name, value, quantity.note):
        yield f"<td>{html.escape(text)}</td>"


def _size(results: Results) -> str:
    columns = list(results.history)
    if not columns:
        return "no rows"
    n, names = len(results.history[columns[0]]), ", ".join(columns)
    return textwrap.shorten(f"{n} rows of {len(columns)} columns: {names}", COLUMNS - 10, placeholder=" ...")


def _place(results: Results) -> str:
    if results.folder is None:
        return "none"
    return f"{results.folder}{' (removed with this object)' if results.is_temporary else ''}"
