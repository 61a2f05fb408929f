"""Build the loading of a case of kind "material-point", and integrate the work along its history."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...core.units import seconds_from_hours
from ...mechanics.point import Control, Instant, control
from ...mechanics.point_integration import instants
from .case import LoadingTable, PointCase

FREE = {"incompressible": 0.0, "stress": 0.0, "strain": 1.0}  # value along z: zero stress, or stretch 1 in plane strain


def control_of(loading: LoadingTable) -> Control:
    """Choose stretch or stress as the prescribed quantity along each axis, and whether the volume is constant."""
    words = {axis: quantity for axis, (quantity, _) in loading.axes().items()}
    words = {"y": "stress", "z": "stretch" if loading.thickness == "strain" else "stress"} | words
    return control(**words, incompressible=loading.thickness == "incompressible")


def instants_of(loading: LoadingTable) -> Instant:
    """Return time, prescribed values and shear at all steps of the loading (n, ...)."""
    n = len(loading.time_h)
    given = {axis: values for axis, (_, values) in loading.axes().items()}
    given = {"y": (0.0,) * n, "z": (FREE.get(loading.thickness, 0.0),) * n} | given
    return instants(
        seconds_from_hours(np.array(loading.time_h)),
        np.column_stack([given[axis] for axis in "xyz"]),
        loading.shear or (0.0,) * n,
        loading.steps_per_segment,
        loading.repeat,
    )


def first_of_last_cycle(case: PointCase) -> int:
    """Return the row at which the last repetition of the loading starts."""
    loading = case.loading
    return (loading.repeat - 1) * (len(loading.time_h) - 1) * loading.steps_per_segment


def work(history: Mapping[str, np.ndarray], first: int = 0) -> float:
    r"""Integrate the work done on the point per reference volume [kPa], starting at row ``first``.

    :math:`\int P : dF` by the trapezoidal rule over the rows, with :math:`P = J \sigma F^{-T}`.
    """
    rows = {name: values[first:] for name, values in history.items()}
    lx, ly, lz, shear = (rows[name] for name in ("lambda_x", "lambda_y", "lambda_z", "shear"))
    J = lx * ly * lz
    pairs = (
        (J * (rows["sigma_x_kPa"] - rows["sigma_xy_kPa"] * shear / ly) / lx, lx),
        (J * rows["sigma_y_kPa"] / ly, ly),
        (J * rows["sigma_z_kPa"] / lz, lz),
        (J * rows["sigma_xy_kPa"] / ly, shear),
    )
    return float(sum(np.sum(0.5 * (P[1:] + P[:-1]) * np.diff(along)) for P, along in pairs))
