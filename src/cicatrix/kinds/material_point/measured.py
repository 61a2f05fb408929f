"""Measured stretches and stresses of a specimen: which are prescribed, and which a fitted law has to reproduce."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ...core.errors import InputError
from ...core.units import seconds_from_hours
from ...mechanics.point import Control, Instant, control
from .case import LoadingTable

STRESSES = {"sigma_x_kPa": (0, 0), "sigma_y_kPa": (1, 1), "sigma_z_kPa": (2, 2), "sigma_xy_kPa": (0, 1)}


class Experiment(NamedTuple):
    """Prescribed loading of a specimen, and the stresses that were measured."""

    by: Control
    """Which quantity is prescribed along each axis."""
    asked: Instant
    """Times and prescribed values, stacked along the first axis (n, ...)."""
    stresses: dict[str, np.ndarray]
    """Measured Cauchy stress (n,) [kPa] by column name."""


def experiment(loading: LoadingTable, columns: Mapping[str, np.ndarray]) -> Experiment:
    """Split the columns of a measurement into prescribed stretches (and shear) and measured stresses.

    Parameters
    ----------
    loading : LoadingTable
        Loading of the case, of which only the condition through the thickness is used.
    columns : mapping of str to (n,) array
        ``time_h``, ``lambda_x`` [1], ``sigma_x_kPa``; ``lambda_y`` and ``sigma_y_kPa``, without which y is free of stress;
        ``shear`` and ``sigma_xy_kPa``; ``lambda_z`` and ``sigma_z_kPa`` if the case's loading gives z. Others are ignored.

    Raises
    ------
    InputError
        If a column is missing or has a value that is not a number, times descend, or a stretch is not above 0.
    """
    pairs = {"lambda_x": "sigma_x_kPa"}
    if "lambda_y" in columns or "sigma_y_kPa" in columns:
        pairs["lambda_y"] = "sigma_y_kPa"
    if loading.thickness == "given":
        pairs["lambda_z"] = "sigma_z_kPa"
    if "shear" in columns and "sigma_xy_kPa" in columns:
        pairs["shear"] = "sigma_xy_kPa"
    found = _checked(columns, ["time_h", *pairs, *pairs.values()])
    n = len(found["time_h"])
    free_z = np.ones(n) if loading.thickness == "strain" else np.zeros(n)
    value = [found["lambda_x"], found.get("lambda_y", np.zeros(n)), found.get("lambda_z", free_z)]
    by = control(
        "stretch",
        "stretch" if "lambda_y" in pairs else "stress",
        "stretch" if loading.thickness in ("given", "strain") else "stress",
        loading.thickness == "incompressible",
    )
    shear = found.get("shear", np.zeros(n))
    asked = Instant(seconds_from_hours(found["time_h"]), np.column_stack(value), shear)
    return Experiment(by, asked, {name: found[name] for name in STRESSES if name in pairs.values()})


def _checked(columns: Mapping[str, np.ndarray], names: list[str]) -> dict[str, np.ndarray]:
    found = {}
    for name in names:
        if name not in columns:
            raise InputError(f"column {name} is missing; there are {', '.join(columns) or 'none'}")
        try:
            found[name] = np.asarray(columns[name], float)
        except ValueError:
            raise InputError(f"column {name} must hold numbers alone") from None
        bad = np.flatnonzero(~np.isfinite(found[name]))
        if len(bad):
            raise InputError(f"column {name} has no number in row {bad[0] + 1}; leave such rows out")
        if name.startswith("lambda") and np.any(found[name] <= 0.0):
            raise InputError(f"column {name} must be above 0; got {found[name].min():g}")
    if np.any(np.diff(found["time_h"]) < 0.0):
        row = int(np.flatnonzero(np.diff(found["time_h"]) < 0.0)[0]) + 2
        raise InputError(f"column time_h must ascend; it does not in row {row}")
    return found
