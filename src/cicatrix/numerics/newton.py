"""Newton's method with a line search, damped Newton minimisation, and adaptive load stepping."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..core.errors import ConvergenceError


@dataclass
class NewtonReport:
    """Record of the iterations of a nonlinear solve.

    ``history`` has one readable line per attempt, and ``norms`` the norm of the residual after each iteration; ``tell`` is
    called with a progress message at each iteration. ``is_stable`` is False if an inverse solve finds an unloaded shape for
    which the known loaded shape is not a stable equilibrium.
    """

    iterations: int = 0
    load_steps: int = 0
    history: list[str] = field(default_factory=list)
    norms: list[float] = field(default_factory=list)
    tell: Callable[[str], None] | None = None
    is_stable: bool = True

    def count(self, norm: float) -> None:
        """Count one iteration that ended with a residual of this norm."""
        self.iterations += 1
        self.norms.append(norm)
        if self.tell is not None:
            self.tell(f"iteration {self.iterations}, residual {norm:.1e} mN/mm")

    def append(self, other: NewtonReport, what: str) -> None:
        """Count the iterations and steps of another attempt too, which ``what`` describes."""
        self.iterations, self.load_steps = self.iterations + other.iterations, self.load_steps + other.load_steps
        self.history += [what, *other.history]
        self.norms += other.norms


# in the first FREE_STEPS iterations the norm of the residual may reach GROWTH times its first value; later it must halve
# within PATIENCE iterations, because smaller load steps are cheaper than many iterations
FREE_STEPS, GROWTH = 5, 20.0
PATIENCE = 4

Residual = Callable[[np.ndarray], np.ndarray]
Step = Callable[[np.ndarray, np.ndarray], np.ndarray]


def euclidean(r: np.ndarray) -> float:
    """Return the Euclidean norm of a vector that is not distributed over ranks."""
    return float(np.linalg.norm(r))


def newton(
    residual: Residual,
    step: Step,
    x: np.ndarray,
    *,
    tolerance: float,
    report: NewtonReport,
    max_iterations: int = 30,
    norm: Callable[[np.ndarray], float] = euclidean,
) -> np.ndarray:
    """Solve residual(x) = 0 by Newton's method with a line search.

    Parameters
    ----------
    residual : callable
        x (n,) -> r (n,).
    step : callable
        (x, r) -> Newton increment (n,), solving K(x) dx = -r.
    tolerance : float
        Absolute bound on the norm of r.
    norm : callable
        r (n,) -> its Euclidean norm, over all ranks if r is distributed.

    Raises
    ------
    ConvergenceError
        If the maximum number of iterations is reached, or the line search finds no descent; its history has the residual norms.
    """
    r = residual(x)
    norms = [norm(r)]
    while not norms[-1] <= tolerance:
        if len(norms) > max_iterations or not norms[-1] <= 1e3 * max(norms[0], tolerance):
            raise _failure(norms, "no convergence")
        if len(norms) > FREE_STEPS + PATIENCE and norms[-1] > 0.5 * norms[-1 - PATIENCE]:
            raise _failure(norms, "convergence is too slow")
        try:
            dx = step(x, r)
        except FloatingPointError as error:
            raise _failure(norms, f"singular tangent ({error})") from error
        x, r, length = _line_search(residual, x, dx, norms, norm)
        norms.append(length)
        report.count(norms[-1])
    return x


def _line_search(
    residual: Residual, x: np.ndarray, dx: np.ndarray, norms: list[float], norm: Callable[[np.ndarray], float]
) -> tuple[np.ndarray, np.ndarray, float]:
    """Halve the Newton step dx from x until the norm of the residual is small enough; return the new x, its residual and norm.

    The bound is the last norm, or in the first ``FREE_STEPS`` iterations ``GROWTH`` times the first norm.

    Far from the solution a full Newton step often increases the residual of nearly incompressible tissue (the volume converges
    before the shape); shortening such steps would make convergence slow.
    """
    limit = GROWTH * norms[0] if len(norms) <= FREE_STEPS else norms[-1]
    for halvings in range(8):
        trial = x + 0.5**halvings * dx
        r_trial = residual(trial)
        length = norm(r_trial)
        if length <= limit:  # false for NaN
            return trial, r_trial, length
    raise _failure(norms, "the line search found no descent")


def _failure(norms: list[float], why: str) -> ConvergenceError:
    trace = " ".join(f"{n:.2e}" for n in norms[:2] + norms[2:][-6:])
    return ConvergenceError(f"Newton's method stopped: {why}.", [f"{why}; residual norms [mN]: {trace}"])


def minimise(
    energy: Callable[[np.ndarray], float],
    residual: Residual,
    step: Callable[[np.ndarray, np.ndarray, float], np.ndarray],
    x: np.ndarray,
    *,
    tolerance: float,
    report: NewtonReport,
    damping: float = 1.0,
    max_iterations: int = 200,
) -> np.ndarray:
    """Minimise a function ``energy`` of x (n,) by damped Newton steps, until its gradient ``residual`` is 0 within tolerance.

    The method (Levenberg 1944) is slower than ``newton``, but passes limit points and bifurcations and descends to a
    stable solution. ``step(x, r, damping)`` solves (K + damping M) dx = -r.

    Raises
    ------
    ConvergenceError
        If the maximum number of iterations is reached.
    """
    E, r = energy(x), residual(x)
    norms = [float(np.linalg.norm(r))]
    for _ in range(max_iterations):
        if norms[-1] <= tolerance:
            return x
        trial, E_trial = _descent_step(energy, step, x, r, E, damping)
        if trial is None:
            damping = max(4.0 * damping, 1e-6)
            if damping > 1e12:
                break
            continue
        x, E, r = trial, E_trial, residual(trial)
        norms.append(float(np.linalg.norm(r)))
        report.count(norms[-1])
        damping *= 0.1 if norms[-1] < 0.5 * norms[-2] else 0.4
    raise _failure(norms, "damped Newton ran out of iterations")


def _descent_step(
    energy, step, x: np.ndarray, r: np.ndarray, E: float, damping: float
) -> tuple[np.ndarray | None, float]:
    """Try one damped Newton step from x; return the new x and its energy, or None and the old energy E if E does not decrease."""
    try:
        dx = step(x, r, damping)
    except FloatingPointError:
        return None, E
    if not (np.isfinite(dx).all() and dx @ r < 0.0):
        return None, E
    trial = x + dx
    E_trial = energy(trial)
    return (trial, E_trial) if E_trial <= E + 1e-4 * (dx @ r) + 1e-13 * abs(E) else (None, E)


def ramp(
    advance: Callable[[np.ndarray, float], np.ndarray],
    x: np.ndarray,
    report: NewtonReport,
    smallest: float = 1.0 / 512.0,
    first: float = 1.0,
    max_iterations: int = 120,
    start: float = 0.0,
) -> np.ndarray:
    """Increase a load factor from ``start`` to 1 in adaptive steps, and return the solution at 1; x is the solution at ``start``.

    ``advance(x, factor)`` returns the solution at that factor or raises ConvergenceError. A failed step is halved; after
    the second success in a row and each further one, the step is doubled.

    Raises
    ------
    ConvergenceError
        If the step becomes smaller than ``smallest``, or the maximum number of iterations is reached; with the history of all
        attempts.
    """
    reached, size, streak = start, first, 0
    while reached < 1.0:
        target = min(1.0, reached + size)
        try:
            x = advance(x, target)
        except ConvergenceError as error:
            report.history.append(f"load factor {reached:.4g} -> {target:.4g}: {(error.history or [error])[-1]}")
            size, streak = 0.5 * (target - reached), 0
            if size < smallest or report.iterations > max_iterations:
                raise ConvergenceError(
                    f"No equilibrium found beyond load factor {reached:.4g}: try stiffer tissue or another mesh, and "
                    "check the geometry for folds and at the ends of the chest wall.",
                    report.history,
                ) from error
            continue
        report.load_steps += 1
        report.history.append(f"load factor {reached:.4g} -> {target:.4g}: converged")
        reached, streak = target, streak + 1
        size *= 2.0 if streak > 1 else 1.0
    return x
