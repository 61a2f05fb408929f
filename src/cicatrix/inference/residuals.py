"""What the residuals of a fit tell: how much of the data is explained, and whether the rest is scatter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import comb

import numpy as np

from ..core.errors import InputError

SIGNIFICANT = 0.01  # probability of so few runs by chance below which the residuals are called systematic
NEGLIGIBLE = 1e-3  # rms of residuals over the spread of the data below which their signs do not matter
HALF = 0.5  # squared residuals over squared data below which something was fitted
AT_REST = 1e-6  # deviation from stretch 1 and shear 0 that counts as rest
PRELOAD = 0.05  # stress at rest over the largest stress that is said


def r_squared(residual: np.ndarray, data: np.ndarray) -> float:
    """Return the fraction of the variance of the data (n, ...) about their columns' means that a fit explains, or NaN."""
    spread = float(np.sum((data - data.mean(axis=0)) ** 2))
    rounding = data.size * float(1e-14 * np.abs(data).max()) ** 2
    return 1.0 - float(np.sum(residual**2)) / spread if spread > rounding else float("nan")


def refuse_nothing_fitted(residual: np.ndarray, data: np.ndarray, at_bounds: Sequence[str]) -> None:
    """Check that a fit explains something: residuals and data (n, n_stresses) [kPa].

    Raises
    ------
    InputError
        If the mean of the data is closer to them than the fitted law, which misses half of the data too, squared; the sentence
        asks for the units. (Of a nearly constant stress a law may explain all but the variation.)
    """
    explained = r_squared(residual, data)
    if explained >= 0.0 or np.sum(residual**2) <= HALF * np.sum(data**2):
        return
    share = f" (R^2 = {explained:.3g})" if np.isfinite(explained) else ""
    measured, fitted = np.abs(data).max(), np.abs(data + residual).max()
    bounds = f", and the bounds: {', '.join(at_bounds)}" if at_bounds else ""
    raise InputError(
        f"nothing was fitted: the law explains none of the data{share}; measured stresses reach {measured:.3g} "
        f"kPa and the law's {fitted:.3g} kPa: check the units and signs (Cauchy stress in kPa, negative in compression; "
        f"stretches that are 1 at rest){bounds}"
    )


def notes_on_residuals(
    columns: Mapping[str, np.ndarray], residual: Mapping[str, np.ndarray], stresses: Mapping[str, np.ndarray]
) -> list[str]:
    """Return a sentence for each stress whose residuals are systematic, and for one that is measured at rest.

    ``columns``: measured columns (n,); ``residual``: fitted minus measured [kPa]; ``stresses``: of the fitted law [kPa].
    """
    notes = []
    for name, errors in residual.items():
        data = columns[name]
        if r_squared(errors, data) < 0.0:
            notes.append(f"The law explains none of the variation of {name}: its mean is closer to the data.")
        elif float(np.sqrt(np.mean(errors**2))) > max(NEGLIGIBLE * float(np.std(data)), 1e-12 * np.abs(data).max()):
            notes += _systematic(name, errors)
        notes += _at_rest(name, columns, stresses[name])
    return notes


def chance_of_runs(n_runs: int, n_plus: int, n_minus: int) -> float:
    r"""Return the probability of at most so many runs of equal signs, if their order is random.

    .. math:: P(2k) = \frac{2 \binom{n_+ - 1}{k - 1}\binom{n_- - 1}{k - 1}}{\binom{n_+ + n_-}{n_+}}, \qquad
              P(2k + 1) = \frac{\binom{n_+ - 1}{k}\binom{n_- - 1}{k - 1} + \binom{n_+ - 1}{k - 1}\binom{n_- - 1}{k}}
              {\binom{n_+ + n_-}{n_+}}

    Wald & Wolfowitz (1940), Ann. Math. Statist. 11:147. For signs that are all equal, the probability of that, 2^(1 - n).
    """
    if min(n_plus, n_minus) == 0:
        return 0.5 ** (n_plus + n_minus - 1)

    def ways(runs: int) -> int:
        half, odd = divmod(runs, 2)
        a, b = n_plus - 1, n_minus - 1
        if not odd:
            return 2 * comb(a, half - 1) * comb(b, half - 1)
        return comb(a, half) * comb(b, half - 1) + comb(a, half - 1) * comb(b, half)

    return sum(ways(runs) for runs in range(2, n_runs + 1)) / comb(n_plus + n_minus, n_plus)


def _systematic(name: str, errors: np.ndarray) -> list[str]:
    """Say that residuals in their order (n,) keep their sign more often than scatter would; zeros have no sign."""
    signs = np.sign(errors[errors != 0.0])
    n_runs = 1 + int(np.count_nonzero(np.diff(signs))) if len(signs) else 0
    n_plus, n_minus = int(np.sum(signs > 0.0)), int(np.sum(signs < 0.0))
    chance = chance_of_runs(n_runs, n_plus, n_minus) if len(signs) else 1.0
    if chance >= SIGNIFICANT:
        return []
    changes = "1 change of sign" if n_runs == 2 else f"{n_runs - 1} changes of sign"
    return [
        f"The residuals of {name} are systematic: among {len(signs)}, {changes}, which scatter has with "
        f"probability {chance:.1g} (runs test); the law, the length at rest or the zero of the force may be wrong, and the "
        "standard errors are too small."
    ]


def _at_rest(name: str, columns: Mapping[str, np.ndarray], fitted: np.ndarray) -> list[str]:
    """Say that a stress was measured where the specimen has its rest shape and the law has none."""
    shape = [columns[key] - (key != "shear") for key in ("lambda_x", "lambda_y", "lambda_z", "shear") if key in columns]
    rest = np.flatnonzero(np.abs(shape).max(axis=0) < AT_REST)
    largest = float(np.abs(columns[name]).max())
    off = [row for row in rest[:1] if abs(columns[name][row]) > PRELOAD * largest > 20.0 * abs(fitted[row])]
    return [
        f"{name} is {columns[name][row]:.3g} kPa at stretch 1, where the law has none: subtract it, or take the length at zero "
        "force as rest."
        for row in off
    ]
