"""``cicatrix fit CASE.toml DATA.csv --free KEY=LOW..HIGH``: fit parameters of a law to measured stretches and stresses."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

from ..core.errors import CicatrixError, InputError
from ..files.measurements import read_measurements
from ..files.numerals import Numerals
from ..inference.fit import Fit, fit
from ..inference.fit_folder import claim_folder, write_fit
from ..kinds.material_point.case import PointCase
from ..kinds.material_point.measured import Experiment, experiment, loading_of
from ..kinds.registry import load_case
from .printing import printable

Made = TypeVar("Made")


def run(args: argparse.Namespace) -> int:
    """Fit, write the folder, print a line per parameter."""
    bounds = _all_bounds(args.free)
    case, measured = measured_for(args.case, args.set, args.data)
    folder = claim_folder(args.out or Path("fits") / args.data.stem)
    try:
        found = fit(case, measured, bounds)
    except CicatrixError:
        folder.rmdir()
        raise
    write_fit(
        folder,
        case,
        _fit_table(found, bounds),
        dict(zip(found.keys, found.estimates.tolist())),
        measured.columns,
        found.stresses,
    )
    _print(found, folder)
    return 0


def measured_for(case: Path, overrides: Sequence[str], data: Path) -> tuple[PointCase, Experiment]:
    """Read the case and the data that its law is fitted to; return the case, and what the data prescribe and measure.

    Raises
    ------
    InputError
        If the case is invalid or no material point, or the data cannot be read or are not its measurements.
    """
    table = read_measurements(data)
    found = load_case(case, overrides, {"loading": _about(data, loading_of, table)})
    if not isinstance(found, PointCase):
        raise InputError(f'{case}: kind must be "material-point" for a fit; got "{found.kind}"')
    return found, _about(data, experiment, found.loading, table)


def _about(path: Path, make: Callable[..., Made], *what: Any) -> Made:
    """Return what is made of a file's content; an error begins with the file's name."""
    try:
        return make(*what)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _all_bounds(texts: list[str]) -> dict[str, tuple[float, float]]:
    bounds = {}
    for key, ends in map(_bounds, texts):
        if key in bounds:
            raise InputError(f"--free {key} is given twice: give each key once")
        bounds[key] = ends
    return bounds


def _bounds(text: str) -> tuple[str, tuple[float, float]]:
    key, equals, span = text.partition("=")
    low, dots, high = span.partition("..")
    try:
        ends = Numerals().number(low.strip()), Numerals().number(high.strip())
    except ValueError:
        ends = None
    if not (key and equals and dots and ends):
        raise InputError(f"--free {text}: must read KEY=LOW..HIGH, such as law.0.mu_kPa=0.1..10")
    return key.strip().replace("[", ".").replace("]", ""), ends


def _fit_table(found: Fit, bounds: dict[str, tuple[float, float]]) -> dict[str, Any]:
    """Return the contents of ``fit.json``."""
    errors = zip(found.keys, found.estimates, found.standard_errors, strict=True)
    return {
        "parameters": {
            key: {"estimate": value, "standard_error": error, "bounds": bounds[key]} for key, value, error in errors
        },
        "covariance": found.covariance,
        "correlation": found.correlation,
        "residual_rms_kPa": found.rms_kPa,
        "r_squared": found.r_squared,
        "n_data": sum(map(len, found.stresses.values())),
        "condition": found.condition,
        "evaluations": found.evaluations,
        "notes": found.notes,
    }


def _print(found: Fit, folder: Path) -> None:
    for key, value, error in zip(found.keys, found.estimates, found.standard_errors, strict=True):
        print(f"{key:<32} {value:12.6g}" + (f" +- {error:.2g}" if isfinite(error) else "  (no standard error)"))
    for name, rms in found.rms_kPa.items():
        print(f"{name:<32} residual {rms:.3g} kPa (rms){_explained(found.r_squared[name])}")
    for note in found.notes:
        print(printable(note))
    print(printable(f"written to {folder}: fit.json, fitted.toml, residuals.csv, figures/fit.png"))


def _explained(r_squared: float) -> str:
    return f", R^2 {r_squared:.5f}" if isfinite(r_squared) else ""
