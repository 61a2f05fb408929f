"""Newton's method with a line search, and load stepping that adapts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..core.errors import ConvergenceError


@dataclass
class NewtonReport:
    """What a nonlinear solve did.

    ``history`` has one line per attempt, for the reader, ``norms`` the residual after each iteration; ``tell`` hears of each.
    ``is_stable`` is False where an unloaded shape was found of which the known one is no stable equilibrium.
    """

    iterations: int = 0
    load_steps: int = 0
    history: list[str] = field(default_factory=list)
    norms: list[float] = field(default_factory=list)
    tell: Callable[[str], None] | None = None
    is_stable: bool = True

    def count(self, norm: float) -> None:
        """Count an iteration that ended with this norm of the residual."""
        self.iterations += 1
        self.norms.append(norm)
        if self.tell is not None:
            self.tell(f"iteration {self.iterations}, residual {norm:.1e} mN/mm")


FREE_STEPS, GROWTH = 5, 20.0  # the residual may grow so many times in the first steps
PATIENCE = 4  # later it must halve in so many steps: where it crawls, smaller load steps are cheaper

Residual = Callable[[np.ndarray], np.ndarray]
Step = Callable[[np.ndarray, np.ndarray], np.ndarray]


def euclidean(r: np.ndarray) -> float:
    """Norm of a vector that is whole."""
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
    """Solve residual(x) = 0.

    Parameters
    ----------
    residual : callable
        x (n,) -> r (n,).
    step : callable
        (x, r) -> Newton increment (n,), solving K(x) dx = -r.
    tolerance : float
        Absolute bound on the norm of r.
    norm : callable
        r (n,) -> its Euclidean norm; where ranks have parts of r, that of all parts.

    Raises
    ------
    ConvergenceError
        With the residual norms, when the iterations run out or the line search finds no descent.
    """
    r = residual(x)
    norms = [norm(r)]
    while not norms[-1] <= tolerance:
        if len(norms) > max_iterations or not norms[-1] <= 1e3 * max(norms[0], tolerance):
            raise _failure(norms, "no convergence")
        if len(norms) > FREE_STEPS + PATIENCE and norms[-1] > 0.5 * norms[-1 - PATIENCE]:
            raise _failure(norms, "it crawls")
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
    """Halve the step until the residual is finite and comes down; in the first steps it may grow, but not without limit.

    Far from the answer a full Newton step often raises the residual of nearly incompressible tissue (volume first,
    shape later); cutting it there is what makes the iteration crawl.
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
    return ConvergenceError(f"Newton stopped: {why}.", [f"{why}; residual norms [mN]: {trace}"])


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
    """Walk downhill in ``energy`` to a stationary point, residual = d energy / dx = 0.

    Damped Newton (Levenberg 1944): slower than ``newton``, but it passes limit points and bifurcations, where it slides to
    a stable solution. ``step(x, r, damping)`` solves (K + damping M) dx = -r.

    Raises
    ------
    ConvergenceError
        When the iterations run out.
    """
    E, r = energy(x), residual(x)
    norms = [float(np.linalg.norm(r))]
    for _ in range(max_iterations):
        if norms[-1] <= tolerance:
            return x
        trial, E_trial = _downhill(energy, step, x, r, E, damping)
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


def _downhill(energy, step, x: np.ndarray, r: np.ndarray, E: float, damping: float) -> tuple[np.ndarray | None, float]:
    """One damped step, or None when it does not lead downhill (within the rounding of the energy)."""
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
) -> np.ndarray:
    """Walk a load factor from 0 to 1 in adaptive steps.

    ``advance(x, factor)`` returns the solution at that factor or raises ConvergenceError; a failed step is halved, two
    steps that succeed let the next one double.

    Raises
    ------
    ConvergenceError
        When the step has become smaller than ``smallest`` or the iterations run out, with all that was tried.
    """
    reached, size, streak = 0.0, first, 0
    while reached < 1.0:
        target = min(1.0, reached + size)
        try:
            x = advance(x, target)
        except ConvergenceError as error:
            report.history.append(f"load factor {reached:.4g} -> {target:.4g}: {error.history[-1]}")
            size, streak = 0.5 * (target - reached), 0
            if size < smallest or report.iterations > max_iterations:
                raise ConvergenceError(
                    f"No equilibrium found beyond load factor {reached:.4g}: try stiffer tissue or another mesh, and look at "
                    "folds and at the ends of the chest wall.",
                    report.history,
                ) from error
            continue
        report.load_steps += 1
        report.history.append(f"load factor {reached:.4g} -> {target:.4g}: converged")
        reached, streak = target, streak + 1
        size *= 2.0 if streak > 1 else 1.0
    return x
