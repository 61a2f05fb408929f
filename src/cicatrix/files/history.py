"""Write and read history.csv: one numbered row per cycle or step, flushed as it is recorded; equal runs give equal bytes."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from .atomic import write_bytes


class History:
    """Writer of the rows of a run; the names of the first row are the columns.

    Parameters
    ----------
    path : Path
        The CSV file; an existing one is continued.
    """

    def __init__(self, path: Path):
        self.path = path
        self._columns: list[str] = _columns(path)
        self._stream: TextIO | None = None

    def record(self, row: Mapping[str, Any]) -> None:
        """Append a row to the file, and flush it to the operating system.

        Parameters
        ----------
        row : mapping of str to number
            Values by column; the first column numbers the row (``cycle``, ``step``). Floats are written exactly.

        Raises
        ------
        ValueError
            If the names are not those of the first row.
        """
        if not self._columns:
            self._start(list(row))
        if list(row) != self._columns:
            raise ValueError(f"a history row must have the columns {self._columns}; got {list(row)}")
        self._write([_text(value) for value in row.values()])

    def cut_after(self, last: int) -> None:
        """Remove the rows whose first column is above ``last``, and an incomplete last row."""
        if not self._columns:
            self.path.unlink(missing_ok=True)
            return
        self.close()
        head, *rows = _whole_lines(self.path)
        kept = [row for row in rows if int(next(csv.reader([row]))[0]) <= last]
        write_bytes(self.path, "".join([head, *kept]).encode())

    def sync(self) -> None:
        """Write the recorded rows from the operating system's buffers to the disk."""
        if self._stream is not None:
            os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Close the file; a later row opens it again."""
        if self._stream is not None:
            self.sync()
            self._stream.close()
            self._stream = None

    def _start(self, columns: list[str]) -> None:
        self._columns = columns
        self.path.unlink(missing_ok=True)
        self._write(columns)

    def _write(self, cells: list[str]) -> None:
        if self._stream is None:
            self._stream = self.path.open("a", encoding="utf-8", newline="")
        csv.writer(self._stream, lineterminator="\n").writerow(cells)
        self._stream.flush()


def read_history(path: Path) -> dict[str, np.ndarray]:
    """Read a history: one array (n_rows,) per column, numbers where all are numbers; an empty cell is NaN."""
    if not path.is_file():
        return {}
    reader = csv.reader(io.StringIO("".join(_whole_lines(path))))
    columns = next(reader, [])
    rows = list(reader)
    return {name: _array([row[i] for row in rows]) for i, name in enumerate(columns)}


def table_text(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table as CSV text; floats are written so that they are read back exactly."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    writer.writerows([_text(cell) for cell in row] for row in rows)
    return stream.getvalue()


def _array(cells: list[str]) -> np.ndarray:
    for kind in (int, float):
        try:
            return np.array([kind(cell or "nan") for cell in cells], kind)
        except ValueError:
            continue
    return np.array(cells)


def _columns(path: Path) -> list[str]:
    lines = _whole_lines(path) if path.is_file() else []
    return next(csv.reader(lines[:1]), [])


def _whole_lines(path: Path) -> list[str]:
    with path.open(encoding="utf-8", newline="") as stream:
        return [line for line in stream if line.endswith("\n")]


def _text(value: Any) -> str:
    if value is None:
        return ""
    value = value.item() if isinstance(value, (np.generic, np.ndarray)) else value
    if isinstance(value, bool):
        return str(int(value))
    return repr(value) if isinstance(value, float) else str(value)
