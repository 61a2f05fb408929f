"""Measured stretches and stresses of a specimen: which are prescribed, and which a fitted law has to reproduce."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...core.errors import InputError
from ...core.units import seconds_from_hours
from ...files.measurements import Measurements
from ...mechanics.point import Control, Instant, control
from .case import LoadingTable

STRESSES = {"sigma_x_kPa": (0, 0), "sigma_y_kPa": (1, 1), "sigma_z_kPa": (2, 2), "sigma_xy_kPa": (0, 1)}
LARGEST_STRETCH, SMALLEST_STRETCH = 10.0, 0.5  # a specimen beyond the one, or never above the other, has other units
LARGEST_STRESS = 1e9  # kPa; beyond it there is no tissue
CONTRADICTION = 0.02  # relative difference between a column and what the loading assumes in its place that is said


class Experiment(NamedTuple):
    """Prescribed loading of a specimen, and the stresses that were measured."""

    by: Control
    """Which quantity is prescribed along each axis."""
    asked: Instant
    """Times and prescribed values, stacked along the first axis (n, ...)."""
    stresses: dict[str, np.ndarray]
    """Measured Cauchy stress (n,) [kPa] by column name."""
    columns: dict[str, np.ndarray]
    """All columns in use (n,): times, stretches, shear and stresses."""
    notes: tuple[str, ...] = ()
    """What was assumed or left out, in sentences."""


def experiment(loading: LoadingTable, measured: Measurements) -> Experiment:
    """Split the columns of a measurement into prescribed stretches (and shear) and measured stresses.

    Parameters
    ----------
    loading : LoadingTable
        Loading of the case, of which only the condition through the thickness is used.
    measured : Measurements
        ``time_h``, ``lambda_x`` [1], ``sigma_x_kPa``; ``lambda_y`` and ``sigma_y_kPa``, without which y is free of stress;
        ``shear``, and ``sigma_xy_kPa`` with it; ``lambda_z`` and ``sigma_z_kPa`` if the case's loading gives z.

    Raises
    ------
    InputError
        If a column is missing, no row is whole, times descend, or a column of stretches cannot be one.
    """
    names = _names(loading, measured.columns)
    found, rows = _whole(measured, names)
    spare = {name: values[rows] for name, values in measured.columns.items()}
    notes = (*measured.notes, *_contradictions(loading.thickness, spare, names), *_gaps(measured, names, rows))
    stresses = {name: found[name] for name in STRESSES if name in found}
    return Experiment(*_prescribed(loading.thickness, found), stresses, found, notes)


def loading_of(measured: Measurements) -> dict[str, Any]:
    """Return the keys of a table [loading] that follows a measurement: times that ascend, and stretches at them.

    A single time is followed by another an hour later, as a loading has two at least; without a whole row there is nothing.

    Raises
    ------
    InputError
        If times or stretches along x are missing.
    """
    for name in ("time_h", "lambda_x"):
        if name not in measured.columns:
            raise measured.missing(name)
    there = [name for name in ("lambda_x", "lambda_y", "shear") if name in measured.columns]
    table = np.column_stack([measured.columns[name] for name in ("time_h", *there)])
    table = table[np.isfinite(table).all(axis=1)]
    times, first = np.unique(table[:, 0], return_index=True)
    if not len(times):
        return {}
    if len(times) == 1:
        times, first = np.append(times, times + 1.0), np.append(first, first)
    values = {name.removeprefix("lambda_"): table[first, 1 + at].tolist() for at, name in enumerate(there)}
    return {"time_h": times.tolist()} | values


def _names(loading: LoadingTable, columns: Mapping[str, np.ndarray]) -> list[str]:
    """Return the columns that a fit needs: prescribed and measured."""
    pairs = {"lambda_x": "sigma_x_kPa"}
    if "lambda_y" in columns or "sigma_y_kPa" in columns:
        pairs["lambda_y"] = "sigma_y_kPa"
    if loading.thickness == "given":
        pairs["lambda_z"] = "sigma_z_kPa"
    shear = [name for name in ("shear", "sigma_xy_kPa") if "shear" in columns and name in columns]
    return ["time_h", *pairs, *pairs.values(), *shear]


def _prescribed(thickness: str, found: Mapping[str, np.ndarray]) -> tuple[Control, Instant]:
    """Return what is prescribed along each axis, and its values at the measurements."""
    n = len(found["time_h"])
    free_z = np.ones(n) if thickness == "strain" else np.zeros(n)
    value = [found["lambda_x"], found.get("lambda_y", np.zeros(n)), found.get("lambda_z", free_z)]
    by = control(
        "stretch",
        "stretch" if "lambda_y" in found else "stress",
        "stretch" if thickness in ("given", "strain") else "stress",
        thickness == "incompressible",
    )
    return by, Instant(seconds_from_hours(found["time_h"]), np.column_stack(value), found.get("shear", np.zeros(n)))


def _gaps(measured: Measurements, names: Sequence[str], rows: np.ndarray) -> Iterator[str]:
    """Yield a sentence if not all rows are in use."""
    gaps = np.setdiff1d(np.arange(len(measured.columns["time_h"])), rows)
    if len(gaps):
        words = f"are left out: {len(gaps)}, the first is row {measured.row(gaps[0])}"
        yield f"Rows without a value in each of {', '.join(names)} {words}."


def _whole(measured: Measurements, names: Sequence[str]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return the columns (n,) at the rows that miss no value, and the indices of these rows."""
    for name in names:
        if name not in measured.columns:
            raise measured.missing(name)
    table = np.column_stack([np.asarray(measured.columns[name], float) for name in names])
    rows = np.flatnonzero(np.isfinite(table).all(axis=1))
    if not len(rows):
        raise InputError(f"no row has a value for each of {', '.join(names)}")
    found = dict(zip(names, table[rows].T))
    for name in (name for name in names if name.startswith("lambda")):
        _check_stretch(name, found[name], [measured.row(row) for row in rows])
    for name in (name for name in names if name.startswith("sigma")):
        if (largest := np.abs(found[name]).max()) > LARGEST_STRESS:
            row = measured.row(rows[int(np.argmax(np.abs(found[name])))])
            raise InputError(
                f"column {name} must be a stress in kPa; got {largest:g} in row {row}: no tissue bears that"
            )
    descends = np.flatnonzero(np.diff(found["time_h"]) < 0.0)
    if len(descends):
        raise InputError(f"column time_h must ascend; it does not in row {measured.row(rows[descends[0] + 1])}")
    return found, rows


