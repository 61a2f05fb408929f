r"""Parameters of a law from stretches and stresses of one specimen, by least squares with derivatives through the history.

.. math:: \min_p \sum (\sigma(p) - \sigma_{measured})^2, \qquad \mathrm{cov}\, p \approx s^2 (J^T J)^{-1}, \qquad
          s^2 = \frac{\sum r^2}{n - n_p}

J is exact (:func:`..mechanics.point.history`), the search SciPy's trust region with bounds (Branch, Coleman & Li 1999), the
covariance that of Gauss and Newton: errors of the same size, independent of each other, small against the law's curvature.
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
from ..mechanics.point_walk import lead
from ..numerics.compiler import COMPILER

EXACT = 1e-13  # of the sum of squares, of the parameters, of the gradient: where the search ends
MOST = 200  # evaluations
SAME = 1e-6  # of the span between its bounds: a parameter so near to one is at it
LEAST_RANK = 1e-7  # singular value of J with columns of length 1 below which a combination leaves no trace
TWINS = 0.99  # correlation above which two parameters are called hard to tell apart

Bounds = Mapping[str, tuple[float, float]]


class Fit(NamedTuple):
    """What the data say of a law's parameters, these in the units of their keys."""

    keys: tuple[str, ...]
    estimates: np.ndarray
    """(p,)."""
    standard_errors: np.ndarray
    """(p,); NaN where the data do not say."""
    covariance: np.ndarray
    """(p, p); NaN where the data do not say."""
    correlation: np.ndarray
    """(p, p)."""
    stresses: dict[str, np.ndarray]
    """Of the fitted law: column -> (n,) [kPa]."""
    rms_kPa: dict[str, float]
    """Of the residuals, for each column."""
    r_squared: dict[str, float]
    condition: float
    """Of J with columns of length 1: near 1 the parameters are told apart, infinite they are not."""
    evaluations: int
    notes: tuple[str, ...]
    """Sentences on what is to be known before the numbers are used."""


def fit(case: PointCase, measured: Experiment, bounds: Bounds) -> Fit:
    """Find the numbers of a case's laws that meet the measured stresses best.

    Parameters
    ----------
    case : PointCase
        The laws; its numbers under the free keys are where the search starts, if they are within the bounds, else the middle is.
    measured : Experiment
        Of :func:`..study.measured.experiment`.
    bounds : mapping of str to (float, float)
        Key of each free number -> least and largest value, in the key's unit.

    Raises
    ------
    InputError
        If a key is not known, bounds are not in order or leave the law's range, or there are fewer data than parameters.
    ConvergenceError
        If the law does not go through the loading where the search starts, or the search does not end.

    Notes
    -----
    A law with history is followed in steps that are as small as it takes at the start of the search, and once more at its end.
    """
    start = _start(case, bounds)
    n = sum(map(len, measured.stresses.values()))
    if n < len(bounds):
        raise InputError(f"there are {n} measured stresses for {len(bounds)} free parameters: give more, or free fewer")
    low, high = np.array(list(bounds.values()), float).T
    found, model = None, None
    for _ in range(2 if _has_history(case) else 1):
        model = stresses_of(case, measured, tuple(bounds), start)
        found = _search(model, measured, start, low, high)
        start = found.x
    return _told(tuple(bounds), measured, found, model, low, high)


