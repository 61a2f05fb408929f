"""Write and read history.csv: one numbered row per cycle or step, flushed as it is recorded; equal runs give equal bytes."""

from __future__ import annotations

import csv
import hashlib
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np

from .atomic import writing


class HistoryMark(NamedTuple):
    """How far a history was written at some moment, and the hash by which that part is known again."""

    rows: int
    """Number of rows, without the names of the columns."""
    size: int
    """Bytes written [B]."""
    sha256: str
    """Hash of these bytes."""


class History:
    """Writer of the rows of a run; the names of the first row are the columns.

    Parameters
    ----------
    path : Path
        The CSV file; the first row of a new history replaces it.
    """

    def __init__(self, path: Path):
        self.path = path
        self._columns: list[str] = []
        self._rows, self._size, self._hash = 0, 0, hashlib.sha256()
        self._stream: TextIO | None = None

    @classmethod
    def continued(cls, path: Path, mark: HistoryMark) -> History:
        """Go on with a history at a mark; what was written after it is removed.

        Raises
        ------
        ValueError
            If the file does not hold what the mark says: rows before it were changed or removed.
        """
        history, content = cls(path), b""
        if mark.size:
            with path.open("rb") as stream:
                content = stream.read(mark.size)
        history._hash.update(content)
        history._rows, history._size = mark.rows, len(content)
        if history.mark() != mark:
            raise ValueError(f"the first {mark.rows} rows of {path.name} are not those that were written")
        history._columns = next(csv.reader([content.decode().partition("\n")[0]]), [])
        return history

    def mark(self) -> HistoryMark:
        """Return how far the history is written."""
        return HistoryMark(self._rows, self._size, self._hash.hexdigest())

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
        self._rows += 1

    def cut(self) -> None:
        """Remove from the file all that this writer has not written: later rows of a run that was killed."""
        self.close()
        with writing(self.path):
            if self._size:
                os.truncate(self.path, self._size)
            else:
                self.path.unlink(missing_ok=True)

    def sync(self) -> None:
        """Write the recorded rows from the operating system's buffers to the disk."""
        if self._stream is not None:
            with writing(self.path):
                os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Close the file; a later row opens it again."""
        stream, self._stream = self._stream, None
        if stream is not None:
            with writing(self.path), stream:
                os.fsync(stream.fileno())

    def _start(self, columns: list[str]) -> None:
        with writing(self.path):
            self.path.unlink(missing_ok=True)
        self._write(columns)
        self._columns = columns

    def _write(self, cells: list[str]) -> None:
        """Append a line, and flush it to the operating system."""
        text = table_text(cells, ())
        with writing(self.path):
            if self._stream is None:
                self._stream = self.path.open("a", encoding="utf-8", newline="")
            self._stream.write(text)
            self._stream.flush()
        content = text.encode()
        self._hash.update(content)
        self._size += len(content)


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
