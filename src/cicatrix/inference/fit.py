r"""Least-squares estimation of the parameters of a law from measured stretches and stresses of one specimen.

.. math:: \min_p \sum (\sigma(p) - \sigma_{measured})^2, \qquad \mathrm{cov}\, p \approx s^2 (J^T J)^{-1}, \qquad
          s^2 = \frac{\sum r^2}{n - n_p}

J is exact, by automatic differentiation through the loading history (:func:`..mechanics.point.history`). The search is SciPy's
trust region method with bounds (Branch, Coleman & Li 1999). The covariance is the Gauss-Newton estimate, which assumes
independent errors of equal variance that are small relative to the curvature of the law.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.optimize import least_squares

from ..cases.laws import law_of
from ..cases.parameters import known, replaced
from ..core.errors import ConvergenceError, InputError
from ..kinds.material_point.case import PointCase
from ..kinds.material_point.measured import STRESSES, Experiment
from ..mechanics.point import Instant, history
from ..mechanics.point_integration import integrate_all
from ..numerics.compiler import COMPILER
from .identifiability import at_bounds, correlated, covariance_of, undetermined
from .residuals import notes_on_residuals, r_squared, refuse_nothing_fitted

TOLERANCE = 1e-13  # tolerance of the sum of squares, the parameters and the gradient at which the search ends
MAX_EVALUATIONS = 200  # maximum number of evaluations

Bounds = Mapping[str, tuple[float, float]]


class Fit(NamedTuple):
    """Result of a fit of p parameters, each in the unit of its case-file key."""

    keys: tuple[str, ...]
    estimates: np.ndarray
    """Fitted parameters (p,)."""
    standard_errors: np.ndarray
    """Standard errors of the parameters (p,); NaN where the data do not determine them."""
    covariance: np.ndarray
    """Covariance of the parameters (p, p); NaN where the data do not determine it."""
    correlation: np.ndarray
    """Correlation of the parameters (p, p)."""
    stresses: dict[str, np.ndarray]
    """Stresses of the fitted law: column -> (n,) [kPa]."""
    rms_kPa: dict[str, float]
    """Root mean square of the residuals of each column [kPa]."""
    r_squared: dict[str, float]
    condition: float
    """Condition number of J with columns of length 1: near 1 for well separated parameters, infinite if not identifiable."""
    evaluations: int
    notes: tuple[str, ...]
    """Warnings to read before the numbers are used, one sentence each."""


def fit(case: PointCase, measured: Experiment, bounds: Bounds) -> Fit:
    """Fit parameters of a case's laws to the measured stresses.

    Parameters
    ----------
    case : PointCase
        Case with the laws. The search starts at its values of the free keys where they lie within the bounds, otherwise at the
        middle of the bounds.
    measured : Experiment
        Measured data, from :func:`..study.measured.experiment`.
    bounds : mapping of str to (float, float)
        Key of each free parameter -> lower and upper bound, in the unit of the key.

    Raises
    ------
    InputError
        If a key is unknown, bounds do not ascend or exceed the range of the law, there are fewer data than parameters, or nothing
        is fitted: no parameter has an effect on the data, or the law explains none of them.
    ConvergenceError
        If the law has no solution along the loading at the start of the search, or the search does not converge.

    Notes
    -----
    For a law with history, the time steps are chosen with the parameters at the start; after a first search they are chosen
    again with the parameters found, and the search is repeated.
    """
    start = _start(case, bounds)
    n = sum(map(len, measured.stresses.values()))
    if n < len(bounds):
        raise InputError(f"there are {n} measured stresses for {len(bounds)} free parameters: add data or free fewer")
    low, high = np.array(list(bounds.values()), float).T
    found, model = None, None
    for _ in range(2 if _has_history(case) else 1):
        model = stresses_of(case, measured, tuple(bounds), start)
        found = _search(model, measured, start, low, high)
        start = found.x
    return _result(tuple(bounds), measured, found, low, high)


def stresses_of(
    case: PointCase, measured: Experiment, keys: tuple[str, ...], values: np.ndarray
) -> Callable[[Array], Array]:
    """Return a function that computes the law's stresses at the measurements from the parameters: (p,) -> (n, n_stresses) [kPa].

    A stress is NaN where the law has no solution. Columns are in the order of the measured stresses, parameters in the order
    of ``keys``. The time steps are chosen once, with the parameters ``values`` (p,), and do not depend on the argument.
    """
    path, rows = _path(case, measured, dict(zip(keys, values, strict=True)))
    places = [STRESSES[name] for name in measured.stresses]

    def stresses(p: Array) -> Array:
        law = law_of(replaced(case, dict(zip(keys, p, strict=True))))
        points = history(law, measured.by, path)
        found = jnp.stack([points.stress[rows, i, j] for i, j in places], axis=-1)
        return jnp.where(points.converged[rows, None], found, jnp.nan)

    return stresses


def _has_history(case: PointCase) -> bool:
    return bool(jax.tree.leaves(law_of(case).initial_state(())))


def _path(case: PointCase, measured: Experiment, values: dict[str, float]) -> tuple[Instant, np.ndarray]:
    """Return the instants of the loading path at which the law is evaluated, and the indices of the measured ones among them."""
    if not _has_history(case):
        return measured.asked, np.arange(len(measured.asked.time))
    law = law_of(replaced(case, {key: float(value) for key, value in values.items()}))
    integrated = integrate_all(law, measured.by, measured.asked, case.solver.relative_tolerance)
    return integrated.path, integrated.rows


def _start(case: PointCase, bounds: Bounds) -> np.ndarray:
    """Return the parameters at which the search starts (p,), after checking the bounds."""
    start = {}
    for key, (low, high) in bounds.items():
        value = known(case, key)
        if not low < high:
            raise InputError(f"{key}: the bounds must ascend; got {low:g}..{high:g}")
        start[key] = value if value is not None and low < value < high else 0.5 * (low + high)
    for key, ends in bounds.items():
        for end in ends:
            try:
                law_of(replaced(case, start | {key: float(end)}))
            except InputError as error:
                raise InputError(f"{key} = {end:g}: {error}") from None
    return np.array(list(start.values()))


def _search(model: Callable, measured: Experiment, start: np.ndarray, low: np.ndarray, high: np.ndarray):
    data = np.column_stack(list(measured.stresses.values()))
    span = high - low  # the search uses parameters divided by it

    def whole(t: Array) -> tuple[Array, Array]:
        residual = (model(low + span * t) - data).ravel()
        return residual, residual

    both = jax.jit(jax.jacfwd(whole, has_aux=True), compiler_options=COMPILER)  # compiled once, as this costs most
    slopes: dict[bytes, np.ndarray] = {}

    def residual(t: np.ndarray) -> np.ndarray:
        slope, value = both(t)
        slopes.clear()
        slopes[t.tobytes()] = np.asarray(slope)
        return np.asarray(value)

    def slope(t: np.ndarray) -> np.ndarray:
        return slopes[t.tobytes()] if t.tobytes() in slopes else np.asarray(both(t)[0])

    t = np.clip((start - low) / span, 1e-9, 1.0 - 1e-9)
    if not np.isfinite(residual(t)).all():
        raise ConvergenceError(
            "the law has no solution at the measured stretches where the search starts: start elsewhere"
        )
    ends = {
        "bounds": (0.0, 1.0),
        "ftol": TOLERANCE,
        "xtol": TOLERANCE,
        "gtol": TOLERANCE,
        "max_nfev": MAX_EVALUATIONS,
        "x_scale": "jac",
    }
    found = least_squares(residual, t, slope, **ends)
    if found.status <= 0:
        raise ConvergenceError(
            f"the search did not converge within {MAX_EVALUATIONS} evaluations: narrow the bounds or free fewer parameters"
        )
    found.x, found.jac = low + span * found.x, found.jac / span
    return found


def _result(keys, measured: Experiment, found, low: np.ndarray, high: np.ndarray) -> Fit:
    """Return the estimates with their standard errors, correlations, residuals and notes, from the search's result ``found``."""
    data = np.column_stack(list(measured.stresses.values()))
    residual = found.fun.reshape(data.shape)
    ends = at_bounds(keys, found.x, low, high)
    covariance, condition, doubts = covariance_of(
        keys, found.jac, found.fun, np.flatnonzero([key not in ends for key in keys])
    )
    refuse_nothing_fitted(residual, data, [f"{key} is at {end}" for key, end in ends.items()])
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(errors, errors)
    fitted = dict(zip(measured.stresses, (data + residual).T))
    residuals = dict(zip(measured.stresses, residual.T))
    notes = [
        *measured.notes,
        *(
            f"{key} is at {end}: it has no standard error, and those of others assume that it is fixed."
            for key, end in ends.items()
        ),
        *doubts,
        *undetermined(keys, found.x, errors, high - low),
        *correlated(keys, correlation),
        *notes_on_residuals(measured.columns, residuals, fitted),
    ]
    return Fit(
        keys,
        found.x,
        errors,
        covariance,
        correlation,
        fitted,
        {name: float(np.sqrt(np.mean(r * r))) for name, r in residuals.items()},
        {name: r_squared(r, measured.stresses[name]) for name, r in residuals.items()},
        condition,
        int(found.nfev),
        tuple(notes),
    )
