"""Output folder of a fit: results, fitted case, residuals and a figure."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..cases.reading import apply_overrides, case_table
from ..core.errors import InputError
from ..files.atomic import replacing, write_bytes, write_json
from ..files.toml import toml_text
from .figures_fit import fit_figure


def claim_folder(path: Path) -> Path:
    """Create the folder of a fit.

    Raises
    ------
    InputError
        If the folder exists and is not empty, or cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise InputError(f"--out: {path} exists and is not empty; give a new name")
    except OSError as error:
        raise InputError(f"--out: {path} cannot be created: {error.strerror}") from None
    return path


def write_fit(
    folder: Path,
    case: Any,
    content: Mapping[str, Any],
    values: Mapping[str, float],
    columns: Mapping[str, np.ndarray],
    stresses: Mapping[str, np.ndarray],
) -> None:
    """Write ``fit.json``, ``fitted.toml``, ``residuals.csv`` and ``figures/fit.png``.

    Parameters
    ----------
    folder : Path
        Folder of the fit.
    case : PointCase
        Case before the fit.
    content : mapping
        Content of ``fit.json``; NaN and infinity become null.
    values : mapping of str to float
        Fitted number of each key.
    columns, stresses : mapping of str to (n,) array
        Measured data, and stresses of the fitted law [kPa].
    """
    write_json(folder / "fit.json", _plain(content))
    tables = apply_overrides(case_table(case), [f"{key}={value!r}" for key, value in values.items()])
    write_bytes(folder / "fitted.toml", toml_text(tables).encode())
    write_bytes(folder / "residuals.csv", _residuals(columns, stresses).encode())
    with replacing(folder / "figures" / "fit.png") as half:
        fit_figure(columns, stresses).savefig(half, dpi=150, format="png", metadata={"Software": None})


def _residuals(columns: Mapping[str, np.ndarray], stresses: Mapping[str, np.ndarray]) -> str:
    """Return CSV text with one line per measurement: time, stretches, and measured, fitted and residual value of each stress."""
    given = ("time_h", "lambda_x", "lambda_y", "lambda_z", "shear")
    table = {name: columns[name] for name in given if name in columns}
    for name, fitted in stresses.items():
        table |= {name: columns[name], f"fitted_{name}": fitted, f"residual_{name}": fitted - columns[name]}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows([[repr(float(cell)) for cell in row] for row in zip(*table.values(), strict=True)])
    return text.getvalue()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value
