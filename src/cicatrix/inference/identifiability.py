"""What data determine of the parameters of a law, and what they leave open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.errors import InputError

BOUND_TOLERANCE = 1e-6  # a parameter closer than this to a bound, relative to the span of its bounds, is at the bound
RANK_TOLERANCE = 1e-7  # relative singular value of J (columns of length 1) below which a combination has no effect
HIGH_CORRELATION = 0.99  # correlation above which two parameters are reported as hard to tell apart
NO_EFFECT = 1e-12  # derivative of a stress by a parameter, in the units of both, below which there is none
PRECISE = 1e-3  # standard error over the width of the bounds below which a parameter is determined, be it near 0


def covariance_of(
    keys: Sequence[str], J: np.ndarray, residual: np.ndarray, inner: np.ndarray
) -> tuple[np.ndarray, float, list[str]]:
    """Return the covariance (p, p) of the parameters, its condition number and sentences of doubt.

    Parameters
    ----------
    keys : sequence of str
        The p parameters.
    J, residual : (n, p) and (n,) array
        Derivatives of the stresses by the parameters, and fitted minus measured stress [kPa].
    inner : array of int
        Parameters that are not at a bound; the covariance of the others is NaN.

    Raises
    ------
    InputError
        If none of the parameters has an effect on the data.
    """
    n, p = J.shape
    covariance = np.full((p, p), np.nan)
    if np.abs(J).max() < NO_EFFECT:
        verb = "has" if p == 1 else "have"
        raise InputError(
            f"nothing was fitted: {', '.join(keys)} {verb} no effect on these data: measure under another loading"
        )
    part, condition, lost = _inverse(J[:, inner])
    doubts = _not_identifiable([keys[i] for i in inner], lost)
    n_telling = _telling(J[:, inner])
    if n_telling > len(inner) and n > p:
        covariance[np.ix_(inner, inner)] = part * float(residual @ residual) / (n - p)
    elif len(inner):
        doubts.append(
            f"Errors cannot be estimated: {n_telling} of {n} measured stresses depend on the free parameters, which are {p}."
        )
    return covariance, condition, doubts


def _telling(J: np.ndarray) -> int:
    """Return how many data depend on the parameters: rows of J (n, p) that are not zero beside the others."""
    length = np.linalg.norm(J, axis=0)
    rows = np.linalg.norm(J / np.where(length > 0.0, length, 1.0), axis=1)
    return int(np.count_nonzero(rows > RANK_TOLERANCE * rows.max(initial=0.0)))


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


def at_bounds(keys: Sequence[str], x: np.ndarray, low: np.ndarray, high: np.ndarray) -> dict[str, str]:
    """Return the parameters at a bound: key -> which bound, in words."""
    at_bound = np.minimum(x - low, high - x) < BOUND_TOLERANCE * (high - low)
    out = {}
    for i in np.flatnonzero(at_bound).tolist():
        end = "lower" if abs(x[i] - low[i]) <= abs(x[i]) * 1e-3 + BOUND_TOLERANCE else "upper"
        out[keys[i]] = f"its {end} bound, {x[i]:.6g}"
    return out


def undetermined(keys: Sequence[str], x: np.ndarray, errors: np.ndarray, span: np.ndarray) -> list[str]:
    """Say which parameters the data hardly determine: a standard error as large as the value, or as half of the bounds' width."""
    return [
        f"{key} is hardly determined by these data: {value:.3g} has the standard error {error:.2g}."
        for key, value, error, width in zip(keys, x, errors, span)
        if error >= 0.5 * width or error >= max(abs(value), PRECISE * width)
    ]


def _not_identifiable(keys: list[str], lost: np.ndarray | None) -> list[str]:
    if lost is None:
        return []
    names = [key for key, share in zip(keys, lost) if abs(share) > 0.1]
    what = (
        f"{names[0]} has no effect on" if len(names) == 1 else f"only a combination of {', '.join(names)} is fixed by"
    )
    return [f"Not identifiable: {what} these data; fix a parameter, or measure under another loading."]


def correlated(keys: Sequence[str], correlation: np.ndarray) -> list[str]:
    """Say which pairs of parameters are hard to tell apart, by their correlation (p, p)."""
    pairs = [(i, j) for i in range(len(keys)) for j in range(i) if abs(correlation[i, j]) > HIGH_CORRELATION]
    return [
        f"{keys[j]} and {keys[i]} are hard to tell apart by these data: their correlation is {correlation[i, j]:.4f}."
        for i, j in pairs
    ]
