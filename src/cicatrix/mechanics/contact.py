"""Frictionless unilateral contact of a body with rigid plates, solved by an active-set method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from ..core.errors import ConvergenceError, InputError
from ..numerics.linear import Engine, LinearSolver
from ..numerics.newton import NewtonReport, ramp
from .body import Body
from .contact_projection import ContactProjection

FIRST_STEP, SMALLEST_STEP = 1 / 32, 1 / 2048  # first and smallest load step, as fractions of the plates' displacement
MAX_ITERATIONS = 60  # Newton iterations in one load step
# iterations in which all contacts may change at once; later one at a time, when forces balance to BALANCE_TOLERANCE
FULL_UPDATE_ITERATIONS = 10
BALANCE_TOLERANCE = 1e-6  # relative residual below which forces count as balanced
# with an initial shape: relative residual, and gap relative to body size, that count as small
NEAR_RESIDUAL, NEAR_GAP = 0.1, 1e-3
MAX_TOTAL_ITERATIONS = 1000  # Newton iterations in all steps
DIVERGENCE_FACTOR = 30.0  # growth of the residual that counts as divergence
LINEAR_TOLERANCE = 1e-5  # relative tolerance of the linear solves
PENETRATION_TOLERANCE = 1e-7  # penetration at which a node comes into contact, relative to body size
TENSION_TOLERANCE = 1e-5  # largest tension that is ignored, relative to the largest nodal contact force
ROUNDING = 1e-13  # round-off of the residual, relative to the diagonal stiffness times body size


@dataclass(frozen=True, eq=False)
class Plate:
    """A rigid half-space that is displaced during loading.

    Parameters
    ----------
    point : (3,) array [mm]
        Point on its face.
    normal : (3,) array [1]
        Unit normal of the face, towards the body.
    displacement : (3,) array [mm]
        Displacement of the plate.
    """

    point: np.ndarray
    normal: np.ndarray
    displacement: np.ndarray

    def at(self, share: float) -> Plate:
        """Return the plate at the position after a fraction ``share`` of its displacement."""
        return replace(self, point=self.point + share * np.asarray(self.displacement), displacement=np.zeros(3))

    def gap(self, x: np.ndarray) -> np.ndarray:
        """Return the signed distance (n,) [mm] of points (n, 3) [mm] from the plate's face, negative inside the plate."""
        return (x - self.point) @ self.normal


@dataclass(frozen=True, eq=False)
class ContactSolution:
    """Shape and contact forces of a body in equilibrium between plates."""

    x: np.ndarray
    """Positions (n_nodes, 3) [mm]."""
    contact_forces: np.ndarray
    """Force of each plate on each node along the plate's normal (n_plates, n_nodes) [mN]; 0 without contact."""
    report: NewtonReport


