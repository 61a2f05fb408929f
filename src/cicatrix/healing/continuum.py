"""Continuum model of healing: cells, cytokine and collagen in a body that the cells contract, integrated implicitly."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from ..core.errors import ConvergenceError
from ..core.units import hours_from_seconds
from ..materials.piecewise import PiecewiseMaterial
from ..mechanics.body import Body
from ..mechanics.equilibrium import Equilibrium
from ..numerics.anderson import Anderson
from ..numerics.bdf import Formula, formula, next_step
from ..numerics.linear import LinearSolver
from .scarring import Local, Scarring, local_step, orthonormalised, tissue
from .transport import Flow, Mobility, Transport

MAX_ITERATIONS = 25  # maximum number of iterations per step; a step that needs more is shortened
REASSEMBLY_RATIO = 0.25  # ratio of successive changes above which the stiffness matrix is reassembled, once per step
CUT = 0.25  # factor by which a step without a solution is shortened
N_STORED = 3  # number of states that are stored for the second-order formula and its error estimate


class WoundState(NamedTuple):
    """State of the continuum wound model at one time."""

    x: np.ndarray
    """Positions (n_nodes, 3) [mm]."""
    fields: np.ndarray
    """Cells (relative to healthy tissue) and cytokine (relative to a maximum) at the vertex nodes (n, 2) [1]."""
    local: Local
    """Internal variables at quadrature points (n_elements, n_qp)."""


@dataclass(frozen=True, eq=False)
class IntegratorState:
    """State of the time integration: the latest states, their times, the next step size and counters.

    It is a complete checkpoint: later states depend on nothing else.
    """

    past: tuple[WoundState, ...]
    """The latest states, newest first."""
    times: tuple[float, ...]
    """Times of ``past`` [s]."""
    next_dt: float
    """Step size to try next [s]."""
    n_accepted: int = 0
    """Number of accepted steps."""
    n_rejected: int = 0
    """Number of rejected steps: those with too large an error and those without a solution."""
    iterations: int = 0
    """Number of iterations of the last step."""
    last_dt: float = 0.0
    """Length of the last step [s]."""

    @property
    def now(self) -> WoundState:
        """The latest state."""
        return self.past[0]

    @property
    def time(self) -> float:
        """Time of the latest state [s]."""
        return self.times[0]


@dataclass(frozen=True, eq=False)
class Host:
    """Wound elements and natural configurations of a body whose tissue outside the wound keeps collagen and permanent stretch.

    Parameters
    ----------
    is_new : (n_elements,) bool array
        Elements of the wound.
    natural : (n_elements, n_qp, 3, 3) array [1]
        Natural configuration F_n of new tissue; in the tissue around the wound, the deformation at which cells sense no strain.
    """

    is_new: np.ndarray
    natural: np.ndarray

    @cached_property
    def to_natural(self) -> np.ndarray:
        """Inverse F_n^-1 of the natural configuration (n_elements, n_qp, 3, 3) [1]."""
        return np.linalg.inv(self.natural)


class Tolerance(NamedTuple):
    """Tolerances of the time integration."""

    time: float = 1e-3
    """Largest accepted local error of a step, in densities and permanent stretches [1]."""
    iteration: float = 1e-5
    """Largest change in the last iteration of a step: densities [1], positions divided by the size of the body."""
    shortest: float = 1e-3
    """Smallest step size, below which the integration stops with an error [s]."""


class _NoSolutionError(Exception):
    """Raised when a step has no solution or none was found; the message says why."""


@dataclass(eq=False)
class ContinuumIntegrator:
    """Time integrator of the continuum healing model.

    Each step iterates over local states, transport and mechanics, each with the latest values of the others, until the
    changes are within the tolerance: the result is that of a step fully implicit in all of them. Anderson acceleration reduces
    the number of iterations. Steps are of second order (:mod:`..core.bdf`), or implicit Euler steps where the second-order
    formula would start from negative values.

    Parameters
    ----------
    body : Body
        Discretised body with supports, skin and density. The solver replaces its law by that of healing tissue, in the whole
        body or, with a host, in the wound, where it also multiplies the density by the collagen fraction phi.
    X : (n_nodes, 3) array [mm]
        Reference positions.
    gravity : (3,) array [mm/s^2]
        Gravitational acceleration.
    scarring : Scarring
        Local model at a point of the tissue.
    mobility : Mobility
        Diffusion and taxis coefficients of cells and cytokine.
    transport : Transport
        Finite-element space of cells and cytokine.
    tolerance : Tolerance
        Tolerances of the time integration.
    is_coupled : bool
        Whether the body moves as it heals; if not, the deformation stays that of the initial equilibrium.
    host : Host, optional
        Wound elements and natural configurations if only a part of the body heals; without it the whole body heals.
    """

    body: Body
    X: np.ndarray
    gravity: np.ndarray
    scarring: Scarring
    mobility: Mobility
    transport: Transport
    tolerance: Tolerance = field(default_factory=Tolerance)
    is_coupled: bool = True
    host: Host | None = None
    factorizations: int = 0
    _mechanics: LinearSolver = field(default_factory=LinearSolver)
    _matrix: object = None

    def start(
        self, fields: np.ndarray, local: Local, first_step: float, prescribed_positions: np.ndarray | None = None
    ) -> IntegratorState:
        """Return the initial integrator state, in equilibrium with the traction of the cells.

        ``fields`` (n, 2) [1], ``local`` and ``first_step`` [s] are the initial values. ``prescribed_positions``
        (n_nodes, 3) [mm] are those of the constrained nodes, which stay there.

        Raises
        ------
        ConvergenceError
            If no equilibrium is found.
        """
        body, x, iterations = self._tissue(local, fields), self.X, 0
        if prescribed_positions is not None or self.gravity.any() or np.any(body.law.tension):
            mechanics = Equilibrium(relative_tolerance=1e-9)
            try:
                x, report = mechanics.loaded(body, self.X, self.gravity, prescribed_positions=prescribed_positions)
            except ConvergenceError as error:
                pull = float(np.max(body.law.tension))
                raise ConvergenceError(
                    f"No equilibrium of the fresh wound was found under the traction of cells (at most {pull:.4g} kPa): {error}",
                    error.history,
                ) from error
            iterations, self.factorizations = report.iterations, mechanics.factorizations
        state = WoundState(x, fields, jax.tree.map(np.asarray, local))
        return IntegratorState((state,), (0.0,), first_step, iterations=iterations)

    def integrate(self, integration: IntegratorState, until: float) -> Iterator[IntegratorState]:
        """Integrate up to a time [s], which the last step meets exactly; yield the integrator state after every step.

        Raises
        ------
        ConvergenceError
            If the step size falls below its minimum; the state that was yielded last is valid.
        """
        while integration.time < until * (1.0 - 1e-12):
            integration = self.step(integration, until)
            yield integration

    def step(self, integration: IntegratorState, until: float) -> IntegratorState:
        """Perform one step, repeated with smaller step sizes until its error is within the tolerance."""
        left, why = until - integration.time, "its error was too large"
        h = _fitted(integration.next_dt, left)
        while True:
            if h < min(self.tolerance.shortest, left):
                raise self._failure(integration, h, why)
            try:
                state, error, used, iterations = self._tried(integration, h)
            except _NoSolutionError as found:
                why, h, integration = str(found), CUT * h, replace(integration, n_rejected=integration.n_rejected + 1)
                self._matrix = None
                continue
            proposed = next_step(h, error, used.order)
            if error <= 1.0:
                break
            why, h, integration = (
                "its error was too large",
                proposed,
                replace(integration, n_rejected=integration.n_rejected + 1),
            )
        return IntegratorState(
            (state, *integration.past)[:N_STORED],
            (integration.time + h, *integration.times)[:N_STORED],
            proposed,
            integration.n_accepted + 1,
            integration.n_rejected,
            iterations,
            h,
        )

    def reset(self) -> None:
        """Discard all matrices and factors, so that the following steps depend on the integrator state alone."""
        self._mechanics, self._matrix = LinearSolver(), None

    def _tried(self, integration: IntegratorState, h: float) -> tuple[WoundState, float, Formula, int]:
        """Try a step h [s]; return the end state, the error divided by its tolerance, the formula and the iterations."""
        ages = [integration.time - t for t in integration.times]
        used = formula(h, ages)
        start = _mixed(used.start, integration.past)
        if not self._is_sound(start):
            used = formula(h, ages, damped=True)
            start = _mixed(used.start, integration.past)
        guess = _mixed(used.guess, integration.past)
        guess = guess if self._is_sound(guess) else integration.now
        if not self.is_coupled:
            guess = guess._replace(x=integration.now.x)
        end, iterations = self._solved(start, guess, used.share * h)
        lowest = float(end.fields.min())
        if lowest < -self.tolerance.iteration:
            what = ("cells", "cytokine")[int(np.argmin(end.fields.min(axis=0)))]
            raise _NoSolutionError(f"{what} became negative, {lowest:.3g}")
        error = used.error * _distance(end, guess) / self.tolerance.time if used.error else 0.0
        return end, error, used, iterations

    def _solved(self, start: WoundState, guess: WoundState, dt: float) -> tuple[WoundState, int]:
        """Solve an implicit Euler step dt [s] by fixed-point iteration; return its end state and the number of iterations."""
        now, mixing, before, is_fresh = guess, Anderson(), np.inf, False
        for n in range(1, MAX_ITERATIONS + 1):
            image = self._turn(now, start, dt)
            one, other = self._packed(now), self._packed(image)
            change = float(np.abs(other - one).max())
            if not np.isfinite(change):
                raise _NoSolutionError("the iteration gave NaN or infinity")
            if n > 1 and change <= self.tolerance.iteration:
                return image, n
            if n > 1 and change > REASSEMBLY_RATIO * before and not is_fresh:
                self._matrix, mixing, is_fresh = None, Anderson(), True
            now, before = self._unpacked(mixing.mixed(one, other), image), change
        raise _NoSolutionError(f"{MAX_ITERATIONS} iterations did not converge")

    def _turn(self, now: WoundState, start: WoundState, dt: float) -> WoundState:
        """Perform an iteration: update local states, transport and mechanics in turn, each from the latest values."""
        F = self.body.law_gradient(self.X, now.x)
        local, signal = self._local(F, now, start.local, dt)
        try:
            fields = self._flow(F, signal, local).newton_step(now.fields, start.fields, dt)
            x = self._balanced(now.x, local, fields) if self.is_coupled else now.x
        except FloatingPointError as error:
            raise _NoSolutionError(str(error)) from error
        return WoundState(x, fields, local)

    def _packed(self, state: WoundState) -> np.ndarray:
        """Flatten the iterate (positions divided by the size of the body, then fields) for Anderson acceleration."""
        return np.concatenate([state.x.ravel() / self._size, state.fields.ravel()])

    def _unpacked(self, values: np.ndarray, like: WoundState) -> WoundState:
        x, fields = np.split(values, [like.x.size])
        like = like._replace(fields=fields.reshape(like.fields.shape))
        return like._replace(x=self._size * x.reshape(like.x.shape)) if self.is_coupled else like

    @property
    def _size(self) -> float:
        return float(np.ptp(self.X, axis=0).max())

    def _local(self, F: np.ndarray, now: WoundState, start: Local, dt: float) -> tuple[Local, np.ndarray]:
        rho, c = (self.transport.at_points(values) for values in now.fields.T)
        local, signal = local_step(self.scarring, self._from_natural(F), rho, c, start, now.local, dt)
        return self._kept(jax.tree.map(np.asarray, local), start), np.asarray(signal)

    def _from_natural(self, F: np.ndarray) -> np.ndarray:
        """Return F (n_elements, n_qp, 3, 3) relative to the natural configuration, as cells and new tissue sense it."""
        return F if self.host is None else F @ self.host.to_natural

    def _kept(self, local: Local, start: Local) -> Local:
        """Return internal variables, reset outside the wound to their values at the start of the step, except sensing states."""
        if self.host is None:
            return local
        is_new = self.host.is_new
        parts = [np.where(is_new.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(local, start)]
        return Local(*parts)._replace(signal_state=local.signal_state)

    def _flow(self, F: np.ndarray, signal: np.ndarray, local: Local) -> Flow:
        on = self.transport
        collagen = on.at_vertices(local.phi) if self.mobility.D_rho_phi else np.zeros(on.n)
        return Flow(on, self.mobility, self.scarring.turnover, F, on.at_vertices(signal), collagen)

    def _balanced(self, x: np.ndarray, local: Local, fields: np.ndarray) -> np.ndarray:
        """Return the positions after one modified Newton step, whose matrix is reused as long as the iteration converges well."""
        body = self._tissue(local, fields)
        in_plane = self.transport.space.n_axes == 2
        supports = body.discretization.supports(in_plane)
        if self._matrix is None:
            matrix, _ = body.linearised(self.X, x, body.volume_ratio(self.X, x), in_plane=in_plane)
            self._matrix = supports.matrix(matrix)
            self._mechanics.factor(self._matrix)
            self.factorizations += 1
        forces = supports.unknowns(body.residual(self.X, x, self.gravity))
        moved = self._mechanics.solve(self._matrix, -forces, 1e-3)
        return x + supports.positions(moved, np.zeros_like(x))

    def _tissue(self, local: Local, fields: np.ndarray) -> Body:
        rho, c = (self.transport.at_points(values) for values in fields.T)
        scar = tissue(self.scarring, local, rho, c)
        if self.host is None:
            return replace(self.body, law=scar)
        is_new = self.host.is_new[:, None]
        law = PiecewiseMaterial.of(self.body.law, scar, self.host.natural, np.broadcast_to(is_new, local.phi.shape))
        return replace(self.body, law=law, density=np.where(is_new, local.phi, 1.0) * self.body.density)

    def tissue(self, state: WoundState) -> Body:
        """Return the body with the constitutive law and density that belong to a state."""
        return self._tissue(state.local, state.fields)

    def signal(self, state: WoundState) -> np.ndarray:
        """Return the mechanical signal H at quadrature points (n_elements, n_qp) [1]."""
        F = self.body.law_gradient(self.X, state.x)
        return np.asarray(self.scarring.signal(self._from_natural(F), state.local))

    def _is_sound(self, state: WoundState) -> bool:
        """Whether fields, collagen and dispersion are non-negative within the iteration tolerance, and stretches positive."""
        least = -self.tolerance.iteration
        has = state.local
        return bool(
            state.fields.min() >= least
            and has.phi.min() >= least
            and has.stretch.min() > 0.0
            and has.dispersion.min() >= least
        )

    def _failure(self, integration: IntegratorState, h: float, why: str) -> ConvergenceError:
        volume = np.linalg.det(self.body.law_gradient(self.X, integration.now.x))
        element = int(volume.min(axis=1).argmin())
        place = ", ".join(f"{v:.4g}" for v in self.X[self.transport.space.corners[element]].mean(axis=0))
        return ConvergenceError(
            f"The integration of the wound stopped at {hours_from_seconds(integration.time):.6g} h: a step of {h:.3g} s was "
            f"still too long ({why}); the tissue is most compressed near ({place}) mm, "
            f"to {volume.min():.3g} of its volume or area.",
            [f"{integration.n_accepted} steps accepted, {integration.n_rejected} rejected"],
        )


def _fitted(step: float, left: float) -> float:
    """Return the step size [s], adjusted so that no very short step remains in the time ``left`` [s] until the end."""
    if step >= left:
        return left
    return 0.5 * left if step > 0.5 * left else step


def _mixed(weights: Sequence[float], past: Sequence[WoundState]) -> WoundState:
    """Return the weighted sum of states, with fibre axes made orthonormal again."""
    if len(weights) == 1:
        return past[0]
    mix = jax.tree.map(lambda *leaves: sum(w * leaf for w, leaf in zip(weights, leaves)), *past[: len(weights)])
    return mix._replace(local=jax.tree.map(np.asarray, orthonormalised(mix.local)))


def _distance(end: WoundState, guess: WoundState) -> float:
    """Return the largest difference between two states in fields, collagen, stretches, dispersion and fibre axes."""
    return max(float(np.abs(end.fields - guess.fields).max()), _local_distance(end.local, guess.local))


def _local_distance(one: Local, other: Local) -> float:
    pairs = (
        (one.phi, other.phi),
        (one.stretch, other.stretch),
        (one.dispersion, other.dispersion),
        (one.axes, other.axes),
    )
    return max(float(np.abs(a - b).max()) for a, b in pairs)


def integrator_arrays(integration: IntegratorState) -> dict[str, np.ndarray]:
    """Return the stored states of the integrator as named arrays."""
    return {
        f"{k}.{j}": leaf for k, state in enumerate(integration.past) for j, leaf in enumerate(jax.tree.leaves(state))
    }


def integrator_scalars(integration: IntegratorState) -> dict[str, Any]:
    """Return step sizes, counters and times of the integrator state as scalars that JSON can store."""
    return {
        "next_dt": integration.next_dt,
        "n_accepted": integration.n_accepted,
        "n_rejected": integration.n_rejected,
        "iterations": integration.iterations,
        "last_dt": integration.last_dt,
        **{f"time.{k}": t for k, t in enumerate(integration.times)},
    }


def integrator_from(arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> IntegratorState:
    """Return the integrator state from its stored arrays and scalars."""
    n = sum(name.startswith("time.") for name in scalars)
    leaves = 2 + len(Local._fields)
    past = []
    for k in range(n):
        x, fields, *local = (arrays[f"{k}.{j}"] for j in range(leaves))
        past.append(WoundState(x, fields, Local(*local)))
    times = tuple(scalars[f"time.{k}"] for k in range(n))
    return IntegratorState(
        tuple(past),
        times,
        *(scalars[name] for name in ("next_dt", "n_accepted", "n_rejected", "iterations", "last_dt")),
    )
