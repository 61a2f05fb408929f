"""Forward and inverse equilibrium of a body under gravity."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..core.errors import ConvergenceError
from ..core.linear import Engine, LinearSolver
from ..core.newton import NewtonReport, minimise, newton, ramp
from .body import Body, Frame, VolumeRates
from .space import Space

SMALLEST_STEP = 0.25  # of a load; below that, going downhill is cheaper
REUSE_BELOW = 0.05  # a step that brings the residual below this share earns its tangent another one
LOOSEST, CLOSE = 1e-2, 1e-6  # how exactly a linear system is solved, relative to its right-hand side
START_VOLUME = 0.01  # how far from rest the volume ratio of a starting shape is believed


class Equilibrium:
    """Solver for bodies on one frame; it keeps factors from solve to solve, which change its path by no more than rounding.

    Parameters
    ----------
    relative_tolerance : float
        Bound on the residual over the weight of the body (Euclidean norms) [1].
    tell : callable, optional
        Hears a few words on each iteration.
    on : Engine, optional
        What the linear systems are solved on; that of :func:`.linear.engine` unless given. Bodies that ranks share need one
        that sums over these ranks.
    """

    def __init__(
        self,
        relative_tolerance: float = 1e-8,
        tell: Callable[[str], None] | None = None,
        on: Engine | None = None,
    ) -> None:
        self.relative_tolerance, self.tell, self._on = relative_tolerance, tell, on
        self._linear = {in_plane: LinearSolver(symmetric=True, on=on) for in_plane in (False, True)}
        self._inverse = LinearSolver(symmetric=False, on=on)

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return sum(s.n_factorizations for s in (*self._linear.values(), self._inverse))

    @property
    def krylov_steps(self) -> int:
        """Solves with a factor so far."""
        return sum(s.n_steps for s in (*self._linear.values(), self._inverse))

    def kept(self) -> dict[str, np.ndarray]:
        """Everything that the next solve depends on besides its arguments: the factors, for ``restore``."""
        solvers = self._linear.items()
        return {f"{int(plane)}.{name}": array for plane, solver in solvers for name, array in solver.kept().items()}

    def restore(self, frame: Frame, kept: Mapping[str, np.ndarray]) -> None:
        """Go on, to the bit, where another solver on the same frame was."""
        for in_plane, solver in self._linear.items():
            prefix = f"{int(in_plane)}."
            part = {name.removeprefix(prefix): array for name, array in kept.items() if name.startswith(prefix)}
            if part:
                _, pattern = frame.solved(in_plane)
                solver.restore(pattern.matrix(pattern.zeros(), np.zeros(pattern.n_dofs)), part)

    def loaded(
        self, body: Body, X: np.ndarray, gravity: np.ndarray, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, NewtonReport]:
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
            A nearby equilibrium; tried first, then the unloaded shape, then again letting its out-of-balance forces go
            little by little. Without it gravity is ramped up from the unloaded shape. Where Newton's method fails
            even in small steps (a slender breast that buckles), potential energy is minimised from there.

        Returns
        -------
        (n_nodes, 3) array [mm], NewtonReport
            Loaded positions; nodes that no tissue holds stay where ``start`` (or X) had them.

        Raises
        ------
        ConvergenceError
            With everything that was tried.
        """
        report = NewtonReport(tell=self.tell)
        at_rest = X if start is None else np.where(body.active_nodes[:, None], X, start)
        problem = _Problem(body, X, at_rest, gravity, gravity)
        by_gravity = _Path(
            problem.x, lambda x, load: self._newton(replace(problem, x=x, gravity=load * gravity), report)
        )
        paths = [("the unloaded shape", by_gravity, {"smallest": SMALLEST_STEP})]
        if start is not None:
            nearby = self._let_go(replace(problem, x=start), report)
            paths = [
                ("the nearby shape", nearby, {"smallest": 1.0}),
                ("the unloaded shape", by_gravity, {"smallest": 1.0}),
                ("the nearby shape", nearby, {"first": 0.5, "smallest": SMALLEST_STEP}),
            ]
        for number, (name, path, steps) in enumerate(paths):
            if number:
                report.history.append(f"from {name}")
            try:
                return ramp(path.advance, path.reached, report, **steps), report
            except ConvergenceError:
                continue
        report.history.append("downhill in potential energy from there")
        try:
            return self._minimise(replace(problem, x=paths[-1][1].reached), report), report
        except ConvergenceError as error:
            raise ConvergenceError(str(error), report.history + error.history) from error

    def _let_go(self, problem: _Problem, report: NewtonReport) -> _Path:
        """Way from a shape that is near: what is out of balance there is held, and let go little by little."""

        def advance(x: np.ndarray, share: float) -> np.ndarray:
            held = (1.0 - share) * problem.out_of_balance if share < 1.0 else 0.0
            return self._newton(replace(problem, x=x, held=held), report)

        return _Path(problem.x, advance)

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
        report = NewtonReport(tell=self.tell)

        def advance(X: np.ndarray, factor: float) -> np.ndarray:
            return self._newton(_Problem(body, x, X, factor * gravity, gravity, inverse=True), report)

        X = ramp(advance, x, report, max_iterations=300)  # slender breasts hang far: many small steps
        self._inverse.forget()
        return X, report

    def _newton(self, problem: _Problem, report: NewtonReport) -> np.ndarray:
        """Newton on the unknown positions and volume ratios together, the ratios eliminated element by element.

        Carrying the volume ratio along keeps the pressure of a trial shape small, so the iteration bears large steps
        however incompressible the tissue is.
        """
        body, n = problem.body, problem.free.size
        shape = (body.frame.space.n_elements, body.frame.space.table.weight.size)
        scale = problem.weight / np.sqrt(body.frame.total(np.prod(shape)))

        def residual(z: np.ndarray) -> np.ndarray:
            shapes, J_bar = problem.shapes(z[:n]), z[n:].reshape(shape)
            r = problem.free_part(body.residual(*shapes, problem.gravity, J_bar)) - problem.held
            return np.concatenate([r, scale * (body.dilation(*shapes) - J_bar).ravel()])

        solver = self._inverse if problem.inverse else self._linear[problem.in_plane]
        tolerance = self.relative_tolerance * problem.weight

        def norm(r: np.ndarray) -> float:
            return body.frame.norm(r[:n], r[n:])

        kept = _Kept(lambda z: problem.linearised(z[:n], z[n:].reshape(shape)), tolerance, norm)

        def step(z: np.ndarray, r: np.ndarray) -> np.ndarray:
            (matrix, rates), forcing = kept.at(z, r)
            gap = r[n:].reshape(shape) / scale
            du = solver.solve(matrix, -(r[:n] + problem.free_part(body.volume_force(rates, gap))), forcing)
            moved = (problem.positions(z[:n] + du) - problem.positions(z[:n]))[body.frame.space.element_nodes]
            dJ = np.einsum("eqm,em->eq", rates.volume_rate, moved.reshape(shape[0], -1)) + gap
            return np.concatenate([du, dJ.ravel()])

        z = np.concatenate([problem.x.reshape(-1)[problem.free], problem.volume_ratios.ravel()])
        z = newton(residual, step, z, tolerance=tolerance, report=report, norm=norm)
        if kept.value is not None and not problem.inverse and not solver.is_definite(kept.value[0]):
            raise ConvergenceError("Newton found an equilibrium that is not stable.", ["found an unstable equilibrium"])
        _check_elements(body, *problem.shapes(z[:n]))
        return problem.positions(z[:n])

    def _minimise(self, problem: _Problem, report: NewtonReport) -> np.ndarray:
        """Walk down the potential energy."""
        body, solver = problem.body, LinearSolver(symmetric=True, on=self._on)

        def energy(values: np.ndarray) -> float:
            return body.potential(problem.X, problem.positions(values), problem.gravity)

        def residual(values: np.ndarray) -> np.ndarray:
            return problem.free_part(body.residual(problem.X, problem.positions(values), problem.gravity))

        def step(values: np.ndarray, r: np.ndarray, damping: float) -> np.ndarray:
            x = problem.positions(values)
            damping *= max(np.linalg.norm(problem.gravity), 1.0)  # pyright: ignore[reportAssignmentType]
            J_bar = body.dilation(problem.X, x)
            matrix, _ = body.linearised(problem.X, x, J_bar, in_plane=problem.in_plane, damping=damping)
            return solver.solve(matrix, -r, CLOSE)

        start = problem.x.reshape(-1)[problem.free]
        tolerance = self.relative_tolerance * problem.weight
        try:
            values = minimise(energy, residual, step, start, tolerance=tolerance, report=report)
        finally:
            solver.forget()
        _check_elements(body, *problem.shapes(values))
        return problem.positions(values)


