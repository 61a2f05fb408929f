"""The one reader of tables that a user wrote: CSV as spreadsheets, instruments and editors save it.

Separator: comma, semicolon or tab, judged from the row of names. Cells may be quoted (RFC 4180). Blank lines, lines that start
with ``#`` and a title above the names are left out. Empty, ``NA``, ``N/A`` and ``NaN`` are missing values. The decimal mark is
the point, or the comma where the cells leave no other reading (``numerals.py``). Rows are counted as a text editor does.
"""

from __future__ import annotations

import csv
import difflib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from .numerals import PLAIN, numerals_of
from .text import tolerant_text_of

SEPARATORS = ("\t", ";", ",")  # the rarer one is in a name, the earlier
SPREADSHEET_ERRORS = ("#N/A", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#NULL!")  # cells, not comments
MISSING = ("", "na", "n/a", "#n/a", "nan")
NUMERAL = re.compile(r"\W{0,2}[0-9]")  # beginning of a number, right or wrong; a unit such as mm2 has none
MOST_TITLES = 5  # rows above the names
DIRECTIVE = re.compile(r'"?sep=([\t;,])"?')  # first line by which a spreadsheet names the separator


@dataclass(frozen=True)
class CsvTable:
    """A table of texts with named columns."""

    path: Path
    names: tuple[str, ...]
    """Names of the columns; those without a name are empty."""
    rows: tuple[tuple[str, ...], ...]
    """Cells, without blanks around them."""
    lines: tuple[int, ...]
    """Number of the line on which each row starts, from 1."""
    notes: tuple[str, ...]
    """What was assumed on reading, in sentences."""

    def fault(self, row: int, name: str, words: str) -> InputError:
        """Return the error about one cell: its file, row and column, then ``words``."""
        return InputError(f"{self.path}: row {self.lines[row]}, column {name}: {words}")

    def require(self, names: Sequence[str]) -> None:
        """Check that the columns are there.

        Raises
        ------
        InputError
            If one is not; the most similar name is told.
        """
        for name in names:
            if name not in self.names:
                raise InputError(f"{self.path}: {missing_column(name, self.names)}")

    def texts(self, name: str) -> list[str]:
        """Return the cells of a column."""
        at = self.names.index(name)
        return [row[at] for row in self.rows]

    def numbers(self, names: Sequence[str]) -> dict[str, np.ndarray]:
        """Return columns of numbers: name -> (n_rows,); a missing value is NaN.

        Raises
        ------
        InputError
            If a column or a cell is not as described; the message names row, column and cell.
        """
        self.require(names)
        columns = {name: self.texts(name) for name in names}
        self._check_first([texts[0] for texts in columns.values()])
        written = numerals_of([text for texts in columns.values() for text in texts])

        def number(row: int, name: str, text: str) -> float:
            try:
                return np.nan if text.lower() in MISSING else written.number(text)
            except ValueError as error:
                raise self.fault(row, name, f'"{text}" {error}') from None

        return {
            name: np.array([number(row, name, text) for row, text in enumerate(texts)], float)
            for name, texts in columns.items()
        }

    def _check_first(self, cells: Sequence[str]) -> None:
        """Refuse a row of units below the names."""
        if any(cells) and not any(NUMERAL.match(cell) or cell.lower() in MISSING[1:] for cell in cells):
            said = ", ".join(filter(None, cells))
            words = f"holds no number but {said}: if these are units, delete the row or start it with #"
            raise InputError(f"{self.path}: row {self.lines[0]} {words}")


def read_table(path: Path, names: Sequence[str] = (), spellings: Sequence[str] = ()) -> CsvTable:
    """Read a table.

    Parameters
    ----------
    path : Path
        A text file.
    names : sequence of str
        Columns that the caller looks for; they tell the row of names from a title above it, and separators apart.
    spellings : sequence of str
        Other names under which the caller accepts columns.

    Raises
    ------
    InputError
        If the file is not such a table; the message names the row.
    """
    text, notes = tolerant_text_of(path)
    if text and not text.endswith("\n"):
        notes.append("The last row of the table has no line break at its end: check that the file is whole.")
    directive = DIRECTIVE.fullmatch(text.partition("\n")[0])
    text = text if directive is None else text.replace(directive[0], "", 1)
    known = {name.lower() for name in (*names, *spellings)}
    records = list(_records(path, text, directive[1] if directive else _separator(text, known)))
    if not records:
        such = f", {', '.join(names)}" if names else ""
        raise InputError(f"{path} is empty: it must start with a row of column names{such}")
    head, *rows = records[_titles(records, known) :]
    _check_names(path, *head, known)
    if not rows:
        raise InputError(f"{path} has no rows below its column names")
    cells = tuple(_fitted(path, line, row, len(head[1])) for line, row in rows)
    return CsvTable(path, tuple(head[1]), cells, tuple(line for line, _ in rows), tuple(notes))


def missing_column(name: str, there: Sequence[str]) -> str:
    """Return a sentence for a column that is not there, with the most similar name among those that are."""
    named = [other for other in there if other]
    plain = {re.sub(r"\W+", "_", other.lower()).strip("_"): other for other in named}
    near = difflib.get_close_matches(name.lower(), plain, n=1, cutoff=0.75)
    hint = f' (is it "{plain[near[0]]}"?)' if near else ""
    if len(named) == 1 and (name in named[0] or re.search(r"\s", named[0])):
        hint = " (columns are separated by commas, semicolons or tabs)"
    return f"column {name} is missing{hint}; there are {', '.join(named)}"


def _records(path: Path, text: str, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of the first line and the cells of each row that is neither blank nor a comment."""
    is_inside = False  # whether the next line goes on in an open quote

    def lines() -> Iterator[str]:
        nonlocal is_inside
        for line in text.split("\n"):
            is_comment = line.lstrip().startswith("#") and not line.lstrip().startswith(SPREADSHEET_ERRORS)
            blank = "" if is_comment and not is_inside else re.sub(rf'" +(?={separator}|$)', '"', line)
            is_inside = True
            yield blank + "\n"

    reader, start = csv.reader(lines(), delimiter=separator, skipinitialspace=True, strict=True), 1
    try:
        for cells in reader:
            is_inside = False
            if any(map(str.strip, cells)):
                yield start, [cell.strip() for cell in cells]
            start = reader.line_num + 1
    except csv.Error as error:
        long = f"a cell has more than {csv.field_size_limit()} characters" if "field limit" in str(error) else ""
        words = long or f'a " is not closed, or not alone in its cell ({error})'
        raise InputError(f"{path}: row {start} cannot be split into cells: {words}") from None


def _separator(text: str, known: set[str]) -> str:
    """Return the separator that finds most of the known names near the top, else that of which the first line has most."""
    top = [line for line in text.split("\n")[: 10 * MOST_TITLES] if line.strip() and not line.startswith("#")]

    def found(separator: str) -> tuple[int, int]:
        split = [{cell.strip(" \t\"'").lower() for cell in line.split(separator)} for line in top]
        return max((len(known & cells) for cells in split), default=0), top[0].count(separator) if top else 0

    return max(SEPARATORS, key=found)


def _titles(records: Sequence[tuple[int, list[str]]], known: set[str]) -> int:
    """Return how many rows are above the row of names, the first with a known name; 0 if there is none."""
    near = enumerate(records[: MOST_TITLES + 1])
    return next((number for number, (_, cells) in near if known & {cell.lower() for cell in cells}), 0)


def _check_names(path: Path, line: int, names: Sequence[str], known: set[str]) -> None:
    said = [name for name in names if name]
    if all(PLAIN.fullmatch(name) for name in said):
        raise InputError(f'{path}: row {line} must hold the column names; got "{said[0]}" (a # makes a line a comment)')
    alike = [name.lower() if name.lower() in known else name for name in said]  # t and T may be two columns of others
    twice = [name for name, same in zip(said, alike) if alike.count(same) > 1]
    if twice:
        raise InputError(f"{path}: column {twice[0]} is there twice: delete or rename one of the two")


def _fitted(path: Path, line: int, cells: list[str], width: int) -> tuple[str, ...]:
    """Return a row without the empty cells beyond the last name."""
    while len(cells) > width and not cells[-1]:
        cells = cells[:-1]
    if len(cells) != width:
        hint = "; numbers with a decimal comma need semicolons or tabs between columns" if len(cells) > width else ""
        raise InputError(f"{path}: row {line} must have {width} columns, like the row of names; got {len(cells)}{hint}")
    return tuple(cells)
