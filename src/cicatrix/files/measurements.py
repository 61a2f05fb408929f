"""Tables of measured numbers: CSV with a row of column names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.errors import InputError
from .history import read_history


def read_measurements(path: Path) -> dict[str, np.ndarray]:
    """Read a CSV file such as a run's ``history.csv``: column -> (n,); an empty cell is NaN.

    Raises
    ------
    InputError
        If the file cannot be read, or a row has more or fewer columns than the first one.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text: {error}") from None
    lines = [line for line in text.splitlines() if line.strip()]
    if len(lines) < 2:
        raise InputError(f"{path}: must have a row of column names and at least one row of numbers")
    width = lines[0].count(",")
    ragged = [number for number, line in enumerate(lines, 1) if line.count(",") != width]
    if ragged:
        raise InputError(f"{path}: row {ragged[0]} must have {width + 1} columns, like the first row")
    if not text.endswith("\n"):
        raise InputError(f"{path}: the file must end with a line break; without one it may be cut off")
    return {name.strip(): column for name, column in read_history(path).items()}
