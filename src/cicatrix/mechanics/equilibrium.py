"""Forward and inverse equilibrium of a body under gravity, pressure and displacements of its supports."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..core.errors import ConvergenceError, InputError
from ..core.named import part
from ..numerics.linear import Engine, LinearSolver
from ..numerics.newton import NewtonReport, minimise, newton, ramp
from .body import Body, Discretization
from .failure import (
    MAX_UNKNOWNS,
    NEARLY_SOLVED,
    NoEquilibriumError,
    buckling_share,
    rounding,
)
from .problem import Problem, Tangent
from .self_contact import SkinContact, sites
from .unloading import LoadPath, Unloading, failure

SMALLEST_STEP = 0.25  # smallest load step, as a fraction of the load; below it, minimising the energy is cheaper
REUSE_BELOW = 0.05  # under gravity alone, reuse the tangent if the last step reduced the residual below this fraction
MAX_FORCING = 1e-2  # largest relative tolerance of a linear solve in Newton's method
LINEAR_TOLERANCE = 1e-6  # relative tolerance of all other linear solves
ZERO_DISPLACEMENT = 1e-13  # displacements below this, relative to body size, are round-off
RIGID_MOTION_WEIGHT = 1e-6  # weight in the load scale of the forces that move the supports alone, for rigid motions
SADDLE_PERTURBATION = 1e-4  # perturbation at a saddle point, relative to body size
BEFORE_BUCKLING = 0.8  # where a shape is kept, on the way from the last one to the load at which the body buckles
MAX_SADDLES = 6  # largest number of saddle points that a minimisation may leave


class Equilibrium:
    """Equilibrium solver for bodies that share one discretisation.

    Factorised matrices are reused in later solves; this changes results only within the tolerance.

    Parameters
    ----------
    relative_tolerance : float
        Bound on the residual relative to the weight of the body (Euclidean norms) [1].
    tell : callable, optional
        Function called with a progress message at each iteration.
    on : Engine, optional
        Back end of the linear solver; by default that of :func:`.linear.engine`. Bodies shared by ranks need one that
        sums over these ranks.
    """

    def __init__(
        self,
        relative_tolerance: float = 1e-8,
        tell: Callable[[str], None] | None = None,
        on: Engine | None = None,
    ) -> None:
        self.relative_tolerance, self.tell, self._on = relative_tolerance, tell, on
        self._linear: dict[bool, LinearSolver] = {}  # keyed by ``in_plane``
        self._gone = np.zeros(2, int)  # factorisations and Krylov iterations of discarded solvers

    @property
    def factorizations(self) -> int:
        """Number of matrices factorised so far."""
        return int(self._gone[0]) + sum(solver.n_factorizations for solver in self._linear.values())

    @property
    def krylov_steps(self) -> int:
        """Number of Krylov iterations so far."""
        return int(self._gone[1]) + sum(solver.n_steps for solver in self._linear.values())

    def reset(self) -> None:
        """Discard all factorised matrices, so that the next solve depends only on its arguments."""
        for solver in self._linear.values():
            self._retire(solver)
        self._linear.clear()

    def _retire(self, solver: LinearSolver) -> None:
        self._gone += solver.n_factorizations, solver.n_steps
        solver.reset()

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return a checkpoint for ``restore``: the matrix factors, since these influence the next solve."""
        return {
            f"{int(in_plane)}.{name}": array
            for in_plane, solver in self._linear.items()
            for name, array in solver.state_arrays().items()
        }

    def restore(self, discretization: Discretization, arrays: Mapping[str, np.ndarray]) -> None:
        """Replace all factors by those saved with ``state_arrays``, so that later solves are bitwise identical."""
        self.reset()
        for in_plane in (False, True):
            if stored := part(str(int(in_plane)), arrays):
                self._linear[in_plane] = LinearSolver(self._on)
                self._linear[in_plane].restore(discretization.empty_matrix(in_plane), stored)

    def loaded(
        self,
        body: Body,
        X: np.ndarray,
        gravity: np.ndarray,
        start: np.ndarray | None = None,
        prescribed_positions: np.ndarray | None = None,
    ) -> tuple[np.ndarray, NewtonReport]:
        """Solve for the loaded shape of a body whose unloaded shape is known.

        Parameters
        ----------
        body : Body
            Tissue, skin, supports and pressure.
        X : (n_nodes, 3) array [mm]
            Unloaded positions.
        gravity : (3,) array [mm/s^2]
            Acceleration in the section's axes.
        start : (n_nodes, 3) array [mm], optional
            A nearby equilibrium. Initial guesses are then, in order: this shape, the unloaded shape, and this shape again with
            its residual ramped to zero. Without it the loads are ramped up from the unloaded shape. If Newton's method fails
            even in small steps (as for a slender breast that buckles), the potential energy is minimised from the last shape
            reached, provided that the forces have a potential.
        prescribed_positions : (n_nodes, 3) array [mm], optional
            Prescribed final positions of constrained nodes (fixed ones, and sliding ones along their directions), reached
            in proportion to the load. By default these nodes stay as in ``start`` (or X).

        Returns
        -------
        (n_nodes, 3) array [mm], NewtonReport
            Loaded positions, with nodes without tissue as in ``start`` (or X), and the record of the solve.

        Raises
        ------
        NoEquilibriumError
            If no equilibrium is found: the likely cause, the history of all attempts, and the last stable shape.
        """
        if body.contact is None:
            return self._loaded(body, X, gravity, start, prescribed_positions)
        return self._touching(body, body.contact, X, gravity, start, prescribed_positions)

    def _touching(
        self,
        body: Body,
        contact: SkinContact,
        X: np.ndarray,
        gravity: np.ndarray,
        start: np.ndarray | None,
        prescribed_positions: np.ndarray | None,
    ) -> tuple[np.ndarray, NewtonReport]:
        """Solve as ``loaded`` does, first without contact, and again with it where skin comes near skin.

        The second solve has factors of its own, which are discarded, so that solves without touching skin are the same
        with and without contact. A nearby shape in which skin touches is used with contact at once; one in which it crosses
        is replaced by the shape of the mesh, where it does not.
        """
        if body.discretization.ranks.size > 1:
            raise InputError(
                "Contact of skin with skin requires a single process; run without mpirun, or switch it off."
            )
        report, near = NewtonReport(tell=self.tell), X if start is None else start
        if not contact.is_touching(near):
            try:
                x, report = self._loaded(replace(body, contact=None), X, gravity, start, prescribed_positions)
                if not contact.is_touching(x) and contact.largest_step(near, x) == 1.0:
                    return x, report
                report.history.append("without contact, skin comes near or crosses skin: solved again with contact")
            except ConvergenceError as error:
                report.history += [*error.history, "without contact there is no equilibrium: solved with contact"]
        if len(contact.crossings(near)):
            start = body.discretization.space.positions
        within = Equilibrium(self.relative_tolerance, self.tell, self._on)
        try:
            x, again = within._loaded(body, X, gravity, start, prescribed_positions)
        except NoEquilibriumError as error:
            error.history[:0] = report.history
            raise
        finally:
            within.reset()
            self._gone += within._gone
        touching = contact.touching(x)
        report.append(again, f"skin touches skin {sites(touching)}" if len(touching) else "skin does not touch skin")
        return x, report

    def _loaded(
        self,
        body: Body,
        X: np.ndarray,
        gravity: np.ndarray,
        start: np.ndarray | None,
        prescribed_positions: np.ndarray | None,
    ) -> tuple[np.ndarray, NewtonReport]:
        """Solve as ``loaded`` does for a body with the contact that it has from the start."""
        report = NewtonReport(tell=self.tell)
        at_rest = X if start is None else np.where(body.active_nodes[:, None], X, start)
        problem = Problem(body, X, at_rest, gravity, gravity)
        problem = replace(
            problem,
            other_loads_norm=np.hypot(problem.pressure_load_norm, self._reaction(problem, prescribed_positions)),
        )
        by_load = LoadPath(
            problem.x,
            lambda x, load: self._newton(
                self._predicted(problem.with_load_share(load, x), load, prescribed_positions), report
            ),
        )
        if problem.other_loads_norm == 0.0 and not gravity.any():
            problem = replace(problem, other_loads_norm=body.inner_force(X, problem.x))
        is_gradual = prescribed_positions is not None or body.pressure is not None
        paths = [("the unloaded shape", by_load, {"smallest": SMALLEST_STEP / 16 if is_gradual else SMALLEST_STEP})]
        if start is not None:
            nearby = self._homotopy(self._predicted(replace(problem, x=start), 1.0, prescribed_positions), report)
            paths = [
                ("the nearby shape", nearby, {"smallest": 1.0}),
                ("the unloaded shape", by_load, {"smallest": 1.0}),
                ("the nearby shape", nearby, {"first": 0.5, "smallest": SMALLEST_STEP}),
            ]
        failure, last_lines = None, []
        for number, (name, path, steps) in enumerate(paths):
            if number:
                report.history.append(f"from {name}")
            try:
                return ramp(path.advance, path.reached, report, **steps), report
            except ConvergenceError as error:
                failure = error
        if body.has_potential:
            report.history.append("minimising the potential energy from there")
            try:
                last = self._predicted(replace(problem, x=paths[-1][1].reached), 1.0, prescribed_positions)
                return self._minimise(last, report), report
            except ConvergenceError as error:
                failure, last_lines = error, error.history
        if (found := self._in_smaller_steps(problem, by_load, report)) is not None:
            return found, report
        raise self._no_equilibrium(problem, by_load, report, last_lines) from failure

    def _in_smaller_steps(self, problem: Problem, by_load: LoadPath, report: NewtonReport) -> np.ndarray | None:
        """Go on along the path in smaller steps; return the shape at its end (n_nodes, 3) [mm], or None if that fails."""
        if problem.supports.n_unknowns > MAX_UNKNOWNS:
            return None
        again = NewtonReport(tell=self.tell)
        with contextlib.suppress(ConvergenceError):
            x = ramp(by_load.advance, by_load.reached, again, start=by_load.share, smallest=SMALLEST_STEP / 16)
            report.append(again, "from the last shape under a part of the load, in smaller steps")
            return x
        return None

    def _no_equilibrium(
        self, problem: Problem, by_load: LoadPath, report: NewtonReport, last_lines: list[str]
    ) -> NoEquilibriumError:
        """Return the error for a body without equilibrium under the whole load, with its cause and its last stable shape."""
        critical = None
        if problem.supports.n_unknowns <= MAX_UNKNOWNS:
            critical = buckling_share(problem, by_load.reached, by_load.share)
        if critical is not None:
            with contextlib.suppress(ConvergenceError):
                nearer = by_load.share + BEFORE_BUCKLING * (min(critical, 1.0) - by_load.share)
                by_load.advance(by_load.reached, nearer)
        failed = failure(problem, by_load, critical, report.history + last_lines)
        residual = min(report.norms, default=np.inf) / problem.weight if problem.weight else np.inf
        if by_load.share == 0.0 and self.relative_tolerance < residual < NEARLY_SOLVED:
            return NoEquilibriumError(*rounding(residual), failed.history, by_load.reached, 0.0)
        return failed

    def _predicted(self, problem: Problem, share: float, prescribed_positions: np.ndarray | None) -> Problem:
        """Return the problem with a better initial guess for a fraction ``share`` of the prescribed displacement.

        Constrained nodes are moved to their prescribed positions, and all others by the linearised response.
        """
        if prescribed_positions is None:
            return problem
        displacement = problem.supports.constrained_part(
            problem.X + share * (prescribed_positions - problem.X) - problem.x
        )
        if np.abs(displacement).max() <= ZERO_DISPLACEMENT * np.ptp(problem.X, axis=0).max():
            return problem
        J_bar = problem.body.volume_ratio(problem.X, problem.x)
        start = problem.unknowns(problem.x)
        tangent = problem.linearised(start, J_bar)
        followed = tangent.solve(
            self._solver(problem), -problem.free_part(problem.directional_derivative(displacement)), LINEAR_TOLERANCE
        )
        return replace(problem, x=problem.positions(start + followed) + displacement)

    def _reaction(self, problem: Problem, prescribed_positions: np.ndarray | None) -> float:
        """Return the norm of the support forces for the full displacement of constrained nodes, to first order [mN]."""
        if prescribed_positions is None:
            return 0.0
        displacement = problem.supports.constrained_part(prescribed_positions - problem.x)
        followed = self._predicted(problem, 1.0, prescribed_positions).x - problem.x
        norms = [float(np.linalg.norm(problem.directional_derivative(moved))) for moved in (followed, displacement)]
        return norms[0] + RIGID_MOTION_WEIGHT * norms[1]

    def _homotopy(self, problem: Problem, report: NewtonReport) -> LoadPath:
        """Return the path that starts at the initial guess of the problem and along which the residual is reduced to zero."""

        def advance(x: np.ndarray, share: float) -> np.ndarray:
            residual_offset = (1.0 - share) * problem.out_of_balance if share < 1.0 else 0.0
            return self._newton(replace(problem, x=x, residual_offset=residual_offset), report)

        return LoadPath(problem.x, advance)

    def unloaded(
        self, body: Body, x: np.ndarray, gravity: np.ndarray, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, NewtonReport]:
        """Solve for the unloaded shape of a body whose loaded shape is known.

        The discrete equilibrium equations are those of ``loaded``, solved for the reference positions (inverse
        deformation, Govindjee & Mihalic 1996). Loading the result again therefore reproduces the known shape to the
        solver's tolerance, if that shape is a stable equilibrium; ``is_stable`` of the report states this (without pressure).

        Parameters
        ----------
        body, gravity
            As for ``loaded``.
        x : (n_nodes, 3) array [mm]
            Loaded positions, as imaged.
        start : (n_nodes, 3) array [mm], optional
            Unloaded positions of a similar body, such as another draw of the tissue. The ways to the solution are those of
            :mod:`.unloading`.

        Raises
        ------
        NoEquilibriumError
            As for ``loaded``; its shape is an unloaded one.
        """
        report = NewtonReport(tell=self.tell)
        X = Unloading(body, x, gravity, self._newton, report).solve(start)
        problem = Problem(body, X, x, gravity, gravity)
        if problem.is_symmetric:
            tangent = problem.linearised(problem.unknowns(x), body.volume_ratio(X, x))
            report.is_stable = self._solver(problem).is_definite(tangent.matrix)
        if not report.is_stable:
            report.history.append("the known shape is not a stable equilibrium: loading again gives another shape")
        return X, report

    def _newton(self, problem: Problem, report: NewtonReport) -> np.ndarray:
        """Solve by Newton's method for positions and volume ratios J_bar; return the positions (n_nodes, 3) [mm].

        The volume ratios are eliminated element by element. With contact, no step lets skin cross skin.

        Because they are independent unknowns, the pressure in a trial shape stays small, and large steps converge even for
        nearly incompressible tissue.
        """
        body, n = problem.body, problem.supports.n_unknowns
        _check_crossings(problem)
        shape = (body.discretization.space.n_elements, body.discretization.space.table.weight.size)
        scale = problem.weight / np.sqrt(body.discretization.total(np.prod(shape)))

        def residual(z: np.ndarray) -> np.ndarray:
            shapes, J_bar = problem.shapes(z[:n]), z[n:].reshape(shape)
            r = problem.free_part(body.residual(*shapes, problem.gravity, J_bar)) - problem.residual_offset
            return np.concatenate([r, scale * (body.volume_ratio(*shapes) - J_bar).ravel()])

        solver, tolerance = self._solver(problem), self.relative_tolerance * problem.weight
        below = REUSE_BELOW if problem.other_loads_norm == 0.0 else 0.0

        def norm(r: np.ndarray) -> float:
            return body.discretization.norm(r[:n], r[n:])

        def linearised(z: np.ndarray) -> Tangent:
            return problem.linearised(z[:n], z[n:].reshape(shape))

        frozen = _FrozenTangent(linearised, below, tolerance, norm)

        def step(z: np.ndarray, r: np.ndarray) -> np.ndarray:
            tangent, forcing = frozen.at(z, r)
            rates, gap = tangent.rates, r[n:].reshape(shape) / scale
            du = tangent.solve(solver, -(r[:n] + problem.free_part(body.volume_force(rates, gap))), forcing)
            dJ = body.volume_change(rates, problem.positions(z[:n] + du) - problem.positions(z[:n])) + gap
            return _free_share(problem, z[:n], du) * np.concatenate([du, dJ.ravel()])

        z = np.concatenate([problem.unknowns(problem.x), problem.volume_ratios.ravel()])
        z = newton(residual, step, z, tolerance=tolerance, report=report, norm=norm)
        if frozen.value is not None and problem.is_symmetric and not solver.is_definite(linearised(z).matrix):
            raise ConvergenceError("Newton's method found an unstable equilibrium.", ["found an unstable equilibrium"])
        _check_elements(body, *problem.shapes(z[:n]))
        return problem.positions(z[:n])

    def _minimise(self, problem: Problem, report: NewtonReport) -> np.ndarray:
        """Minimise the potential energy, with random perturbations at saddle points; return positions (n_nodes, 3) [mm]."""
        body, solver = problem.body, LinearSolver(self._on)

        def energy(values: np.ndarray) -> float:
            return body.potential(problem.X, problem.positions(values), problem.gravity)

        def residual(values: np.ndarray) -> np.ndarray:
            return problem.free_part(body.residual(problem.X, problem.positions(values), problem.gravity))

        def step(values: np.ndarray, r: np.ndarray, damping: float) -> np.ndarray:
            x = problem.positions(values)
            damping *= max(np.linalg.norm(problem.gravity), 1.0)  # pyright: ignore[reportAssignmentType]
            tangent = problem.linearised(values, body.volume_ratio(problem.X, x), damping)
            du = tangent.solve(solver, -r, LINEAR_TOLERANCE)
            return _free_share(problem, values, du) * du

        values, tolerance = problem.unknowns(problem.x), self.relative_tolerance * problem.weight
        perturbation = np.random.Generator(np.random.Philox(0)).standard_normal(values.size)
        perturbation *= SADDLE_PERTURBATION * np.ptp(problem.X, axis=0).max()
        try:
            for _ in range(MAX_SADDLES):
                values = minimise(energy, residual, step, values, tolerance=tolerance, report=report)
                matrix = problem.linearised(values, body.volume_ratio(problem.X, problem.positions(values))).matrix
                if solver.is_definite(matrix):
                    break
                report.history.append("reached an unstable equilibrium (saddle point); continuing beside it")
                values = values + perturbation
            else:
                raise ConvergenceError("No stable equilibrium was found.", ["all minimisations ended at saddle points"])
        finally:
            self._retire(solver)
        _check_elements(body, *problem.shapes(values))
        return problem.positions(values)

    def _solver(self, problem: Problem) -> LinearSolver:
        if problem.in_plane not in self._linear:
            self._linear[problem.in_plane] = LinearSolver(self._on)
        return self._linear[problem.in_plane]