def _check_elements(body: Body, X: np.ndarray, x: np.ndarray) -> None:
    """Refuse a shape that balances with an element turned inside out."""
    turned = body.inside_out(X, x)
    if len(turned):
        where = "({}) mm".format(", ".join(f"{value:.1f}" for value in turned[0]))
        raise ConvergenceError(
            f"{len(turned)} elements turn inside out, the first at {where}: tissue there would have to bear more than it can.",
            [f"{len(turned)} elements inside out, the first at {where}"],
        )


class _Path:
    """A way to an equilibrium: advance(x, share of the way) -> x; remembers what was reached."""

    def __init__(self, start: np.ndarray, advance: Callable[[np.ndarray, float], np.ndarray]) -> None:
        self.reached, self._advance = start, advance

    def advance(self, x: np.ndarray, share: float) -> np.ndarray:
        """Go on from x."""
        self.reached = self._advance(x, share)
        return self.reached


class _Kept:
    """A linearisation that is used again as long as it brings the residual down fast enough, and how exactly to solve with it."""

    def __init__(
        self, linearise: Callable[[np.ndarray], Any], tolerance: float, norm: Callable[[np.ndarray], float]
    ) -> None:
        self._linearise, self._tolerance, self._length = linearise, tolerance, norm
        self.value, self._norm = None, np.inf

    def at(self, z: np.ndarray, r: np.ndarray) -> tuple[Any, float]:
        """The linearisation to use at z, where the residual is r, and the forcing term of Eisenstat & Walker (1996, choice 2)."""
        norm = self._length(r)
        if self.value is None or not norm < REUSE_BELOW * self._norm:
            self.value = None
            self.value = self._linearise(z)
        forcing = np.clip(0.9 * (norm / self._norm) ** 2, 0.1 * self._tolerance / norm, LOOSEST)
        self._norm = norm
        return self.value, float(forcing)


