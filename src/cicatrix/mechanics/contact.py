"""A body between rigid plates that push without friction and never pull: nodes that touch are an active set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from ..core.errors import ConvergenceError, InputError
from ..numerics.linear import Engine, LinearSolver
from ..numerics.newton import NewtonReport, ramp
from .body import Body
from .held import Held

FIRST, SMALLEST = 1 / 32, 1 / 2048  # share of the plates' way that is tried at once, and below which it is given up
MOST_ITERATIONS = 60  # of Newton's method in one such step
EAGER = 10  # iterations in which all of them do; after these the first alone does, once forces balance to BALANCED
BALANCED = 1e-6
NEAR, NEARBY = 0.1, 1e-3  # of the forces, of the body's extent: what a patient solve takes for near
MOST_IN_ALL = 1000
WILD = 30.0  # a residual that grew so much does not come back
CLOSE = 1e-5  # how exactly a linear system is solved, relative to its right-hand side
ON_PLATE = 1e-7  # of the body's extent: how near a node is to a plate that it touches
PULL = 1e-5  # of the largest force of a plate on a node: what counts as none
ROUNDING = 1e-13  # of the forces that would move nodes by the body's extent


@dataclass(frozen=True, eq=False)
class Plate:
    """A rigid half-space.

    Parameters
    ----------
    point : (3,) array [mm]
        On its face.
    normal : (3,) array [1]
        Out of it, where the body is, of length 1.
    way : (3,) array [mm]
        How far it moves.
    """

    point: np.ndarray
    normal: np.ndarray
    way: np.ndarray

    def at(self, share: float) -> Plate:
        """Where it is after a share of its way."""
        return replace(self, point=self.point + share * np.asarray(self.way), way=np.zeros(3))

    def gap(self, x: np.ndarray) -> np.ndarray:
        """Distance of points (n, 3) [mm] from its face, negative in the plate (n,) [mm]."""
        return (x - self.point) @ self.normal


@dataclass(frozen=True, eq=False)
class Pressed:
    """A body in equilibrium between plates."""

    x: np.ndarray
    """Positions (n_nodes, 3) [mm]."""
    push: np.ndarray
    """Force of each plate on each node along the plate's normal (n_plates, n_nodes) [mN]; 0 where they do not touch."""
    report: NewtonReport


class Contact:
    """Solver for bodies on one frame between plates; it keeps a factor from step to step.

    A node touches a plate or does not. What is known of this is wrong at first; after each step of Newton's method nodes
    that the plate would have to pull are released, and those that went into it are put onto it (the primal-dual active
    set, a semismooth Newton method: Hintermueller, Ito & Kunisch 2002), until nothing changes and forces balance. Its nodes
    carry what a plate and the body exert on each other, so the pressure between them is known to the size of a face;
    corners of quadratic faces carry nothing of an even pressure. Whether what is found is stable is not checked: a straight
    column stays straight beyond the load at which it would buckle.

    Parameters
    ----------
    relative_tolerance : float
        Bound on the residual over weight and forces of the plates (Euclidean norms) [1].
    tell : callable, optional
        Hears a few words on each iteration.
    on : Engine, optional
        What the linear systems are solved on.
    """

    def __init__(
        self,
        relative_tolerance: float = 1e-8,
        tell: Callable[[str], None] | None = None,
        on: Engine | None = None,
    ) -> None:
        self.relative_tolerance, self.tell = relative_tolerance, tell
        self._linear = LinearSolver(on)

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return self._linear.n_factorizations

    def pressed(
        self,
        body: Body,
        X: np.ndarray,
        gravity: np.ndarray,
        plates: Sequence[Plate],
        start: np.ndarray | None = None,
    ) -> Pressed:
        """Move plates all their way into a body, gravity growing with it.

        Parameters
        ----------
        body : Body
            Tissue and skin, without pressure; fixed and sliding nodes of its frame stay held. What is left to the plates to
            hold they must hold from the first step on.
        X : (n_nodes, 3) array [mm]
            Unloaded positions.
        gravity : (3,) array [mm/s^2]
            In the end.
        plates : sequence of Plate
            Where they are at first. No two may be parallel at one node.
        start : (n_nodes, 3) array [mm], optional
            A shape near the last one; tried at once with all loads, nodes that are nearly on a plate touching.

        Raises
        ------
        InputError
            Where pressure acts, or ranks share the body.
        ConvergenceError
            With everything that was tried.
        """
        if body.pressure is not None or body.frame.ranks.size > 1:
            raise InputError("plates press bodies in one process that bear no pressure")
        report = NewtonReport(tell=self.tell)
        way = _Way(self, body, X, gravity, plates, report)
        if start is None:
            return way.result(ramp(way.advance, X, report, SMALLEST, FIRST, MOST_IN_ALL))
        way.touching = np.stack([p.at(1.0).gap(start) < NEARBY * np.ptp(X, axis=0).max() for p in plates])
        return way.result(way.advance(start, 1.0, patient=True))

    def step(self, matrix: sp.bsr_array, rhs: np.ndarray) -> np.ndarray:
        """Solve one linear system: (n,) -> (n,)."""
        try:
            return self._linear.solve(matrix, rhs, CLOSE)
        except FloatingPointError as error:
            raise ConvergenceError(str(error), [f"singular tangent ({error})"]) from error