class Contact:
    """Solver for contact between plates and bodies with one discretisation; it reuses a factorised matrix from step to step.

    Each node is either in contact with a plate or not. After each Newton step, nodes under tension are released from a plate
    and nodes that penetrate it are brought into contact, until the active set no longer changes and forces balance
    (primal-dual active set, a semismooth Newton method: Hintermueller, Ito & Kunisch 2002). Contact forces act at
    nodes, so the contact pressure is resolved to the size of a face only; under a uniform pressure the corners of quadratic
    faces carry no force. Stability is not checked: a straight column stays straight above its buckling load.

    Parameters
    ----------
    relative_tolerance : float
        Bound on the residual relative to the weight and the plates' forces (Euclidean norms) [1].
    tell : callable, optional
        Called with a progress message at each iteration.
    on : Engine, optional
        Back end of the linear solver.
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
        """Number of matrices factorised so far."""
        return self._linear.n_factorizations

    def solve(
        self,
        body: Body,
        X: np.ndarray,
        gravity: np.ndarray,
        plates: Sequence[Plate],
        start: np.ndarray | None = None,
    ) -> ContactSolution:
        """Solve for equilibrium after the plates have moved by their full displacement, with gravity increased in proportion.

        Parameters
        ----------
        body : Body
            Tissue and skin, without pressure; its fixed and sliding nodes keep their constraints. Rigid motions that
            these allow must be prevented by the plates from the first step on.
        X : (n_nodes, 3) array [mm]
            Unloaded positions.
        gravity : (3,) array [mm/s^2]
            Final acceleration.
        plates : sequence of Plate
            Plates in their initial positions. No node may touch two parallel plates.
        start : (n_nodes, 3) array [mm], optional
            A shape near the solution. The full load is then applied at once, with nodes close to a plate in contact initially.

        Raises
        ------
        InputError
            If pressure acts on the body, or ranks share it.
        ConvergenceError
            If no equilibrium is found, with the history of all attempts.
        """
        if body.pressure is not None or body.discretization.ranks.size > 1:
            raise InputError("contact with plates requires a body without pressure loads, in a single process")
        report = NewtonReport(tell=self.tell)
        path = _LoadPath(self, body, X, gravity, plates, report)
        if start is None:
            return path.result(ramp(path.advance, X, report, SMALLEST_STEP, FIRST_STEP, MAX_TOTAL_ITERATIONS))
        path.in_contact = np.stack([p.at(1.0).gap(start) < NEAR_GAP * np.ptp(X, axis=0).max() for p in plates])
        return path.result(path.advance(start, 1.0, patient=True))

    def step(self, matrix: sp.bsr_array, rhs: np.ndarray) -> np.ndarray:
        """Solve one linear system; a singular matrix raises ConvergenceError: (n,) -> (n,)."""
        try:
            return self._linear.solve(matrix, rhs, LINEAR_TOLERANCE)
        except FloatingPointError as error:
            raise ConvergenceError(str(error), [f"singular tangent ({error})"]) from error


class _LoadPath:
    """Sequence of load steps from the unloaded to the compressed shape, with the nodes in contact after the last step."""

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
        self.in_contact = np.zeros((len(self.plates), len(X)), bool)
        self.contact_forces = np.zeros(self.in_contact.shape)
        self._weight = float(np.linalg.norm(body.lumped_mass(X)) * np.linalg.norm(gravity))
        self._rounding = 0.0
        self._reach = PENETRATION_TOLERANCE * float(np.ptp(X, axis=0).max())

    def result(self, x: np.ndarray) -> ContactSolution:
        """Return the solution with positions x, the last contact forces and the report."""
        return ContactSolution(x, self.contact_forces, self.report)

    def advance(self, x: np.ndarray, share: float, patient: bool = False) -> np.ndarray:
        """Solve for equilibrium at a fraction ``share`` of the load, from positions x; return positions (n_nodes, 3) [mm].

        If ``patient``, nodes enter or leave contact only once the forces nearly balance.
        """
        plates, gravity = [plate.at(share) for plate in self.plates], share * self.gravity
        in_contact = self.in_contact | self._penetrating(plates, x)
        state = _State(x, self.body.initial_volume_ratio(self.X, x))
        r, first = self.body.residual(self.X, x, gravity, state.J_bar), np.inf
        for number in range(MAX_ITERATIONS):
            projection = ContactProjection(
                self.body.discretization, np.array([p.normal for p in plates], float), in_contact
            )
            state, expected = self._newton(
                state,
                r,
                projection,
                projection.constrained_displacement([-p.gap(state.x) for p in plates], self.X - state.x),
            )
            r = self.body.residual(self.X, state.x, gravity, state.J_bar)
            forces = projection.contact_forces(r)
            norm, scale = (
                float(np.linalg.norm(projection.free_part(r))),
                float(np.hypot(self._weight, np.linalg.norm(forces))),
            )
            tolerance = self.solver.relative_tolerance * scale + self._rounding
            changes = self._changes(plates, state.x, in_contact, expected)
            changed = int(np.count_nonzero(changes))
            if number < FULL_UPDATE_ITERATIONS and not patient:
                in_contact = in_contact ^ changes
            elif patient and number < 2 * FULL_UPDATE_ITERATIONS:
                in_contact = in_contact ^ changes if norm < NEAR_RESIDUAL * scale else in_contact
            elif norm < BALANCE_TOLERANCE * scale:
                in_contact = in_contact ^ _first(changes)
            self._count(norm, changed, in_contact)
            first = max(norm, scale, tolerance) if number == 0 else first
            if not norm < DIVERGENCE_FACTOR * first:
                break
            if not changed and norm <= tolerance and self._is_tied(state):
                self._accept(state.x, in_contact, forces)
                return state.x
        line = f"no equilibrium after {number + 1} iterations, residual {norm:.1e} mN, {changed} contact changes in the last"
        raise ConvergenceError("Newton's method for contact with plates did not converge.", [line])

    def _newton(
        self, state: _State, r: np.ndarray, projection: ContactProjection, displacement: np.ndarray
    ) -> tuple[_State, np.ndarray]:
        """Take one Newton step, given the residual r (n_nodes, 3) and the ``displacement`` of constrained nodes [mm].

        Return the next state, and its contact forces to first order (n_plates, n_nodes) [mN].
        """
        body = self.body
        gap = body.volume_ratio(self.X, state.x) - state.J_bar
        matrix, rates = body.linearised(self.X, state.x, state.J_bar, in_plane=False)
        self._rounding = ROUNDING / PENETRATION_TOLERANCE * self._reach * float(np.linalg.norm(matrix.diagonal()))
        condensed_residual = r + body.volume_force(rates, gap)
        rhs = projection.on_free(condensed_residual) + matrix @ projection.on_free(displacement)
        followed = self.solver.step(projection.matrix(matrix), -projection.project(rhs))
        expected = projection.contact_forces(projection.from_free(rhs + matrix @ followed))
        du = projection.from_free(followed) + displacement
        return _State(state.x + du, state.J_bar + gap + body.volume_change(rates, du)), expected

    def _penetrating(self, plates: list[Plate], x: np.ndarray) -> np.ndarray:
        return np.stack([(p.gap(x) < -self._reach) & self.body.active_nodes for p in plates])

    def _changes(self, plates: list[Plate], x: np.ndarray, in_contact: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return where contact begins by penetration or ends by tension, after a Newton step (n_plates, n_nodes) bool."""
        return (in_contact & (forces < -TENSION_TOLERANCE * forces.max(initial=0.0))) | (
            self._penetrating(plates, x) & ~in_contact
        )

    def _is_tied(self, state: _State) -> bool:
        """True if J_bar has converged to the volume ratio of the current positions (difference below 1e-8)."""
        return bool(np.abs(self.body.volume_ratio(self.X, state.x) - state.J_bar).max() < 1e-8)

    def _count(self, norm: float, changed: int, in_contact: np.ndarray) -> None:
        self.report.count(norm)
        if self.solver.tell is not None:
            self.solver.tell(f"{np.count_nonzero(in_contact)} nodes in contact, {changed} changed")

    def _accept(self, x: np.ndarray, in_contact: np.ndarray, forces: np.ndarray) -> None:
        turned = self.body.inverted_elements(self.X, x)
        if len(turned):
            raise ConvergenceError("Elements are inverted.", [f"{len(turned)} inverted elements"])
        self.in_contact, self.contact_forces = in_contact, forces


@dataclass(frozen=True, eq=False)
class _State:
    """Positions (n_nodes, 3) [mm] and volume ratios J_bar (n_elements, n_qp) [1], separate unknowns of Newton's method."""

    x: np.ndarray
    J_bar: np.ndarray


def _first(changes: np.ndarray) -> np.ndarray:
    """Return the first of the contact changes alone (n_plates, n_nodes) bool.

    For linear bodies single changes never cycle (Murty 1974), unlike many changes at once.
    """
    out = np.zeros_like(changes)
    out.flat[np.argmax(changes)] = changes.any()
    return out
