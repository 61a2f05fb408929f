"""Why no equilibrium was found: the cause as a sentence, with what to change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from ..core.errors import ConvergenceError
from ..numerics.linear import LinearSolver
from .pullback import Pullback

if TYPE_CHECKING:
    from .body import Body
    from .problem import Problem

MAX_POISSON_RATIO = 0.499  # above it, round-off in the pressure exceeds the solver's tolerance
PROBE = 1e-4  # displacement with which the change of stiffness is measured, relative to body size
NEARLY_SOLVED = 1e-4  # share of the load below which a residual that stays above the tolerance is round-off
BELIEVED_TO = 1.5  # largest share of the load at which a linear prediction of buckling is reported
MAX_UNKNOWNS = (
    60_000  # of larger bodies, the search for the last stable shape would take longer than the solve that failed
)


class NoEquilibriumError(ConvergenceError):
    """No equilibrium was found under the whole load.

    Parameters
    ----------
    cause, remedy : str
        A sentence on why, and one on what to change.
    history : list of str
        One line for each attempt of the solver.
    positions : (n_nodes, 3) array [mm]
        Last stable shape on the way to the whole load.
    share : float
        Share of the load that this shape carries [1].
    load : str
        What the load is called in a sentence.
    """

    def __init__(
        self, cause: str, remedy: str, history: list[str], positions: np.ndarray, share: float, load: str = "load"
    ) -> None:
        super().__init__(f"{cause} {remedy}", history)
        self.cause, self.remedy, self.positions, self.share, self.load = cause, remedy, positions, share, load


def rounding(residual: float) -> tuple[str, str]:
    """Return that round-off keeps the residual at a share ``residual`` of the load [1], and which tolerance that allows."""
    larger = 10.0 ** np.ceil(np.log10(10.0 * residual))
    return (
        f"The body is so stiff for its load that rounding keeps the residual at {residual:.1g} of the load.",
        f"Give a solver.relative_tolerance of at least {larger:.0g}.",
    )


def explanation(
    problem: Problem, x: np.ndarray, share: float, critical: float | None, history: Sequence[str]
) -> tuple[str, str]:
    """Return why the body has no equilibrium under the whole load, as far as can be told, and what to change.

    Parameters
    ----------
    problem : Problem
        The problem under the whole load.
    x : (n_nodes, 3) array [mm]
        Last stable shape.
    share : float
        Share of the load that this shape carries [1].
    critical : float or None
        Share of the load at which the body buckles [1], if it is known.
    history : sequence of str
        Lines about the attempts, oldest first.
    """
    cause, remedy = _cause(problem, x, share, critical, history)
    if (nu := largest_poisson_ratio(problem.body)) <= MAX_POISSON_RATIO:
        return cause, remedy
    # round-off in the pressure spoils stability too: with such a ratio a load at which the body buckles is only likely
    also = f" {cause}" if problem.inverse else ""
    if critical is not None:
        also = f" The body may also buckle, under about {percent(critical)} of the {load_words(problem)}."
    return f"Poisson's ratio of {nu:.6g} is too close to 0.5.{also}", f"Give at most {MAX_POISSON_RATIO}."


def _cause(
    problem: Problem, x: np.ndarray, share: float, critical: float | None, history: Sequence[str]
) -> tuple[str, str]:
    load = load_words(problem)
    reached = f"{percent(share)} of the {load}"
    if problem.inverse:
        return (
            f"Beyond {reached} no unloaded shape was found that sags into the given one: the tissue is too soft for its weight.",
            "Give stiffer tissue, or check the geometry for folds and thin parts.",
        )
    if critical is not None or any("unstable equilibrium" in line for line in history):
        at = f"beyond {reached}" if critical is None else f"under about {percent(critical)} of the {load}"
        beyond = "" if critical is None else " beyond"
        if _is_pulled(problem, x):
            return (
                f"The body, which is stretched, loses its stability {at}, and no stable shape was found{beyond}.",
                f"Stiffen the tissue, or reduce the {load}.",
            )
        return (
            f"The body buckles {at}, and no stable shape was found{beyond}.",
            f"Stiffen, thicken or support it, or reduce the {load}.",
        )
    if inverted := [line for line in history if "inverted element" in line]:
        where = inverted[-1].rsplit(": ", 1)[-1]
        return (
            f"Under more than {reached}, elements turn inside out ({where}).",
            "Stiffen the tissue there, or mesh it more finely.",
        )
    return (
        f"A stable shape was found under at most {reached}." if share else "No stable shape was found.",
        f"Stiffen the tissue, reduce the {load}, or check the geometry for folds and thin parts.",
    )


def load_words(problem: Problem) -> str:
    """Return what loads the body: "load", or "prescribed displacement" where there is neither gravity nor pressure."""
    return "load" if problem.full.any() or problem.body.pressure is not None else "prescribed displacement"


def _is_pulled(problem: Problem, x: np.ndarray) -> bool:
    """Return whether the mean stress of the tissue is a tension: the virial of its inner forces is positive."""
    forces = problem.body.residual(problem.X, x, np.zeros(3))
    return float(np.sum(forces * x)) > 0.0


def percent(share: float) -> str:
    """Return a share of the load [1] as text in percent, to two digits."""
    return f"{100 * share:.2g} %" if share < 0.1 else f"{100 * share:.0f} %"


def largest_poisson_ratio(body: Body) -> float:
    """Return the largest Poisson's ratio in a body at rest [1]."""
    mu, kappa = (np.asarray(value) for value in body.law.moduli_at_rest(body.density.shape))
    return float(np.max((3.0 * kappa - 2.0 * mu) / (2.0 * (3.0 * kappa + mu))))


def buckling_share(problem: Problem, x: np.ndarray, share: float) -> float | None:
    """Predict the share of the load at which the body buckles, by linear buckling analysis about a stable shape.

    The tangent K changes with the load as K + s K' along the body's first-order response; it becomes singular at the least s > 0
    with (K + s K') v = 0 (Bathe, Finite element procedures, 2014, section 6.8.2). The load is gravity and pressure.

    Returns
    -------
    float or None
        Share [1]; None if it is not known (no potential, several ranks, not stable), or above 1.5.
    """
    if not problem.is_symmetric or problem.body.discretization.ranks.size > 1 or not problem.full.any():
        return None
    problem, solver = replace(problem, x=x), LinearSolver()
    pullback = Pullback.loaded(problem.body, x)

    def stiffness(y: np.ndarray):
        body = problem.body
        matrix, _ = body.linearised(problem.X, y, body.volume_ratio(problem.X, y), in_plane=problem.in_plane)
        return problem.pulled_back(matrix, pullback)

    K = stiffness(x)
    try:
        solver.factor(K)
        followed = problem.response(solver, K, pullback)
    except FloatingPointError:
        return None
    if not solver.is_definite(K):
        return None
    length = PROBE * np.ptp(problem.X, axis=0).max() / max(float(np.abs(followed).max()), 1e-300)
    change = (stiffness(x + length * followed) - K) / length
    inverse = LinearOperator(K.shape, matvec=lambda v: solver.solve(K, v, 1e-8), dtype=float)  # pyright: ignore[reportCallIssue]
    start = np.random.Generator(np.random.Philox(0)).standard_normal(K.shape[0])
    try:
        found = eigsh(-change, 1, K, which="LA", Minv=inverse, v0=start, tol=1e-4, return_eigenvectors=False)
    except (ArpackError, FloatingPointError):
        return None
    most = float(np.asarray(found)[0])
    critical = share + 1.0 / most if most > 0.0 else np.inf
    return critical if critical <= BELIEVED_TO else None
