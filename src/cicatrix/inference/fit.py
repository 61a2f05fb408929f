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

TOLERANCE = 1e-13  # tolerance of the sum of squares, the parameters and the gradient at which the search ends
MAX_EVALUATIONS = 200  # maximum number of evaluations
BOUND_TOLERANCE = 1e-6  # a parameter closer than this to a bound, relative to the span of its bounds, is at the bound
RANK_TOLERANCE = 1e-7  # relative singular value of J (columns of length 1) below which a combination has no effect
HIGH_CORRELATION = 0.99  # correlation above which two parameters are reported as hard to tell apart

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
        If a key is unknown, bounds do not ascend or exceed the range of the law, or there are fewer data than parameters.
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
    return _result(tuple(bounds), measured, found, model, low, high)


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


def _result(keys, measured: Experiment, found, model: Callable, low: np.ndarray, high: np.ndarray) -> Fit:
    """Return the estimates with their standard errors, correlations, residuals and notes, from the search's result ``found``."""
    n, p = found.jac.shape
    data = np.column_stack(list(measured.stresses.values()))
    fitted = data + found.fun.reshape(data.shape)
    at_bound = np.minimum(found.x - low, high - found.x) < BOUND_TOLERANCE * (high - low)
    inner = np.flatnonzero(~at_bound)
    variance = float(found.fun @ found.fun) / max(n - p, 1)
    covariance = np.full((p, p), np.nan)
    part, condition, lost = _inverse(found.jac[:, inner])
    covariance[np.ix_(inner, inner)] = variance * part if n > p else np.nan
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(errors, errors)
    notes = [
        *_at_bounds(keys, found.x, at_bound, low),
        *_not_identifiable([keys[i] for i in inner], lost),
        *_correlated(keys, correlation),
    ]
    if n == p:
        notes.append("There are as many data as free parameters: errors cannot be estimated.")
    residual = found.fun.reshape(data.shape)
    names = list(measured.stresses)
    return Fit(
        keys,
        found.x,
        errors,
        covariance,
        correlation,
        dict(zip(names, fitted.T)),
        {name: float(np.sqrt(np.mean(r * r))) for name, r in zip(names, residual.T)},
        {name: _r_squared(r, d) for name, r, d in zip(names, residual.T, data.T)},
        condition,
        int(found.nfev),
        tuple(notes),
    )


def _inverse(J: np.ndarray) -> tuple[np.ndarray, float, np.ndarray | None]:
    """Return (J^T J)^-1, the condition number of J with columns scaled to length 1, and a null vector of J (p,) or None."""
    if J.shape[1] == 0:
        return np.zeros((0, 0)), 1.0, None
    length = np.linalg.norm(J, axis=0)
    scale = np.where(length > 0.0, length, 1.0)
    _, s, V = np.linalg.svd(J / scale, full_matrices=False)
    if s[-1] <= RANK_TOLERANCE * s[0]:
        return np.full((J.shape[1],) * 2, np.nan), np.inf, V[-1]
    half = V / s[:, None] / scale
    return half.T @ half, float(s[0] / s[-1]), None


def _r_squared(residual: np.ndarray, data: np.ndarray) -> float:
    """Return the fraction of the variance of the data that the fit explains; NaN for data of zero variance."""
    spread = float(np.sum((data - data.mean()) ** 2))
    return 1.0 - float(residual @ residual) / spread if spread > 0.0 else float("nan")


def _at_bounds(keys, x: np.ndarray, at_bound: np.ndarray, low: np.ndarray) -> list[str]:
    out = []
    for i in np.flatnonzero(at_bound):
        end = "lower" if abs(x[i] - low[i]) <= abs(x[i]) * 1e-3 + BOUND_TOLERANCE else "upper"
        out.append(
            f"{keys[i]} is at its {end} bound, {x[i]:.6g}: it has no standard error, and those of others assume that it is fixed."
        )
    return out


def _not_identifiable(keys: list[str], lost: np.ndarray | None) -> list[str]:
    if lost is None:
        return []
    names = [key for key, share in zip(keys, lost) if abs(share) > 0.1]
    what = (
        f"{names[0]} has no effect on" if len(names) == 1 else f"only a combination of {', '.join(names)} is fixed by"
    )
    return [f"Not identifiable: {what} these data; fix a parameter, or measure under another loading."]


def _correlated(keys, correlation: np.ndarray) -> list[str]:
    pairs = [(i, j) for i in range(len(keys)) for j in range(i) if abs(correlation[i, j]) > HIGH_CORRELATION]
    return [
        f"{keys[j]} and {keys[i]} are hard to tell apart by these data: their correlation is {correlation[i, j]:.4f}."
        for i, j in pairs
    ]
