"""The folder of a fit: numbers, the fitted case, residuals, a picture."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..cases.reading import apply_overrides
from ..core.errors import InputError
from ..files.atomic import replacing, write_bytes, write_json
from ..files.toml import toml_text
from ..cases.reading import case_table
from .figures_fit import fit_figure


def claim_folder(path: Path) -> Path:
    """Make the folder.

    Raises
    ------
    InputError
        If it is there already and not empty, or cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise InputError(f"--out: {path} is there already and not empty; give a new name")
    except OSError as error:
        raise InputError(f"--out: {path} cannot be made: {error.strerror}") from None
    return path


def write_fit(
    folder: Path,
    case: Any,
    told: Mapping[str, Any],
    values: Mapping[str, float],
    columns: Mapping[str, np.ndarray],
    stresses: Mapping[str, np.ndarray],
) -> None:
    """Write ``fit.json``, ``fitted.toml``, ``residuals.csv`` and ``figures/fit.png``.

    Parameters
    ----------
    folder : Path
    case : PointCase
        As it was before the fit.
    told : mapping
        What ``fit.json`` holds; NaN and infinity become null.
    values : mapping of str to float
        Fitted number of each key.
    columns, stresses : mapping of str to (n,) array
        What was measured, and the fitted law's stresses [kPa].
    """
    write_json(folder / "fit.json", _plain(told))
    tables = apply_overrides(case_table(case), [f"{key}={value!r}" for key, value in values.items()])
    write_bytes(folder / "fitted.toml", toml_text(tables).encode())
    write_bytes(folder / "residuals.csv", _residuals(columns, stresses).encode())
    with replacing(folder / "figures" / "fit.png") as half:
        fit_figure(columns, stresses).savefig(half, dpi=150, format="png", metadata={"Software": None})


def _residuals(columns: Mapping[str, np.ndarray], stresses: Mapping[str, np.ndarray]) -> str:
    """One row per measured one: time, stretches, and measured, fitted and the difference of each stress."""
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
