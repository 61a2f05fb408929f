"""Healing by fields: cells, cytokine and collagen on a body that they pull at, one implicit step after another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from ..core.errors import ConvergenceError
from ..core.units import hours_from_seconds
from ..materials.patched import Patched
from ..mechanics.body import Body
from ..mechanics.equilibrium import Equilibrium
from ..numerics.anderson import Anderson
from ..numerics.bdf import Formula, formula, next_step
from ..numerics.linear import LinearSolver
from .scarring import Local, Scarring, advanced, tidied, tissue
from .transport import Flow, Mobility, Transport

MOST_ITERATIONS = 25  # of a step; one that is not done then is cut
POOR = 0.25  # of the change before: where iterations bring less, the matrix is made anew, once a step
CUT = 0.25  # of a step that finds no solution
KEPT = 3  # states that a step may look back to


class WoundState(NamedTuple):
    """Where a wound stands."""

    x: np.ndarray
    """Positions (n_nodes, 3) [mm]."""
    fields: np.ndarray
    """Cells and cytokine at the carriers (n, 2) [1], over those of healthy tissue and a largest amount."""
    local: Local
    """At quadrature points (n_elements, n_qp)."""


@dataclass(frozen=True, eq=False)
class Course:
    """A wound at an instant, and what the next step looks back to.

    A checkpoint is this: the states that follow depend on nothing else.
    """

    past: tuple[WoundState, ...]
    """States, the latest first."""
    times: tuple[float, ...]
    """Theirs [s]."""
    step: float
    """To try next [s]."""
    taken: int = 0
    """Steps."""
    rejected: int = 0
    """Steps that were too long for their error, or had no solution."""
    iterations: int = 0
    """Of the last step."""
    last: float = 0.0
    """Length of the last step [s]."""

    @property
    def now(self) -> WoundState:
        """The latest state."""
        return self.past[0]

    @property
    def time(self) -> float:
        """Of the latest state [s]."""
        return self.times[0]


@dataclass(frozen=True, eq=False)
class Host:
    """The tissue about a wound, which neither yields nor makes collagen, and where new tissue is free of stress.

    Parameters
    ----------
    is_new : (n_elements,) bool array
        Elements of the wound.
    natural : (n_elements, n_qp, 3, 3) array [1]
        Natural configuration F_n of new tissue; in the old tissue that in which its cells feel nothing.
    """

    is_new: np.ndarray
    natural: np.ndarray

    @cached_property
    def to_natural(self) -> np.ndarray:
        """F_n^-1 (n_elements, n_qp, 3, 3) [1]."""
        return np.linalg.inv(self.natural)


class Tolerance(NamedTuple):
    """How exactly a wound is followed."""

    time: float = 1e-3
    """Largest local error of a step, in densities and permanent stretches [1]."""
    iteration: float = 1e-5
    """Largest change in the last iteration of a step: densities [1], positions over the size of the body."""
    shortest: float = 1e-3
    """Step below which it gives up [s]."""


class _NoSolutionError(Exception):
    """A step has none, or it was not found; the text says why."""


@dataclass(eq=False)
class Wound:
    """Solver of healing by fields.

    In each step mechanics, local states and transport take turns, each at the others' latest values, until nothing changes: the
    solution is that of the step fully implicit in all of them; Anderson's mixing shortens the way. Steps are of second order
    (:mod:`..core.bdf`), plain implicit Euler where else something would become negative.

    Parameters
    ----------
    body : Body
        Space, supports, skin, density; its law is put in its place, about the old tissue if there is a host. Of new tissue the
        share that is collagen weighs.
    X : (n_nodes, 3) array [mm]
        Reference positions.
    gravity : (3,) array [mm/s^2]
        That acts on it.
    scarring : Scarring
        What happens at a point.
    mobility : Mobility
        How cells and cytokine move.
    transport : Transport
        Where they are.
    tolerance : Tolerance
        How exactly.
    is_coupled : bool
        Whether the body moves; if not, strain is that of the first equilibrium for good.
    host : Host, optional
        The tissue about the wound; without it the whole body heals.
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

    def start(self, fields: np.ndarray, local: Local, first_step: float, held_at: np.ndarray | None = None) -> Course:
        """The wound in equilibrium with what its cells pull: fields (n, 2), local states and a first step [s].

        Held nodes go to where ``held_at`` (n_nodes, 3) [mm] has them, and stay there.

        Raises
        ------
        ConvergenceError
            Where it finds no equilibrium.
        """
        body, x, iterations = self._tissue(local, fields), self.X, 0
        if held_at is not None or self.gravity.any() or np.any(body.law.tension):
            mechanics = Equilibrium(relative_tolerance=1e-9)
            try:
                x, report = mechanics.loaded(body, self.X, self.gravity, held_at=held_at)
            except ConvergenceError as error:
                pull = float(np.max(body.law.tension))
                raise ConvergenceError(
                    f"The fresh wound finds no equilibrium under what its cells pull with, {pull:.4g} kPa at most: {error}",
                    error.history,
                ) from error
            iterations, self.factorizations = report.iterations, mechanics.factorizations
        state = WoundState(x, fields, jax.tree.map(np.asarray, local))
        return Course((state,), (0.0,), first_step, iterations=iterations)

    def follow(self, course: Course, until: float) -> Iterator[Course]:
        """Go on to a time [s], which the last step meets; yields after every step.

        Raises
        ------
        ConvergenceError
            Where steps become too short; what was yielded last is good.
        """
        while course.time < until * (1.0 - 1e-12):
            course = self.step(course, until)
            yield course

    def step(self, course: Course, until: float) -> Course:
        """One step, as long as its error allows."""
        left, why = until - course.time, "its error was too large"
        h = _fitted(course.step, left)
        while True:
            if h < min(self.tolerance.shortest, left):
                raise self._failure(course, h, why)
            try:
                state, error, used, iterations = self._tried(course, h)
            except _NoSolutionError as found:
                why, h, course = str(found), CUT * h, replace(course, rejected=course.rejected + 1)
                self._matrix = None
                continue
            proposed = next_step(h, error, used.order)
            if error <= 1.0:
                break
            why, h, course = "its error was too large", proposed, replace(course, rejected=course.rejected + 1)
        return Course(
            (state, *course.past)[:KEPT],
            (course.time + h, *course.times)[:KEPT],
            proposed,
            course.taken + 1,
            course.rejected,
            iterations,
            h,
        )

    def forget(self) -> None:
        """Let all matrices go: what follows depends on the course alone."""
        self._mechanics, self._matrix = LinearSolver(), None

    def _tried(self, course: Course, h: float) -> tuple[WoundState, float, Formula, int]:
        """A step of length h: its end, its local error over the tolerance, and the formula that it took."""
        ages = [course.time - t for t in course.times]
        used = formula(h, ages)
        start = _mixed(used.start, course.past)
        if not self._is_sound(start):
            used = formula(h, ages, damped=True)
            start = _mixed(used.start, course.past)
        guess = _mixed(used.guess, course.past)
        guess = guess if self._is_sound(guess) else course.now
        if not self.is_coupled:
            guess = guess._replace(x=course.now.x)
        end, iterations = self._solved(start, guess, used.share * h)
        lowest = float(end.fields.min())
        if lowest < -self.tolerance.iteration:
            what = ("cells", "cytokine")[int(np.argmin(end.fields.min(axis=0)))]
            raise _NoSolutionError(f"{what} fell below 0, to {lowest:.3g}")
        error = used.error * _distance(end, guess) / self.tolerance.time if used.error else 0.0
        return end, error, used, iterations

    def _solved(self, start: WoundState, guess: WoundState, dt: float) -> tuple[WoundState, int]:
        """Implicit Euler step dt [s]: local states, transport and mechanics in turn until nothing changes."""
        now, mixing, before, is_fresh = guess, Anderson(), np.inf, False
        for n in range(1, MOST_ITERATIONS + 1):
            image = self._turn(now, start, dt)
            one, other = self._packed(now), self._packed(image)
            change = float(np.abs(other - one).max())
            if not np.isfinite(change):
                raise _NoSolutionError("it led to what is no number")
            if n > 1 and change <= self.tolerance.iteration:
                return image, n
            if n > 1 and change > POOR * before and not is_fresh:
                self._matrix, mixing, is_fresh = None, Anderson(), True
            now, before = self._unpacked(mixing.mixed(one, other), image), change
        raise _NoSolutionError(f"{MOST_ITERATIONS} iterations did not settle it")

    def _turn(self, now: WoundState, start: WoundState, dt: float) -> WoundState:
        """Each part solved once at the others' latest values."""
        F = self.body.law_gradient(self.X, now.x)
        local, signal = self._local(F, now, start.local, dt)
        try:
            fields = self._flow(F, signal, local).improved(now.fields, start.fields, dt)
            x = self._balanced(now.x, local, fields) if self.is_coupled else now.x
        except FloatingPointError as error:
            raise _NoSolutionError(str(error)) from error
        return WoundState(x, fields, local)

    def _packed(self, state: WoundState) -> np.ndarray:
        """What the turns go on from, one vector: positions over the size of the body, and fields."""
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
        local, signal = advanced(self.scarring, self._felt(F), rho, c, start, now.local, dt)
        return self._kept(jax.tree.map(np.asarray, local), start), np.asarray(signal)

    def _felt(self, F: np.ndarray) -> np.ndarray:
        """What cells and new tissue feel of a deformation (n_elements, n_qp, 3, 3)."""
        return F if self.host is None else F @ self.host.to_natural

    def _kept(self, local: Local, start: Local) -> Local:
        """Old tissue as it was; what its cells sense is new."""
        if self.host is None:
            return local
        is_new = self.host.is_new
        parts = [np.where(is_new.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in zip(local, start)]
        return Local(*parts)._replace(sensed=local.sensed)

    def _flow(self, F: np.ndarray, signal: np.ndarray, local: Local) -> Flow:
        on = self.transport
        collagen = on.at_carriers(local.phi) if self.mobility.D_rho_phi else np.zeros(on.n)
        return Flow(on, self.mobility, self.scarring.turnover, F, on.at_carriers(signal), collagen)

    def _balanced(self, x: np.ndarray, local: Local, fields: np.ndarray) -> np.ndarray:
        """Positions after one step towards equilibrium, by a matrix that is kept as long as it serves."""
        body = self._tissue(local, fields)
        in_plane = self.transport.space.n_axes == 2
        supports = body.frame.supports(in_plane)
        if self._matrix is None:
            matrix, _ = body.linearised(self.X, x, body.dilation(self.X, x), in_plane=in_plane)
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
        law = Patched.of(self.body.law, scar, self.host.natural, np.broadcast_to(is_new, local.phi.shape))
        return replace(self.body, law=law, density=np.where(is_new, local.phi, 1.0) * self.body.density)

    def tissue(self, state: WoundState) -> Body:
        """The body as it is."""
        return self._tissue(state.local, state.fields)

    def signal(self, state: WoundState) -> np.ndarray:
        """H at quadrature points (n_elements, n_qp) [1]."""
        F = self.body.law_gradient(self.X, state.x)
        return np.asarray(self.scarring.signal(self._felt(F), state.local))

    def _is_sound(self, state: WoundState) -> bool:
        """Whether nothing is negative that must not be, beyond what iterations leave open."""
        least = -self.tolerance.iteration
        has = state.local
        return bool(
            state.fields.min() >= least
            and has.phi.min() >= least
            and has.stretch.min() > 0.0
            and has.spread.min() >= least
        )

    def _failure(self, course: Course, h: float, why: str) -> ConvergenceError:
        volume = np.linalg.det(self.body.law_gradient(self.X, course.now.x))
        element = int(volume.min(axis=1).argmin())
        place = ", ".join(f"{v:.4g}" for v in self.X[self.transport.space.corners[element]].mean(axis=0))
        return ConvergenceError(
            f"The wound could not be followed beyond {hours_from_seconds(course.time):.6g} h: a step of {h:.3g} s was still too "
            f"long, for {why}; tissue is most compressed about ({place}) mm, to {volume.min():.3g} of its volume or area.",
            [f"{course.taken} steps done, {course.rejected} cut"],
        )


def _fitted(step: float, left: float) -> float:
    """A step that does not leave a sliver before the end."""
    if step >= left:
        return left
    return 0.5 * left if step > 0.5 * left else step


def _mixed(weights: Sequence[float], past: Sequence[WoundState]) -> WoundState:
    """Weighted sum of states."""
    if len(weights) == 1:
        return past[0]
    mix = jax.tree.map(lambda *leaves: sum(w * leaf for w, leaf in zip(weights, leaves)), *past[: len(weights)])
    return mix._replace(local=jax.tree.map(np.asarray, tidied(mix.local)))


def _distance(end: WoundState, guess: WoundState) -> float:
    """Largest difference of what has a rate."""
    return max(float(np.abs(end.fields - guess.fields).max()), _local_distance(end.local, guess.local))


def _local_distance(one: Local, other: Local) -> float:
    pairs = ((one.phi, other.phi), (one.stretch, other.stretch), (one.spread, other.spread), (one.axes, other.axes))
    return max(float(np.abs(a - b).max()) for a, b in pairs)


def course_arrays(course: Course) -> dict[str, np.ndarray]:
    """States that the next step looks back to."""
    return {f"{k}.{j}": leaf for k, state in enumerate(course.past) for j, leaf in enumerate(jax.tree.leaves(state))}


def course_scalars(course: Course) -> dict[str, Any]:
    """Its clock."""
    return {
        "step": course.step,
        "taken": course.taken,
        "rejected": course.rejected,
        "iterations": course.iterations,
        "last": course.last,
        **{f"time.{k}": t for k, t in enumerate(course.times)},
    }


def course_from(arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> Course:
    """The course that they are of."""
    n = sum(name.startswith("time.") for name in scalars)
    leaves = 2 + len(Local._fields)
    past = []
    for k in range(n):
        x, fields, *local = (arrays[f"{k}.{j}"] for j in range(leaves))
        past.append(WoundState(x, fields, Local(*local)))
    times = tuple(scalars[f"time.{k}"] for k in range(n))
    return Course(tuple(past), times, *(scalars[name] for name in ("step", "taken", "rejected", "iterations", "last")))
