"""Ways to the unloaded shape of a body whose loaded shape is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..core.errors import ConvergenceError
from ..numerics.newton import NewtonReport, ramp
from .body import Body
from .failure import NoEquilibriumError, explanation, load_words
from .problem import Problem

STIFFER = 20.0  # how much stiffer a body is made that does not come through under its load
MAX_ITERATIONS = 300  # of a load ramp: slender breasts sag far and need many small steps


class LoadPath:
    """Sequence of problems that ends at the required equilibrium; ``reached`` is the last solution, ``share`` its place.

    ``advance(x, share)`` solves the problem at a fraction ``share`` of the path, starting from x (n_nodes, 3) [mm].
    """

    def __init__(self, start: np.ndarray, advance: Callable[[np.ndarray, float], np.ndarray]) -> None:
        self.reached, self.share, self._advance = start, 0.0, advance

    def advance(self, x: np.ndarray, share: float) -> np.ndarray:
        """Solve at a fraction ``share`` of the path, starting from x; return and store the solution, both (n_nodes, 3) [mm]."""
        self.reached = self._advance(x, share)
        self.share = share
        return self.reached


@dataclass(frozen=True, eq=False)
class Unloading:
    """One inverse problem, and the ways to its solution.

    Parameters
    ----------
    body : Body
        Tissue, skin and supports.
    x : (n_nodes, 3) array [mm]
        Known, loaded positions.
    gravity : (3,) array [mm/s^2]
        Acceleration.
    newton : callable
        Function (problem, report) -> positions that solves a problem by Newton's method, or raises ConvergenceError.
    report : NewtonReport
        Record of the solve.
    """

    body: Body
    x: np.ndarray
    gravity: np.ndarray
    newton: Callable[[Problem, NewtonReport], np.ndarray]
    report: NewtonReport

    def solve(self, start: np.ndarray | None = None) -> np.ndarray:
        """Return the unloaded positions (n_nodes, 3) [mm]: from those of a similar body, by load, or by softening.

        Raises
        ------
        NoEquilibriumError
            If no way leads there, with the shape that the largest share of the load gives.
        """
        if start is not None:
            try:
                return self._solved(self.body, start)
            except ConvergenceError as error:
                self.report.history.append(f"from the shape of a similar body: {(error.history or [error])[-1]}")
        path = self._load_path(self.body)
        try:
            return self.by_load(path)
        except ConvergenceError as error:
            try:
                return self.by_softening()
            except ConvergenceError:
                problem = Problem(self.body, self.x, path.reached, self.gravity, self.gravity, inverse=True)
                raise failure(problem, path, None, self.report.history) from error

    def by_load(self, path: LoadPath | None = None) -> np.ndarray:
        """Return the unloaded positions (n_nodes, 3) [mm], reached by increasing the load from none along a path."""
        path = path or self._load_path(self.body)
        return ramp(path.advance, self.x, self.report, max_iterations=MAX_ITERATIONS)

    def by_softening(self) -> np.ndarray:
        """Return the unloaded positions (n_nodes, 3) [mm], reached by softening a stiffer body under the whole load.

        The resistance to shear is raised by the factor ``STIFFER`` and lowered in steps that are equal in its logarithm. The
        bulk modulus stays, so this is another path than that of the load.
        """
        self.report.history.append(f"with tissue {STIFFER:g} times as stiff, softened under the whole load")
        X = self.by_load(self._load_path(self.body.stiffened(STIFFER)))

        def softer(X: np.ndarray, share: float) -> np.ndarray:
            return self._solved(self.body.stiffened(STIFFER ** (1.0 - share)), X)

        return ramp(softer, X, self.report, smallest=1 / 128, first=1 / 6, max_iterations=2 * MAX_ITERATIONS)

    def _load_path(self, body: Body) -> LoadPath:
        return LoadPath(self.x, lambda X, share: self._solved(body, X, share))

    def _solved(self, body: Body, X: np.ndarray, share: float = 1.0) -> np.ndarray:
        problem = Problem(body, self.x, X, self.gravity, self.gravity, inverse=True)
        problem = replace(problem, other_loads_norm=problem.pressure_load_norm)
        return self.newton(problem.with_load_share(share, X), self.report)


def failure(problem: Problem, path: LoadPath, critical: float | None, history: list[str]) -> NoEquilibriumError:
    """Return the error for a body without equilibrium under the whole load, with its cause and the last shape on the way."""
    cause, remedy = explanation(problem, path.reached, path.share, critical, history)
    return NoEquilibriumError(cause, remedy, history, path.reached, path.share, load_words(problem))
