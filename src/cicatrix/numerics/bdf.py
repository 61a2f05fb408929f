"""Second-order backward differentiation formula (BDF2) with variable step length and error control.

A BDF2 step is an implicit Euler step that starts from a linear combination of the previous states. Any implicit Euler
solver can therefore take it, and linear invariants of that solver are conserved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

LONGEST_RISE = 2.0  # largest ratio of a step to the previous one; BDF2 is unstable beyond 2.41
DEEPEST_CUT, SAFETY = 0.2, 0.85  # smallest ratio of a step to the previous one; safety factor on the predicted step


class Formula(NamedTuple):
    """Coefficients of one BDF2 or implicit Euler step; each tuple has one weight for each previous state, the latest first."""

    start: tuple[float, ...]
    """Weights of the linear combination of previous states from which the implicit Euler step starts."""
    share: float
    """Length of the implicit Euler step as a fraction of the time step."""
    guess: tuple[float, ...]
    """Weights that extrapolate the polynomial through the previous states to the end of the step, as an initial guess."""
    error: float
    """Ratio of the local error to the distance between solution and extrapolation; 0 if no estimate is available."""
    order: int
    """Order of accuracy of the step, 1 or 2."""


def formula(step: float, ages: Sequence[float], *, damped: bool = False) -> Formula:
    r"""Return the coefficients of a BDF2 step, or of implicit Euler with one known state or if ``damped``.

    With :math:`\omega = h / h_{-1}`, h the step and :math:`h_{-1}` the previous one,

    .. math:: y - \tfrac{(1+\omega)^2}{1 + 2\omega} y_0 + \tfrac{\omega^2}{1 + 2\omega} y_{-1}
        = h \, \tfrac{1 + \omega}{1 + 2 \omega} \, \dot y

    Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, III.5. The local error is estimated by its
    leading term, from the distance between the solution and the extrapolated polynomial (Milne's device).

    Parameters
    ----------
    step : float
        Step length h.
    ages : sequence of float
        Time since each known state, latest first, so the first is 0; at most three are used.
    damped : bool
        If True, use implicit Euler even when more states are known; it preserves positivity.
    """
    ages = tuple(ages[:3])
    if len(ages) == 1:
        return Formula((1.0,), 1.0, (1.0,), 0.0, 1)
    points = ages[:2] if damped else ages
    guess = _extrapolation(step, points)
    reach = float(np.prod([step + age for age in points])) / (2.0 if len(points) == 2 else 6.0)
    if damped:
        own = step**2 / 2.0
        return Formula((1.0,), 1.0, guess, own / (reach + own), 1)
    w = step / ages[1]
    start = (1.0 + w) ** 2 / (1.0 + 2.0 * w), -(w**2) / (1.0 + 2.0 * w)
    own = step ** len(points) * (1.0 + w) ** 2 / (6.0 * w * (1.0 + 2.0 * w))
    return Formula(start, (1.0 + w) / (1.0 + 2.0 * w), guess, own / (reach + own), 2)


def _extrapolation(step: float, ages: Sequence[float]) -> tuple[float, ...]:
    """Return the weights of the known states that extrapolate the polynomial through them to the end of the step."""
    others = [[b for j, b in enumerate(ages) if j != i] for i in range(len(ages))]
    return tuple(float(np.prod([(step + b) / (b - a) for b in rest])) for a, rest in zip(ages, others))


def next_step(step: float, error: float, order: int) -> float:
    """Return the step length with a predicted scaled error of 1 (less a safety margin), from the error of the last step."""
    best = SAFETY * error ** (-1.0 / (order + 1)) if error > 0.0 else LONGEST_RISE
    return step * float(np.clip(best, DEEPEST_CUT, LONGEST_RISE))
