"""Forward and inverse equilibrium of a body under gravity."""

from __future__ import annotations

import numpy as np

from ..core.errors import ConvergenceError
from ..core.linear import LinearSolver, linear_solver
from ..core.newton import NewtonReport, minimise, newton, ramp
from .body import Body


class Equilibrium:
    """Solver for bodies on one frame: keeps the factorised pattern, nothing of any solution.

    Parameters
    ----------
    relative_tolerance : float
        Bound on the residual over the weight of the body (Euclidean norms) [1].
    """

    def __init__(self, relative_tolerance: float = 1e-8) -> None:
        self.relative_tolerance = relative_tolerance
        self._linear: dict[tuple[str, bool], LinearSolver] = {}

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return sum(s.n_factorizations for s in self._linear.values())

    def loaded(self, body: Body, X: np.ndarray, gravity: np.ndarray, start: np.ndarray | None = None) -> tuple[np.ndarray, NewtonReport]:
        """Find the loaded shape of a body whose unloaded shape is known.

        Parameters
        ----------
        body : Body
            Tissue, skin and supports.
        X : (n_nodes, 3) array [mm]
            Unloaded positions.
        gravity : (3,) array [mm/s^2]
            Acceleration in the section's axes.
        start : (n_nodes, 3) array [mm], optional
            A nearby equilibrium; tried first. Then gravity is ramped up from the unloaded shape, and where Newton's
            method fails even in small steps (a slender breast that buckles), potential energy is minimised.

        Returns
        -------
        (n_nodes, 3) array [mm], NewtonReport
            Loaded positions; nodes that no tissue holds stay where ``start`` (or X) had them.

        Raises
        ------
        ConvergenceError
            With everything that was tried.
        """
        report = NewtonReport()
        if start is not None:
            try:
                return self._solve(body, X, start, gravity, gravity, "x", report), report
            except ConvergenceError as error:
                report.history.append(f"from the nearby shape: {error.history[-1]}")
        else:
            start = X
        reached = np.where(body.active_nodes[:, None], X, start)

        def advance(x: np.ndarray, factor: float) -> np.ndarray:
            nonlocal reached
            reached = self._solve(body, X, x, factor * gravity, gravity, "x", report)
            return reached

        try:
            return ramp(advance, reached, report, smallest=0.25), report
        except ConvergenceError:
            report.history.append("downhill in potential energy from the last load factor")
            try:
                return self._solve(body, X, reached, gravity, gravity, "x", report, damped=True), report
            except ConvergenceError as error:
                raise ConvergenceError(str(error), report.history + error.history) from error

    def unloaded(self, body: Body, x: np.ndarray, gravity: np.ndarray) -> tuple[np.ndarray, NewtonReport]:
        """Find the unloaded shape of a body whose loaded shape is known.

        The discrete equilibrium equations are those of ``loaded``, solved for the reference positions (inverse
        deformation, Govindjee & Mihalic 1996), so that loading the answer again gives the known shape back to the
        solver's tolerance.

        Parameters
        ----------
        body, gravity
            As for ``loaded``.
        x : (n_nodes, 3) array [mm]
            Loaded positions, as imaged.

        Raises
        ------
        ConvergenceError
            With everything that was tried.
        """
        report = NewtonReport()
        advance = lambda X, factor: self._solve(body, X, x, factor * gravity, gravity, "X", report)  # noqa: E731
        return ramp(advance, x, report), report

    def _solve(
        self, body: Body, X: np.ndarray, x: np.ndarray, gravity: np.ndarray, full: np.ndarray, unknown: str, report: NewtonReport, damped: bool = False
    ) -> np.ndarray:
        in_plane = bool(full[2] == 0.0)
        free, _ = body.frame.solved(in_plane)
        active = np.repeat(body.active_nodes, 3)[free]
        fixed = x if unknown == "X" else X

        def positions(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            moved = (X if unknown == "X" else x).copy()
            moved.reshape(-1)[free] = values
            return (moved, fixed) if unknown == "X" else (fixed, moved)

        def residual(values: np.ndarray) -> np.ndarray:
            return np.where(active, body.residual(*positions(values), gravity).reshape(-1)[free], 0.0)

        def step(values: np.ndarray, r: np.ndarray, damping: float = 0.0) -> np.ndarray:
            solver = self._linear_solver(unknown, in_plane)
            scaled = damping * np.linalg.norm(full)
            solver.factor(body.tangent(*positions(values), gravity, by=unknown, in_plane=in_plane, damping=scaled))
            return solver.solve(-r)

        tolerance = self.relative_tolerance * _weight(body, X if unknown == "x" else x, full)
        start = (X if unknown == "X" else x).reshape(-1)[free]
        if damped:
            energy = lambda values: body.potential(*positions(values), gravity)  # noqa: E731
            values = minimise(energy, residual, step, start, tolerance=tolerance, report=report)
        else:
            values = newton(residual, step, start, tolerance=tolerance, report=report)
        moved = positions(values)
        return moved[0] if unknown == "X" else moved[1]

    def _linear_solver(self, unknown: str, in_plane: bool) -> LinearSolver:
        key = (unknown, in_plane)
        if key not in self._linear:
            self._linear[key] = linear_solver(symmetric=unknown == "x")
        return self._linear[key]


def _weight(body: Body, positions: np.ndarray, gravity: np.ndarray) -> float:
    """Norm of the nodal weights [mN/mm]: what the residual is measured against."""
    mass = np.einsum("eq,qa->ea", body.density * body.volumes(positions) * body.fraction[:, None], body.frame.space.table.value)
    nodal = np.bincount(body.frame.space.element_nodes.ravel(), weights=mass.ravel(), minlength=body.frame.space.n_nodes)
    return float(np.linalg.norm(nodal) * max(np.linalg.norm(gravity), 1.0))