def _check_stretch(name: str, values: np.ndarray, lines: Sequence[int]) -> None:
    """Refuse strains, and stretches in percent."""
    words = f"column {name} must be a stretch, length over length at rest"
    if values.min() <= 0.0:
        at = int(np.argmax(values <= 0.0))
        raise InputError(f"{words}, above 0; got {values[at]:g} in row {lines[at]}: of a strain take 1 + strain")
    if values.max() > LARGEST_STRETCH:
        row = lines[int(np.argmax(values))]
        raise InputError(
            f"{words}; got {values.max():g} in row {row}: divide percent by 100, and of a strain take 1 + strain"
        )
    if values.max() < SMALLEST_STRETCH:
        raise InputError(f"{words}, 1 at rest; the largest is {values.max():g}: of a strain take 1 + strain")


def _contradictions(thickness: str, columns: Mapping[str, np.ndarray], used: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each measured column that the fit does not use, if it says something else than what is assumed."""
    spare = {name: values for name, values in columns.items() if name not in used and np.isfinite(values).any()}
    if "lambda_z" in spare:
        yield from _spare_stretch(thickness, columns)
    if "sigma_z_kPa" in spare:
        largest = float(np.nanmax(np.abs(spare["sigma_z_kPa"])))
        if thickness == "strain" or largest > CONTRADICTION * float(np.nanmax(np.abs(columns["sigma_x_kPa"]))):
            assumed = "is what plane strain makes it" if thickness == "strain" else "is 0"
            yield f"Column sigma_z_kPa is not used: the loading assumes that it {assumed}; it reaches {largest:.3g} kPa."
    if "sigma_xy_kPa" in spare and np.nanmax(np.abs(spare["sigma_xy_kPa"])) > 0.0:
        yield "Column sigma_xy_kPa is not used, as there is no column shear."


def _spare_stretch(thickness: str, columns: Mapping[str, np.ndarray]) -> Iterator[str]:
    z = columns["lambda_z"]
    if thickness == "incompressible" and "lambda_y" in columns:
        volume = columns["lambda_x"] * columns["lambda_y"] * z
        worst = float(volume[np.nanargmax(np.abs(volume - 1.0))])
        if abs(worst - 1.0) > CONTRADICTION:
            yield (
                f"Column lambda_z contradicts incompressibility: lambda_x lambda_y lambda_z reaches {worst:.4g} for 1; it is not "
                'used. If the tissue changes its volume, give loading.plane = "stress" and kappa_kPa.'
            )
    elif thickness == "incompressible" and abs(_uniaxial(columns) - 1.0) > CONTRADICTION:
        yield (
            f"Column lambda_z contradicts incompressibility with equal stretches across: lambda_x lambda_z^2 reaches "
            f"{_uniaxial(columns):.4g} for 1; it is not used."
        )
    elif thickness == "stress":
        yield 'Column lambda_z is not used: with loading.plane = "stress" the law decides it.'
    elif thickness == "strain" and np.nanmax(np.abs(z - 1.0)) > CONTRADICTION:
        yield "Column lambda_z is not used: plane strain assumes that it is 1."


def _uniaxial(columns: Mapping[str, np.ndarray]) -> float:
    volume = columns["lambda_x"] * columns["lambda_z"] ** 2
    return float(volume[np.nanargmax(np.abs(volume - 1.0))])
