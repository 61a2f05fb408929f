"""Stiffness of one woman's tissue and fascia, from where her nipple lies in a second position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .case import LumpectomyCase
from .priors import PRIORS

NIPPLE_SD_MM = (
    5.0  # standard deviation of a nipple's place in a second image whose ribs are aligned with the first: chosen
)
NAMES = ("tissue.fat.E_kPa", "fascia.stiffness_kPa_per_mm")  # the two factors multiply all tissues, and the fascia
PRIOR_SD = np.array([PRIORS[name].second for name in NAMES])  # of the logarithms of the factors
STEP = 0.15  # of the logarithms, for differences
CONVERGED = 0.03  # change of the logarithms, as a share of their prior standard deviation, below which iterations end
MAX_ITERATIONS = 6
LARGEST_STEP = 1.0  # of the logarithms in one iteration


@dataclass(frozen=True, eq=False)
class Conditioned:
    """The most probable factors of stiffness, and how well they are known.

    Parameters
    ----------
    logs : (2,) array
        Natural logarithms of the factors of tissue and of fascia.
    covariance : (2, 2) array
        Covariance of the logarithms, linearised about them.
    misfit_mm : float
        Distance of the nipple from where it was seen [mm].
    n_solves : int
        Number of bodies that were computed.
    """

    logs: np.ndarray
    covariance: np.ndarray
    misfit_mm: float
    n_solves: int

    def factors(self) -> np.ndarray:
        """Return the factors of tissue and of fascia (2,) [1]."""
        return np.exp(self.logs)

    def interval(self, which: int) -> tuple[float, float]:
        """Return the 5 and 95 % quantiles of a factor [1]; ``which`` is 0 for tissue, 1 for fascia."""
        half = 1.645 * np.sqrt(self.covariance[which, which])
        return float(np.exp(self.logs[which] - half)), float(np.exp(self.logs[which] + half))


def scaled(case: LumpectomyCase, factors: np.ndarray) -> LumpectomyCase:
    """Return the case with all tissues but skin stiffer by one factor, and the springs of the fascia by another."""
    tissue, fascia = case.tissue, case.fascia
    parts = {
        name: getattr(tissue, name).model_copy(update={"E_kPa": float(factors[0]) * getattr(tissue, name).E_kPa})
        for name in ("fat", "gland", "tumour", "scar")
    }
    springs = fascia.model_copy(update={"stiffness_kPa_per_mm": float(factors[1]) * fascia.stiffness_kPa_per_mm})
    return case.model_copy(update={"tissue": tissue.model_copy(update=parts), "fascia": springs})


def condition(
    nipple_at: Callable[[np.ndarray], np.ndarray], seen_mm: np.ndarray, report: Callable[[str], None] | None = None
) -> Conditioned:
    """Find the most probable factors of stiffness, by Gauss-Newton iterations on the logarithms.

    The logarithms have the normal priors of the stiffness of fat and of fascia; the nipple's place is measured with a standard
    deviation of 5 mm in each direction.

    Parameters
    ----------
    nipple_at : callable
        Computes the nipple's place (n,) [mm] for factors (2,).
    seen_mm : (n,) array [mm]
        Where it was seen.
    report : callable, optional
        Called with a progress message.

    Raises
    ------
    ConvergenceError
        If a body has no equilibrium.
    """
    logs, n_solves = np.zeros(2), 0
    prior = np.diag(1.0 / PRIOR_SD)

    def place(logs: np.ndarray) -> np.ndarray:
        nonlocal n_solves
        n_solves += 1
        if report is not None:
            report(f"stiffness of tissue x {np.exp(logs[0]):.2f}, of fascia x {np.exp(logs[1]):.2f}")
        return nipple_at(np.exp(logs))

    here = place(logs)
    while True:
        slopes = np.stack([(place(logs + STEP * axis) - here) / STEP for axis in np.eye(2)], axis=1)
        rows = np.concatenate([slopes / NIPPLE_SD_MM, prior])
        left = np.concatenate([(seen_mm - here) / NIPPLE_SD_MM, -logs / PRIOR_SD])
        step = np.clip(np.linalg.lstsq(rows, left)[0], -LARGEST_STEP, LARGEST_STEP)
        logs = logs + step
        here = place(logs)
        if np.abs(step / PRIOR_SD).max() < CONVERGED or n_solves >= 3 * MAX_ITERATIONS:
            covariance = np.linalg.inv(rows.T @ rows)
            return Conditioned(logs, covariance, float(np.linalg.norm(here - seen_mm)), n_solves)
