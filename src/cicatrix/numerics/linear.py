"""Linear solves of a sequence of matrices that change little: one factor serves as preconditioner for many of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator
from scipy.sparse.linalg import gmres as scipy_gmres

from .factors import Factor, Factorisation, Kind, check_finite, factorisation
from .krylov import Krylov, PetscEngine

PROBE_STEPS = 6  # of Lanczos' method in search of a negative eigenvalue
INDEFINITE = 0.5  # steps in place of those: minimal residuals take longer, and the next factor may well be definite
FEW = 10  # steps before a pace is judged


class Engine(Protocol):
    """What factorises and iterates, on this process or on several ranks."""

    def factorisation(self, kind: Kind, matrix: sp.bsr_array) -> Factorisation:
        """Prepare to factorise matrices of this pattern."""
        ...

    def iterate(
        self,
        factor: Any,
        method: Krylov,
        matrix: sp.bsr_array,
        rhs: np.ndarray,
        tolerance: float,
        most_steps: int,
        slowest: float = np.inf,
    ) -> tuple[np.ndarray | None, int]:
        """Solve with a factor: the solution, or None where it is not reached, and the steps taken.

        It may give up where the steps per digit come out above ``slowest``.
        """
        ...

    def release(self, methods: Sequence[Any]) -> None:
        """Let go what these hold beyond Python's own memory."""
        ...


class InProcess:
    """What this process has without PETSc (``factorisation``), and the Krylov methods below."""

    def factorisation(self, kind: Kind, matrix: sp.bsr_array) -> Factorisation:  # noqa: D102
        check_finite(matrix)  # PARDISO looks at the numbers already
        return factorisation(kind, matrix)

    def iterate(  # noqa: D102
        self,
        factor: Factor,
        method: Krylov,
        matrix: sp.bsr_array,
        rhs: np.ndarray,
        tolerance: float,
        most_steps: int,
        slowest: float = np.inf,
    ) -> tuple[np.ndarray | None, int]:
        solve = conjugate_gradients if method == "cg" else gmres
        return solve(matrix, rhs, factor.solve, tolerance, most_steps, slowest)

    def release(self, methods: Sequence[Factorisation]) -> None:  # noqa: D102
        pass  # they do it when nobody knows them any more


def engine() -> Engine:
    """Return the one of this process; CICATRIX_LINEAR_SOLVER = "petsc" asks for MUMPS through PETSc."""
    return PetscEngine() if os.environ.get("CICATRIX_LINEAR_SOLVER") == "petsc" else InProcess()


class LinearSolver:
    """Solve K x = b to a tolerance by a Krylov method in double precision, preconditioned by a factor that is kept.

    A symmetric matrix is factorised as if it were definite (Cholesky, single precision), and where it turns out to be
    indefinite as such; in place of one that is not symmetric a symmetric one is that is near. Symmetric matrices with a
    definite factor are solved with by conjugate gradients, all others by generalised minimal residuals.

    The factor is kept until the steps that it took in excess of its best rate, in steps per digit, would have paid for another
    one; it goes at once where it fails or crawls. What is done depends on numbers alone, never on time.

    Parameters
    ----------
    on : Engine, optional
        What factorises and iterates; the best one of this process unless given.
    """

    def __init__(self, on: Engine | None = None) -> None:
        self._engine = on or engine()
        self._methods: dict[Kind, Factorisation] = {}
        self._factor: Factor | None = None
        self._kind = Kind.DEFINITE
        self._best_rate, self._spent = np.inf, 0.0
        self.n_factorizations, self.n_steps = 0, 0

    def solve(
        self, matrix: sp.bsr_array, rhs: np.ndarray, tolerance: float, near: Callable[[], sp.bsr_array] | None = None
    ) -> np.ndarray:
        """Solve to |b - K x| <= tolerance |b|: (n,) -> (n,).

        Parameters
        ----------
        matrix : (n, n) bsr_array
            K, symmetric unless ``near`` is given.
        rhs : (n,) array
            b.
        tolerance : float
            Bound on the residual over the right-hand side (Euclidean norms).
        near : callable, optional
            Makes a symmetric matrix of the same pattern that is near to K.

        Raises
        ------
        FloatingPointError
            Where the matrix is singular or not finite.
        """
        symmetric = near is None
        if self._factor is not None and self._spent <= self._price:
            slowest = self._best_rate + self._price / _digits(tolerance)
            x = self._iterate(matrix, rhs, tolerance, symmetric, slowest)
            if x is not None:
                return x
        part = matrix if near is None else near()
        self.factor(part)
        x = self._iterate(matrix, rhs, tolerance, symmetric)
        if x is None and self._kind == Kind.DEFINITE:
            # single precision lets a matrix pass that is hardly definite
            self._factorise(Kind.SYMMETRIC, part)
            x = self._iterate(matrix, rhs, tolerance, symmetric)
        if x is None:
            raise FloatingPointError("the matrix is singular to working precision")
        return x

    @property
    def _price(self) -> float:
        """Of another factor, in steps with this one."""
        return self._factor.price * (INDEFINITE if self._kind == Kind.SYMMETRIC else 1.0)

    def factor(self, matrix: sp.bsr_array) -> None:
        """Factorise this symmetric matrix; raises FloatingPointError where it is singular or not finite."""
        try:
            self._factorise(Kind.DEFINITE, matrix)
        except FloatingPointError:
            self._factorise(Kind.SYMMETRIC, matrix)

    def _factorise(self, kind: Kind, matrix: sp.bsr_array) -> None:
        self._factor, self._best_rate, self._spent = None, np.inf, 0.0
        if kind not in self._methods:
            self._methods[kind] = self._engine.factorisation(kind, matrix)
        self.n_factorizations += 1
        self._factor, self._kind = self._methods[kind].factor(matrix), kind

    def forget(self) -> None:
        """Let the factor's memory go."""
        self._engine.release(list(self._methods.values()))
        self._methods, self._factor = {}, None

    def kept(self) -> dict[str, np.ndarray]:
        """Everything that the next solve depends on, for ``restore``; empty before the first."""
        if self._factor is None:
            return {}
        served = np.array([self._best_rate, self._spent])
        return {"values": self._factor.values, "kind": np.array(self._kind), "served": served}

    def restore(self, matrix: sp.bsr_array, kept: Mapping[str, np.ndarray]) -> None:
        """Go on, to the bit, where another solver was; ``matrix`` is any of the pattern."""
        self._kind, (self._best_rate, self._spent) = Kind(int(kept["kind"])), map(float, kept["served"])
        self._methods[self._kind] = self._engine.factorisation(self._kind, matrix)
        self._factor = self._methods[self._kind].again(kept["values"])

    def _iterate(
        self, matrix: sp.bsr_array, rhs: np.ndarray, tolerance: float, symmetric: bool, slowest: float = np.inf
    ) -> np.ndarray | None:
        """Solve with the factor that is there; None where it does not serve."""
        method = "cg" if symmetric and self._kind == Kind.DEFINITE else "gmres"
        most = self._factor.most_steps
        x, steps = self._engine.iterate(self._factor, method, matrix, rhs, tolerance, most, slowest)
        self.n_steps += steps
        self._best_rate = min(self._best_rate, max(steps, 1) / _digits(tolerance))
        self._spent = np.inf if x is None else self._spent + steps - self._best_rate * _digits(tolerance)
        return x

    def is_definite(self, matrix: sp.bsr_array) -> bool:
        """Whether a symmetric matrix has no negative eigenvalue, as far as a short search from a random start sees.

        An indefinite factor that is kept gives way to that of this matrix, whose signs are then counted. With SuperLU's factor
        of that same matrix it sees nothing, and the answer is yes.
        """
        if self._kind != Kind.DEFINITE:
            self._factorise(Kind.SYMMETRIC, matrix)  # the last one's signs are those of another matrix
            return not self._factor.n_negative
        rhs = np.random.Generator(np.random.Philox(0)).standard_normal(matrix.shape[0])
        x, steps = self._engine.iterate(self._factor, "cg", matrix, rhs, 1e-6, PROBE_STEPS)
        return x is not None or steps == PROBE_STEPS


