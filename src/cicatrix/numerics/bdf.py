"""Implicit steps of second order with error control: backward differences over steps of any length.

A step of second order is an implicit Euler step that starts from a mixture of the states before, so whoever can take an
implicit Euler step can take this one, and whatever it conserves is conserved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

LONGEST_RISE = 2.0  # of a step over the one before; beyond 2.41 the method is unstable
DEEPEST_CUT, SAFETY = 0.2, 0.85


class Formula(NamedTuple):
    """One step; weights are those of the states before, the latest first."""

    start: tuple[float, ...]
    """Weights of the state that the implicit Euler step starts from."""
    share: float
    """Of the step that the implicit Euler step takes."""
    guess: tuple[float, ...]
    """Weights of the extrapolation to the end of the step."""
    error: float
    """Local error over the distance of the solution from the guess; 0 where nothing is known."""
    order: int


def formula(step: float, ages: Sequence[float], *, damped: bool = False) -> Formula:
    r"""Return the best formula for a step.

    With :math:`\omega = h / h_{-1}`, h the step and :math:`h_{-1}` the one before,

    .. math:: y - \tfrac{(1+\omega)^2}{1 + 2\omega} y_0 + \tfrac{\omega^2}{1 + 2\omega} y_{-1}
        = h \, \tfrac{1 + \omega}{1 + 2 \omega} \, \dot y

    Source: Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, III.5. The local error is that of its leading
    term, told from the distance to the extrapolated polynomial (Milne's device).

    Parameters
    ----------
    step : float
        h.
    ages : sequence of float
        Time that has passed since each known state, the latest first and so 0 first; three at most are used.
    damped : bool
        Whether to take a plain implicit Euler step all the same, which keeps positive what is positive.
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
    """Weights of the polynomial through known states, at the end of the step."""
    others = [[b for j, b in enumerate(ages) if j != i] for i in range(len(ages))]
    return tuple(float(np.prod([(step + b) / (b - a) for b in rest])) for a, rest in zip(ages, others))


def next_step(step: float, error: float, order: int) -> float:
    """The step that meets an error of 1, from one of which the error is known."""
    best = SAFETY * error ** (-1.0 / (order + 1)) if error > 0.0 else LONGEST_RISE
    return step * float(np.clip(best, DEEPEST_CUT, LONGEST_RISE))