@dataclass(frozen=True, eq=False)
class _Problem:
    """One nonlinear solve: a body, the known shape X, the start x of the unknown one, gravity now and in full.

    ``inverse``: the loaded shape is known and the unloaded one is not.
    """

    body: Body
    X: np.ndarray
    x: np.ndarray
    gravity: np.ndarray
    full: np.ndarray
    held: np.ndarray | float = 0.0  # force on the free degrees of freedom that still holds the body back
    inverse: bool = False

    @property
    def in_plane(self) -> bool:
        """Nothing pulls along a section's normal."""
        return isinstance(self.body.frame.space, Space) and bool(self.full[2] == 0.0)

    @cached_property
    def free(self) -> np.ndarray:
        """Degrees of freedom solved for."""
        return self.body.frame.solved(self.in_plane)[0]

    @cached_property
    def _active(self) -> np.ndarray:
        return np.repeat(self.body.active_nodes, 3)[self.free]

    @cached_property
    def weight(self) -> float:
        """Norm of the nodal weights [mN/mm]: what the residual is measured against."""
        mass = self.body.lumped_mass(self.X)
        return float(np.linalg.norm(mass) * max(np.linalg.norm(self.full), 1.0))

    @cached_property
    def volume_ratios(self) -> np.ndarray:
        """Volume ratios to start from: those of x, but not far from rest (n_elements, n_qp) [1]."""
        rest = np.asarray(self.body.law.volume_at_rest())
        ratios = self.body.dilation(*self._ordered(self.x)) / rest
        return rest * np.clip(ratios, 1.0 - START_VOLUME, 1.0 + START_VOLUME)

    @cached_property
    def out_of_balance(self) -> np.ndarray:
        """Residual at the start x [mN/mm]."""
        return self.free_part(self.body.residual(*self._ordered(self.x), self.gravity, self.volume_ratios))

    def positions(self, values: np.ndarray) -> np.ndarray:
        """All positions (n_nodes, 3) from the free ones."""
        out = self.x.copy()
        out.reshape(-1)[self.free] = values
        return out

    def shapes(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unloaded and loaded positions from the free ones of the unknown shape."""
        return self._ordered(self.positions(values))

    def _ordered(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (unknown, self.X) if self.inverse else (self.X, unknown)

    def linearised(self, values: np.ndarray, J_bar: np.ndarray) -> tuple[sp.bsr_array, VolumeRates]:
        """Derivatives by the unknown shape and the volume ratios."""
        if self.inverse:
            return self.body.linearised_reference(*self.shapes(values), J_bar, self.gravity, in_plane=self.in_plane)
        return self.body.linearised(*self.shapes(values), J_bar, in_plane=self.in_plane)

    def free_part(self, forces: np.ndarray) -> np.ndarray:
        """Forces (n_nodes, 3) on the free degrees of freedom, 0 where no tissue holds the node."""
        return np.where(self._active, forces.reshape(-1)[self.free], 0.0)