def _digits(tolerance: float) -> float:
    return max(-np.log10(tolerance), 1.0)


def _is_slow(steps: int, share: float, slowest: float) -> bool:
    """Whether the residual is down to so small a share of the right-hand side in too many steps per digit."""
    if steps < FEW or slowest == np.inf:
        return False
    return steps > slowest * max(-np.log10(max(share, 1e-300)), 0.0)


def conjugate_gradients(
    matrix: sp.bsr_array, rhs: np.ndarray, precondition, tolerance: float, most_steps: int, slowest: float = np.inf
) -> tuple[np.ndarray | None, int]:
    """Preconditioned conjugate gradients: the solution, or None where it is not reached, and the steps taken.

    It stops at a direction of negative curvature. The preconditioner may round (single precision), so directions are made
    conjugate by the change of the residual (Polak & Ribiere; Notay 2000, flexible conjugate gradients).
    """
    x, r, p, rz = np.zeros_like(rhs), rhs.copy(), np.zeros_like(rhs), 1.0
    before, whole = np.zeros_like(rhs), float(np.linalg.norm(rhs))
    for step in range(most_steps + 1):
        left = float(np.linalg.norm(r))
        if left <= tolerance * whole:
            return x, step
        if step == most_steps or _is_slow(step, left / whole, slowest):
            return None, step
        z = precondition(r)
        p = z + (z @ (r - before)) / rz * p if step else z
        rz, before = float(z @ r), r.copy()
        Kp = matrix @ p
        curvature = float(p @ Kp)
        if not curvature > 0.0:
            return None, step
        share = rz / curvature
        x += share * p
        r -= share * Kp
    raise AssertionError("the last step returns")


class _TooSlowError(Exception):
    pass


def gmres(
    matrix: sp.bsr_array, rhs: np.ndarray, precondition, tolerance: float, most_steps: int, slowest: float = np.inf
) -> tuple[np.ndarray | None, int]:
    """SciPy's generalised minimal residuals; the solution, or None where it is not reached, and the steps taken."""
    shares = []

    def note(share: float) -> None:
        shares.append(share)
        if _is_slow(len(shares), share, slowest):
            raise _TooSlowError

    operator = LinearOperator(matrix.shape, matvec=precondition, dtype=float)  # pyright: ignore[reportCallIssue]
    try:
        x, left = scipy_gmres(
            *(matrix, rhs),
            **{"rtol": tolerance, "M": operator, "restart": most_steps // 3, "maxiter": 3},
            callback=note,
            callback_type="pr_norm",
        )
    except _TooSlowError:
        return None, len(shares)
    return None if left else x, len(shares)