def _free_share(problem: Problem, values: np.ndarray, du: np.ndarray) -> float:
    """Return the share of a step du of the unknowns after which skin does not cross skin, in (0, 1]."""
    if problem.inverse or (contact := problem.body.contact) is None:
        return 1.0
    return contact.largest_step(problem.positions(values), problem.positions(values + du))


def _check_crossings(problem: Problem) -> None:
    """Raise ConvergenceError if a solve with contact would start from a shape in which skin crosses skin."""
    contact = None if problem.inverse else problem.body.contact
    if contact is not None and len(found := contact.crossings(problem.x)):
        words = f"skin crosses skin {sites(found)} in the shape to start from"
        raise ConvergenceError(f"{words[0].upper()}{words[1:]}.", [words])


def _check_elements(body: Body, X: np.ndarray, x: np.ndarray) -> None:
    """Raise ConvergenceError for an equilibrium with inverted elements."""
    turned = body.inverted_elements(X, x)
    if len(turned):
        where = "({}) mm".format(", ".join(f"{value:.1f}" for value in turned[0]))
        raise ConvergenceError(
            f"{len(turned)} elements are inverted, the first at {where}: the load there is more than the tissue can carry.",
            [f"{len(turned)} inverted elements, the first at {where}"],
        )


class _FrozenTangent:
    """Tangent of Newton's method that is recomputed only if it no longer reduces the residual fast enough.

    Parameters
    ----------
    linearise : callable
        Function that computes the tangent at given unknowns.
    below : float
        Factor by which a step must reduce the residual for the tangent to be reused; 0: compute it in every step.
    tolerance : float
        Bound on the norm of the residual at which the iteration ends.
    norm : callable
        Function that returns the norm of a residual.
    """

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
        """Return the tangent for the next step from the unknowns z, and the forcing term (tolerance) of its linear solve.

        r is the residual at z. For a new tangent the forcing term is that of Eisenstat & Walker (1996, choice 2). A reused
        tangent reduces the residual only by a constant factor, however accurately the system is solved.
        """
        norm = self._length(r)
        progress = norm / self._norm if np.isfinite(self._norm) else 1.0
        exactly = 0.9 * progress**2
        if self.value is None or not norm < self._below * self._norm:
            self.value = None
            self.value = self._linearise(z)
        else:
            exactly = 0.5 * progress  # since it was computed, the tangent has changed by about 2 * progress
        forcing = np.clip(exactly, 0.1 * self._tolerance / norm, MAX_FORCING)
        self._norm = norm
        return self.value, float(forcing)