def stresses_of(
    case: PointCase, measured: Experiment, keys: tuple[str, ...], values: np.ndarray
) -> Callable[[Array], Array]:
    """Measured columns as a function of the parameters: (p,) -> (n, columns) [kPa]; NaN where the law finds no state.

    The steps in time are those that the law with ``values`` (p,) needs.
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
    """Instants to go through, and where the measured ones are among them."""
    if not _has_history(case):
        return measured.asked, np.arange(len(measured.asked.time))
    law = law_of(replaced(case, {key: float(value) for key, value in values.items()}))
    walked = lead(law, measured.by, measured.asked, case.solver.relative_tolerance)
    return walked.path, walked.rows


def _start(case: PointCase, bounds: Bounds) -> np.ndarray:
    """Where the search starts (p,)."""
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
    span = high - low  # the search is in shares of it

    def whole(t: Array) -> tuple[Array, Array]:
        residual = (model(low + span * t) - data).ravel()
        return residual, residual

    both = jax.jit(jax.jacfwd(whole, has_aux=True), compiler_options=COMPILER)  # one compilation, which costs the most
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
            "the law does not go through the measured stretches where the search starts: start elsewhere"
        )
    ends = {"bounds": (0.0, 1.0), "ftol": EXACT, "xtol": EXACT, "gtol": EXACT, "max_nfev": MOST, "x_scale": "jac"}
    found = least_squares(residual, t, slope, **ends)
    if found.status <= 0:
        raise ConvergenceError(
            f"the search did not end within {MOST} evaluations: narrow the bounds or free fewer parameters"
        )
    found.x, found.jac = low + span * found.x, found.jac / span
    return found


def _told(keys, measured: Experiment, found, model: Callable, low: np.ndarray, high: np.ndarray) -> Fit:
    """Estimates, their errors, and what is to be said of them."""
    n, p = found.jac.shape
    data = np.column_stack(list(measured.stresses.values()))
    fitted = data + found.fun.reshape(data.shape)
    at_bound = np.minimum(found.x - low, high - found.x) < SAME * (high - low)
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
        *_unclear([keys[i] for i in inner], lost),
        *_twins(keys, correlation),
    ]
    if n == p:
        notes.append("There are as many data as free parameters: nothing is left to tell errors from.")
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
    """Inverse of J^T J, condition of J with columns of length 1, and a combination (p,) that leaves no trace if there is one."""
    if J.shape[1] == 0:
        return np.zeros((0, 0)), 1.0, None
    length = np.linalg.norm(J, axis=0)
    scale = np.where(length > 0.0, length, 1.0)
    _, s, V = np.linalg.svd(J / scale, full_matrices=False)
    if s[-1] <= LEAST_RANK * s[0]:
        return np.full((J.shape[1],) * 2, np.nan), np.inf, V[-1]
    half = V / s[:, None] / scale
    return half.T @ half, float(s[0] / s[-1]), None


def _r_squared(residual: np.ndarray, data: np.ndarray) -> float:
    """Share of the data's variance that is explained; NaN where they do not vary."""
    spread = float(np.sum((data - data.mean()) ** 2))
    return 1.0 - float(residual @ residual) / spread if spread > 0.0 else float("nan")


def _at_bounds(keys, x: np.ndarray, at_bound: np.ndarray, low: np.ndarray) -> list[str]:
    out = []
    for i in np.flatnonzero(at_bound):
        end = "lower" if abs(x[i] - low[i]) <= abs(x[i]) * 1e-3 + SAME else "upper"
        out.append(
            f"{keys[i]} is at its {end} bound, {x[i]:.6g}: it has no standard error, and those of others hold it there."
        )
    return out


def _unclear(keys: list[str], lost: np.ndarray | None) -> list[str]:
    if lost is None:
        return []
    names = [key for key, share in zip(keys, lost) if abs(share) > 0.1]
    what = (
        f"{names[0]} leaves no trace in" if len(names) == 1 else f"only a combination of {', '.join(names)} is fixed by"
    )
    return [f"Not identifiable: {what} these data; hold a parameter, or measure under another loading."]


def _twins(keys, correlation: np.ndarray) -> list[str]:
    pairs = [(i, j) for i in range(len(keys)) for j in range(i) if abs(correlation[i, j]) > TWINS]
    return [
        f"{keys[j]} and {keys[i]} are hard to tell apart by these data: their correlation is {correlation[i, j]:.4f}."
        for i, j in pairs
    ]