class _Way:
    """From the unloaded shape to the pressed one; remembers who touches."""

    def __init__(
        self,
        solver: Contact,
        body: Body,
        X: np.ndarray,
        gravity: np.ndarray,
        plates: Sequence[Plate],
        report: NewtonReport,
    ) -> None:
        self.solver, self.body, self.X, self.gravity, self.report = solver, body, X, gravity, report
        self.plates = list(plates)
        self.touching = np.zeros((len(self.plates), len(X)), bool)
        self.push = np.zeros(self.touching.shape)
        self._weight = float(np.linalg.norm(body.lumped_mass(X)) * np.linalg.norm(gravity))
        self._rounding = 0.0
        self._reach = ON_PLATE * float(np.ptp(X, axis=0).max())

    def result(self, x: np.ndarray) -> Pressed:
        """What is told of the last shape."""
        return Pressed(x, self.push, self.report)

    def advance(self, x: np.ndarray, share: float, patient: bool = False) -> np.ndarray:
        """Equilibrium after a share of the way, from a shape x before; ``patient``: nobody comes or goes far from balance."""
        plates, gravity = [plate.at(share) for plate in self.plates], share * self.gravity
        touching = self.touching | self._beyond(plates, x)
        state = _State(x, self.body.starting_dilation(self.X, x))
        r, first = self.body.residual(self.X, x, gravity, state.J_bar), np.inf
        for number in range(MOST_ITERATIONS):
            held = Held(self.body.frame, np.array([p.normal for p in plates], float), touching)
            state, expected = self._newton(
                state, r, held, held.way([-p.gap(state.x) for p in plates], self.X - state.x)
            )
            r = self.body.residual(self.X, state.x, gravity, state.J_bar)
            push = held.push(r)
            norm, scale = float(np.linalg.norm(held.free_part(r))), float(np.hypot(self._weight, np.linalg.norm(push)))
            tolerance = self.solver.relative_tolerance * scale + self._rounding
            changes = self._changes(plates, state.x, touching, expected)
            changed = int(np.count_nonzero(changes))
            if number < EAGER and not patient:
                touching = touching ^ changes
            elif patient and number < 2 * EAGER:
                touching = touching ^ changes if norm < NEAR * scale else touching
            elif norm < BALANCED * scale:
                touching = touching ^ _first(changes)
            self._count(norm, changed, touching)
            first = max(norm, scale, tolerance) if number == 0 else first
            if not norm < WILD * first:
                break
            if not changed and norm <= tolerance and self._is_tied(state):
                self._accept(state.x, touching, push)
                return state.x
        line = f"no balance after {number + 1} iterations, residual {norm:.1e} mN, {changed} nodes came or went in the last"
        raise ConvergenceError("Newton's method between plates did not converge.", [line])

    def _newton(self, state: _State, r: np.ndarray, held: Held, way: np.ndarray) -> tuple[_State, np.ndarray]:
        """One step from a state with the residual r (n_nodes, 3), held nodes going their way (n_nodes, 3) [mm].

        Returns the next state, and to first order what plates push there (n_plates, n_nodes) [mN].
        """
        body = self.body
        gap = body.dilation(self.X, state.x) - state.J_bar
        matrix, rates = body.linearised(self.X, state.x, state.J_bar, in_plane=False)
        self._rounding = ROUNDING / ON_PLATE * self._reach * float(np.linalg.norm(matrix.diagonal()))
        pull = r + body.volume_force(rates, gap)
        rhs = held.on_free(pull) + matrix @ held.on_free(way)
        followed = self.solver.step(held.matrix(matrix), -held.project(rhs))
        expected = held.push(held.from_free(rhs + matrix @ followed))
        du = held.from_free(followed) + way
        return _State(state.x + du, state.J_bar + gap + body.volume_change(rates, du)), expected

    def _beyond(self, plates: list[Plate], x: np.ndarray) -> np.ndarray:
        return np.stack([(p.gap(x) < -self._reach) & self.body.active_nodes for p in plates])

    def _changes(self, plates: list[Plate], x: np.ndarray, touching: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Who comes and goes (n_plates, n_nodes) after a step: nodes that are in a plate, and those that are pulled."""
        return (touching & (push < -PULL * push.max(initial=0.0))) | (self._beyond(plates, x) & ~touching)

    def _is_tied(self, state: _State) -> bool:
        """Whether the volume ratios are those of the shape."""
        return bool(np.abs(self.body.dilation(self.X, state.x) - state.J_bar).max() < 1e-8)

    def _count(self, norm: float, changed: int, touching: np.ndarray) -> None:
        self.report.count(norm)
        if self.solver.tell is not None:
            self.solver.tell(f"{np.count_nonzero(touching)} nodes touch, {changed} came or went")

    def _accept(self, x: np.ndarray, touching: np.ndarray, push: np.ndarray) -> None:
        turned = self.body.inside_out(self.X, x)
        if len(turned):
            raise ConvergenceError("Elements turn inside out.", [f"{len(turned)} elements inside out"])
        self.touching, self.push = touching, push


@dataclass(frozen=True, eq=False)
class _State:
    """Positions (n_nodes, 3) [mm] and volume ratios (n_elements, n_qp) [1], which are free of them until the end."""

    x: np.ndarray
    J_bar: np.ndarray


def _first(changes: np.ndarray) -> np.ndarray:
    """The first alone; in a linear body one at a time never goes in circles (Murty 1974), many at once may."""
    out = np.zeros_like(changes)
    out.flat[np.argmax(changes)] = changes.any()
    return out
