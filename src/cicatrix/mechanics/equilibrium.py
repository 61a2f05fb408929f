"""Forward and inverse equilibrium of a body under gravity, pressure and what moves its supports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ..core.errors import ConvergenceError
from ..numerics.linear import Engine, LinearSolver
from ..numerics.newton import NewtonReport, minimise, newton, ramp
from .body import Body, Frame, VolumeRates
from .pullback import Pullback
from .supports import Supports

SMALLEST_STEP = 0.25  # of a load; below that, going downhill is cheaper
REUSE_BELOW = 0.05  # a step that brings the residual so far down earns its tangent another one, under gravity alone
LOOSEST, CLOSE = 1e-2, 1e-6  # how exactly a linear system is solved, relative to its right-hand side
DRAG_STEP, NO_WAY = 1e-6, 1e-13  # of the body's extent: step of a difference, and what is rounding
RIGID = 1e-6  # of the forces that move supports alone: what a body that follows as a whole is measured against
ASIDE, MOST_SADDLES = 1e-4, 6  # of the body's extent: how far beside a saddle to go on; how many to leave


class Equilibrium:
    """Solver for bodies on one frame; it keeps factors from solve to solve, which change its answers within the tolerance.

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
        self._linear: dict[bool, LinearSolver] = {}  # by whether a section's normal is left out
        self._gone = np.zeros(2, int)  # factorisations and Krylov steps of solvers that are gone

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return int(self._gone[0]) + sum(solver.n_factorizations for solver in self._linear.values())

    @property
    def krylov_steps(self) -> int:
        """Solves with a factor so far."""
        return int(self._gone[1]) + sum(solver.n_steps for solver in self._linear.values())

    def forget(self) -> None:
        """Let all factors go; the next solve depends on its arguments alone."""
        for solver in self._linear.values():
            self._retire(solver)
        self._linear.clear()

    def _retire(self, solver: LinearSolver) -> None:
        self._gone += solver.n_factorizations, solver.n_steps
        solver.forget()

    def kept(self) -> dict[str, np.ndarray]:
        """Everything that the next solve depends on besides its arguments: the factors, for ``restore``."""
        return {
            f"{int(in_plane)}.{name}": array
            for in_plane, solver in self._linear.items()
            for name, array in solver.kept().items()
        }

    def restore(self, frame: Frame, kept: Mapping[str, np.ndarray]) -> None:
        """Go on, to the bit, where another solver on the same frame was."""
        for in_plane in (False, True):
            prefix = f"{int(in_plane)}."
            part = {name.removeprefix(prefix): array for name, array in kept.items() if name.startswith(prefix)}
            if part:
                self._linear[in_plane] = LinearSolver(self._on)
                self._linear[in_plane].restore(frame.empty_matrix(in_plane), part)

    def loaded(
        self,
        body: Body,
        X: np.ndarray,
        gravity: np.ndarray,
        start: np.ndarray | None = None,
        held_at: np.ndarray | None = None,
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
            even in small steps (a slender breast that buckles), potential energy is minimised from there, if no pressure acts.
        held_at : (n_nodes, 3) array [mm], optional
            Where nodes are held in the end (fixed ones, and sliding ones along their directions); they get there with the load.
            Without it they stay where ``start`` (or X) has them.

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
        problem = replace(problem, beside=np.hypot(problem.pressing, self._reaction(problem, held_at)))
        by_load = _Path(
            problem.x, lambda x, load: self._newton(self._carried(problem.under(load, x), load, held_at), report)
        )
        if problem.beside == 0.0 and not gravity.any():
            problem = replace(problem, beside=body.inner_force(X, problem.x))
        is_gradual = held_at is not None or body.pressure is not None
        paths = [("the unloaded shape", by_load, {"smallest": SMALLEST_STEP / 16 if is_gradual else SMALLEST_STEP})]
        if start is not None:
            nearby = self._let_go(self._carried(replace(problem, x=start), 1.0, held_at), report)
            paths = [
                ("the nearby shape", nearby, {"smallest": 1.0}),
                ("the unloaded shape", by_load, {"smallest": 1.0}),
                ("the nearby shape", nearby, {"first": 0.5, "smallest": SMALLEST_STEP}),
            ]
        for number, (name, path, steps) in enumerate(paths):
            if number:
                report.history.append(f"from {name}")
            try:
                return ramp(path.advance, path.reached, report, **steps), report
            except ConvergenceError as error:
                if number == len(paths) - 1 and not body.has_potential:
                    raise ConvergenceError(str(error), report.history) from error
        report.history.append("downhill in potential energy from there")
        try:
            last = self._carried(replace(problem, x=paths[-1][1].reached), 1.0, held_at)
            return self._minimise(last, report), report
        except ConvergenceError as error:
            raise ConvergenceError(str(error), report.history + error.history) from error

    def _carried(self, problem: _Problem, share: float, held_at: np.ndarray | None) -> _Problem:
        """Put held nodes a share of their way on, and let the others follow to first order."""
        if held_at is None:
            return problem
        way = problem.supports.held(problem.X + share * (held_at - problem.X) - problem.x)
        if np.abs(way).max() <= NO_WAY * np.ptp(problem.X, axis=0).max():
            return problem
        J_bar = problem.body.dilation(problem.X, problem.x)
        start = problem.unknowns(problem.x)
        tangent = problem.linearised(start, J_bar)
        followed = tangent.solve(self._solver(problem), -problem.free_part(problem.drag(way)), CLOSE)
        return replace(problem, x=problem.positions(start + followed) + way)

    def _reaction(self, problem: _Problem, held_at: np.ndarray | None) -> float:
        """Norm of the forces that hold a body whose held nodes have gone their way, to first order [mN]."""
        if held_at is None:
            return 0.0
        way = problem.supports.held(held_at - problem.x)
        followed = self._carried(problem, 1.0, held_at).x - problem.x
        norms = [float(np.linalg.norm(problem.drag(moved))) for moved in (followed, way)]
        return norms[0] + RIGID * norms[1]

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
        solver's tolerance, if it is a stable equilibrium; ``is_stable`` of the report says whether it is (without pressure).

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
            problem = _Problem(body, x, X, gravity, gravity, inverse=True)
            return self._newton(replace(problem, beside=problem.pressing).under(factor, X), report)

        X = ramp(advance, x, report, max_iterations=300)  # slender breasts hang far: many small steps
        problem = _Problem(body, X, x, gravity, gravity)
        if problem.is_symmetric:
            tangent = problem.linearised(problem.unknowns(x), body.dilation(X, x))
            report.is_stable = self._solver(problem).is_definite(tangent.matrix)
        if not report.is_stable:
            report.history.append("the known shape is not a stable equilibrium of it: loaded again it goes elsewhere")
        return X, report

    def _newton(self, problem: _Problem, report: NewtonReport) -> np.ndarray:
        """Newton on the unknown positions and volume ratios together, the ratios eliminated element by element.

        Carrying the volume ratio along keeps the pressure of a trial shape small, so the iteration bears large steps
        however incompressible the tissue is.
        """
        body, n = problem.body, problem.supports.n_unknowns
        shape = (body.frame.space.n_elements, body.frame.space.table.weight.size)
        scale = problem.weight / np.sqrt(body.frame.total(np.prod(shape)))

        def residual(z: np.ndarray) -> np.ndarray:
            shapes, J_bar = problem.shapes(z[:n]), z[n:].reshape(shape)
            r = problem.free_part(body.residual(*shapes, problem.gravity, J_bar)) - problem.held
            return np.concatenate([r, scale * (body.dilation(*shapes) - J_bar).ravel()])

        solver, tolerance = self._solver(problem), self.relative_tolerance * problem.weight
        below = REUSE_BELOW if problem.beside == 0.0 else 0.0

        def norm(r: np.ndarray) -> float:
            return body.frame.norm(r[:n], r[n:])

        kept = _Kept(lambda z: problem.linearised(z[:n], z[n:].reshape(shape)), below, tolerance, norm)

        def step(z: np.ndarray, r: np.ndarray) -> np.ndarray:
            tangent, forcing = kept.at(z, r)
            rates, gap = tangent.rates, r[n:].reshape(shape) / scale
            du = tangent.solve(solver, -(r[:n] + problem.free_part(body.volume_force(rates, gap))), forcing)
            dJ = body.volume_change(rates, problem.positions(z[:n] + du) - problem.positions(z[:n])) + gap
            return np.concatenate([du, dJ.ravel()])

        z = np.concatenate([problem.unknowns(problem.x), problem.volume_ratios.ravel()])
        z = newton(residual, step, z, tolerance=tolerance, report=report, norm=norm)
        if kept.value is not None and problem.is_symmetric and not solver.is_definite(kept.value.matrix):
            raise ConvergenceError("Newton found an equilibrium that is not stable.", ["found an unstable equilibrium"])
        _check_elements(body, *problem.shapes(z[:n]))
        return problem.positions(z[:n])

    def _minimise(self, problem: _Problem, report: NewtonReport) -> np.ndarray:
        """Walk down the potential energy."""
        body, solver = problem.body, LinearSolver(self._on)

        def energy(values: np.ndarray) -> float:
            return body.potential(problem.X, problem.positions(values), problem.gravity)

        def residual(values: np.ndarray) -> np.ndarray:
            return problem.free_part(body.residual(problem.X, problem.positions(values), problem.gravity))

        def step(values: np.ndarray, r: np.ndarray, damping: float) -> np.ndarray:
            x = problem.positions(values)
            damping *= max(np.linalg.norm(problem.gravity), 1.0)  # pyright: ignore[reportAssignmentType]
            return problem.linearised(values, body.dilation(problem.X, x), damping).solve(solver, -r, CLOSE)

        values, tolerance = problem.unknowns(problem.x), self.relative_tolerance * problem.weight
        aside = np.random.Generator(np.random.Philox(0)).standard_normal(values.size)
        aside *= ASIDE * np.ptp(problem.X, axis=0).max()
        try:
            for _ in range(MOST_SADDLES):
                values = minimise(energy, residual, step, values, tolerance=tolerance, report=report)
                matrix = problem.linearised(values, body.dilation(problem.X, problem.positions(values))).matrix
                if solver.is_definite(matrix):
                    break
                report.history.append("that way ended at an unstable equilibrium; on from beside it")
                values = values + aside
            else:
                raise ConvergenceError("No stable equilibrium was found.", ["every way down ended at a saddle"])
        finally:
            self._retire(solver)
        _check_elements(body, *problem.shapes(values))
        return problem.positions(values)

    def _solver(self, problem: _Problem) -> LinearSolver:
        if problem.in_plane not in self._linear:
            self._linear[problem.in_plane] = LinearSolver(self._on)
        return self._linear[problem.in_plane]


def _symmetric_part(matrix: sp.bsr_array) -> sp.bsr_array:
    """Of a matrix whose pattern is symmetric; it keeps the pattern, with all its zeros."""
    turned = sp.bsr_array(matrix.T, blocksize=matrix.blocksize)
    turned.sort_indices()
    return sp.bsr_array((0.5 * (matrix.data + turned.data), matrix.indices, matrix.indptr), shape=matrix.shape)


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
        self,
        linearise: Callable[[np.ndarray], Any],
        below: float,
        tolerance: float,
        norm: Callable[[np.ndarray], float],
    ) -> None:
        self._linearise, self._below, self._tolerance, self._length = linearise, below, tolerance, norm
        self.value, self._norm = None, np.inf

    def at(self, z: np.ndarray, r: np.ndarray) -> tuple[Any, float]:
        """The linearisation to use at z, where the residual is r, and the forcing term.

        That is Eisenstat & Walker's (1996, choice 2) for a new one. With an old one the residual comes down in proportion,
        however exactly the system is solved.
        """
        norm = self._length(r)
        progress = norm / self._norm if np.isfinite(self._norm) else 1.0
        exactly = 0.9 * progress**2
        if self.value is None or not norm < self._below * self._norm:
            self.value = None
            self.value = self._linearise(z)
        else:
            exactly = 0.5 * progress  # it has changed by about 2 progress since it was made
        forcing = np.clip(exactly, 0.1 * self._tolerance / norm, LOOSEST)
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
    beside: float = 0.0  # norm of the loads beside gravity, in full [mN]

    @property
    def in_plane(self) -> bool:
        """Nothing pulls along a section's normal."""
        return self.body.frame.space.n_axes == 2 and bool(self.full[2] == 0.0)

    @property
    def supports(self) -> Supports:
        """What is held, and what is solved for."""
        return self.body.frame.supports(self.in_plane)

    def under(self, share: float, x: np.ndarray) -> _Problem:
        """The same under a share of the loads, from the shape x."""
        return replace(self, body=self.body.under(share), x=x, gravity=share * self.full)

    @property
    def pressing(self) -> float:
        """Norm of the forces of pressure [mN]."""
        if self.body.pressure is None:
            return 0.0
        return float(np.linalg.norm(self.free_part(self.body.residual(self.X, self.X, np.zeros(3)))))

    def drag(self, way: np.ndarray) -> np.ndarray:
        """Change of the residual when nodes move a way (n_nodes, 3) [mm], to first order -> (n_nodes, 3) [mN]."""
        step = DRAG_STEP * np.ptp(self.X, axis=0).max() / max(np.abs(way).max(), 1e-300)
        there, back = (self.body.residual(self.X, self.x + s * way, self.gravity) for s in (step, -step))
        return (there - back) / (2.0 * step)

    @cached_property
    def weight(self) -> float:
        """Norm of the nodal weights [mN/mm]: what the residual is measured against."""
        mass = self.body.lumped_mass(self.X)
        return float(np.hypot(np.linalg.norm(mass) * max(np.linalg.norm(self.full), 1.0), self.beside))

    @cached_property
    def volume_ratios(self) -> np.ndarray:
        """Volume ratios to start from: those of x, but not far from rest (n_elements, n_qp) [1]."""
        return self.body.starting_dilation(*self._ordered(self.x))

    @cached_property
    def out_of_balance(self) -> np.ndarray:
        """Residual at the start x [mN/mm]."""
        return self.free_part(self.body.residual(*self._ordered(self.x), self.gravity, self.volume_ratios))

    def positions(self, values: np.ndarray) -> np.ndarray:
        """All positions (n_nodes, 3) from the unknowns."""
        return self.supports.positions(values, self.x)

    def unknowns(self, x: np.ndarray) -> np.ndarray:
        """What is solved for, of positions x (n_nodes, 3)."""
        return self.supports.unknowns(x)

    def shapes(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unloaded and loaded positions from the unknowns."""
        return self._ordered(self.positions(values))

    def _ordered(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (unknown, self.X) if self.inverse else (self.X, unknown)

    @property
    def is_symmetric(self) -> bool:
        """Whether the tangent is: forces have a potential, and it is the loaded shape that is looked for."""
        return not self.inverse and self.body.has_potential

    def linearised(self, values: np.ndarray, J_bar: np.ndarray, damping: float = 0.0) -> _Tangent:
        """Derivatives by the unknown shape and the volume ratios."""
        shapes, in_plane = self.shapes(values), self.in_plane
        if self.inverse:
            matrix, rates = self.body.linearised_reference(*shapes, J_bar, self.gravity, in_plane=in_plane)
            pullback = Pullback.unloaded(self.body, *shapes)
        else:
            matrix, rates = self.body.linearised(*shapes, J_bar, in_plane=in_plane, damping=damping)
            pullback = Pullback.loaded(self.body, shapes[1])

        def near() -> sp.bsr_array:
            """By the loaded shape, whatever is looked for, and without pressure; the symmetric part."""
            body = replace(self.body, pressure=None)
            matrix, _ = body.linearised(*shapes, J_bar, in_plane=in_plane)
            if not body.has_potential:
                matrix = _symmetric_part(matrix)
            return self._pulled_back(matrix, Pullback.loaded(body, shapes[1]))

        return _Tangent(self._pulled_back(matrix, pullback), rates, pullback, self, None if self.is_symmetric else near)

    def _pulled_back(self, matrix: sp.bsr_array, pullback: Pullback) -> sp.bsr_array:
        return self.supports.matrix(pullback.matrix(matrix, self.body.frame.free_nodes))

    def free_part(self, forces: np.ndarray) -> np.ndarray:
        """Forces (n_nodes, 3) on the unknowns, 0 where no tissue holds the node."""
        return self.supports.unknowns(np.where(self.body.active_nodes[:, None], forces, 0.0))

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Vectors (n_nodes, 3) of what is on the unknowns, 0 along what is held."""
        return self.supports.positions(values, np.zeros_like(self.X))


class _Tangent(NamedTuple):
    """First order of a problem about a shape."""

    matrix: sp.bsr_array
    """Of the pulled-back system."""
    rates: VolumeRates
    pullback: Pullback
    problem: _Problem
    near: Callable[[], sp.bsr_array] | None
    """Makes a symmetric matrix that is near, where this one is not symmetric."""

    def solve(self, solver: LinearSolver, forces: np.ndarray, tolerance: float) -> np.ndarray:
        """Step of the unknowns that these forces on them make."""
        problem, (ways, turned) = self.problem, (self.pullback.ways, self.pullback.forces)
        rhs = problem.supports.unknowns((turned @ problem.spread(forces)[..., None])[..., 0])
        found = solver.solve(self.matrix, rhs, tolerance, self.near)
        return problem.supports.unknowns((ways @ problem.spread(found)[..., None])[..., 0])
