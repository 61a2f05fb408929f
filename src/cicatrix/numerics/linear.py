"""Linear solver for a sequence of slowly changing matrices, which uses one factor as preconditioner for many of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator
from scipy.sparse.linalg import gmres as scipy_gmres

from .factors import Factor, Factorisation, MatrixType, check_finite, factorisation
from .krylov import Krylov, PetscEngine

PROBE_STEPS = 6  # iterations of conjugate gradients in search of negative curvature
INDEFINITE_COST_FACTOR = 0.5  # if the factor is indefinite: GMRES is slower, and the next matrix may be definite
MIN_JUDGED_ITERATIONS = 10  # iterations before the rate of convergence is judged

Pattern = tuple[np.ndarray, np.ndarray]  # ``indptr`` and ``indices`` of a sparse matrix


class Engine(Protocol):
    """Linear-algebra back end: factorisations and Krylov iterations, in one process or over several ranks."""

    def factorisation(self, matrix_type: MatrixType, matrix: sp.bsr_array) -> Factorisation:
        """Prepare the factorisation of matrices of a given type with the sparsity pattern of ``matrix``."""
        ...

    def iterate(
        self,
        factor: Any,
        method: Krylov,
        matrix: sp.bsr_array,
        rhs: np.ndarray,
        tolerance: float,
        max_iterations: int,
        slowest: float = np.inf,
    ) -> tuple[np.ndarray | None, int]:
        """Solve K x = b by a Krylov method, with a factor as preconditioner, to |b - K x| <= tolerance |b|.

        Return x (None if the tolerance was not reached) and the number of iterations. The iteration may stop early if it
        takes more than ``slowest`` iterations per decimal digit of reduction of the residual.
        """
        ...

    def release(self, methods: Sequence[Any]) -> None:
        """Free the memory that factorisations have allocated outside Python."""
        ...


class InProcess:
    """Back end without PETSc: a factorisation from :mod:`.factors` and the Krylov methods of this module."""

    def factorisation(self, matrix_type: MatrixType, matrix: sp.bsr_array) -> Factorisation:  # noqa: D102
        check_finite(matrix)  # the analysis phase of PARDISO already uses the values
        return factorisation(matrix_type, matrix)

    def iterate(  # noqa: D102
        self,
        factor: Factor,
        method: Krylov,
        matrix: sp.bsr_array,
        rhs: np.ndarray,
        tolerance: float,
        max_iterations: int,
        slowest: float = np.inf,
    ) -> tuple[np.ndarray | None, int]:
        solve = conjugate_gradients if method == "cg" else gmres
        return solve(matrix, rhs, factor.solve, tolerance, max_iterations, slowest)

    def release(self, methods: Sequence[Factorisation]) -> None:  # noqa: D102
        pass  # freed by garbage collection


def engine() -> Engine:
    """Return the default back end; CICATRIX_LINEAR_SOLVER = "petsc" selects MUMPS through PETSc."""
    return PetscEngine() if os.environ.get("CICATRIX_LINEAR_SOLVER") == "petsc" else InProcess()


class LinearSolver:
    """Solve K x = b by a preconditioned Krylov method in double precision, with one factor for many matrices.

    Symmetric matrices are factorised by Cholesky (in single precision with PARDISO), with a symmetric indefinite factorisation as
    fallback. For unsymmetric matrices the preconditioner is the factor of a nearby symmetric matrix (``near``). Symmetric
    matrices with a definite factor are solved by conjugate gradients, all others by GMRES.

    A factor is replaced once its extra iterations, counted beyond its best rate in iterations per digit, would have paid
    for a new one, and at once if a solve fails or converges too slowly. Where the sparsity pattern has changed by then, the new
    pattern is analysed first. Decisions depend on computed values, never on timings.

    Parameters
    ----------
    on : Engine, optional
        Back end for factorisations and Krylov iterations; by default the one that :func:`engine` returns.
    """

    def __init__(self, on: Engine | None = None) -> None:
        self._engine = on or engine()
        self._methods: dict[MatrixType, Factorisation] = {}
        self._analysed: dict[MatrixType, Pattern] = {}
        self._factor: Factor | None = None
        self._matrix_type = MatrixType.DEFINITE
        self._best_rate, self._excess_iterations = np.inf, 0.0
        self.n_factorizations, self.n_steps = 0, 0

    def solve(
        self, matrix: sp.bsr_array, rhs: np.ndarray, tolerance: float, near: Callable[[], sp.bsr_array] | None = None
    ) -> np.ndarray:
        """Solve K x = b to |b - K x| <= tolerance |b|: (n,) -> (n,).

        Parameters
        ----------
        matrix : (n, n) bsr_array
            K, symmetric unless ``near`` is given.
        rhs : (n,) array
            b.
        tolerance : float
            Bound on the residual relative to the right-hand side (Euclidean norms).
        near : callable, optional
            Returns a symmetric matrix with the same sparsity pattern that is close to K.

        Raises
        ------
        FloatingPointError
            If the matrix is singular or not finite.
        """
        symmetric = near is None
        if self._factor is not None and self._excess_iterations <= self._refactor_cost:
            slowest = self._best_rate + self._refactor_cost / _digits(tolerance)
            x = self._iterate(matrix, rhs, tolerance, symmetric, slowest)
            if x is not None:
                return x
        part = matrix if near is None else near()
        self.factor(part)
        x = self._iterate(matrix, rhs, tolerance, symmetric)
        if x is None and self._matrix_type == MatrixType.DEFINITE:
            # Cholesky in single precision may accept a matrix that is barely definite
            self._factorise(MatrixType.SYMMETRIC, part)
            x = self._iterate(matrix, rhs, tolerance, symmetric)
        if x is None:
            raise FloatingPointError("the matrix is singular to working precision")
        return x

    @property
    def _refactor_cost(self) -> float:
        """Cost of refactorising, in equivalent Krylov iterations with the current factor."""
        return self._factor.refactor_cost * (
            INDEFINITE_COST_FACTOR if self._matrix_type == MatrixType.SYMMETRIC else 1.0
        )

    def factor(self, matrix: sp.bsr_array) -> None:
        """Factorise a symmetric matrix; raises FloatingPointError if it is singular or not finite."""
        try:
            self._factorise(MatrixType.DEFINITE, matrix)
        except FloatingPointError:
            self._factorise(MatrixType.SYMMETRIC, matrix)

    def _factorise(self, matrix_type: MatrixType, matrix: sp.bsr_array) -> None:
        self._factor, self._best_rate, self._excess_iterations = None, np.inf, 0.0
        if matrix_type in self._methods and not has_pattern(matrix, self._analysed[matrix_type]):
            self._engine.release([self._methods.pop(matrix_type)])
        if matrix_type not in self._methods:
            self._methods[matrix_type] = self._engine.factorisation(matrix_type, matrix)
            self._analysed[matrix_type] = matrix.indptr, matrix.indices
        self.n_factorizations += 1
        self._factor, self._matrix_type = self._methods[matrix_type].factor(matrix), matrix_type

    def reset(self) -> None:
        """Discard the factor and free its memory."""
        self._engine.release(list(self._methods.values()))
        self._methods, self._analysed, self._factor = {}, {}, None

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return all data that the next solve depends on, as a checkpoint for ``restore``; empty before the first solve."""
        if self._factor is None:
            return {}
        served = np.array([self._best_rate, self._excess_iterations])
        return {"values": self._factor.values.copy(), "kind": np.array(self._matrix_type), "served": served}

    def restore(self, matrix: sp.bsr_array, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the data of ``state_arrays``, so that later solves are bitwise identical.

        Only the sparsity pattern of ``matrix`` is used, not its entries.
        """
        self._matrix_type, (self._best_rate, self._excess_iterations) = (
            MatrixType(int(arrays["kind"])),
            map(float, arrays["served"]),
        )
        self._methods[self._matrix_type] = self._engine.factorisation(self._matrix_type, matrix)
        self._analysed[self._matrix_type] = matrix.indptr, matrix.indices
        self._factor = self._methods[self._matrix_type].from_values(arrays["values"])

    def _iterate(
        self, matrix: sp.bsr_array, rhs: np.ndarray, tolerance: float, symmetric: bool, slowest: float = np.inf
    ) -> np.ndarray | None:
        """Solve K x = b with the current factor as preconditioner; return x (n,), or None without convergence."""
        method = "cg" if symmetric and self._matrix_type == MatrixType.DEFINITE else "gmres"
        max_iterations = self._factor.max_iterations
        x, steps = self._engine.iterate(self._factor, method, matrix, rhs, tolerance, max_iterations, slowest)
        self.n_steps += steps
        self._best_rate = min(self._best_rate, max(steps, 1) / _digits(tolerance))
        self._excess_iterations = (
            np.inf if x is None else self._excess_iterations + steps - self._best_rate * _digits(tolerance)
        )
        return x

    def is_definite(self, matrix: sp.bsr_array) -> bool:
        """Return whether a symmetric matrix is positive definite, as far as a short search for negative eigenvalues shows.

        With a definite factor, a few iterations of conjugate gradients from a random right-hand side look for negative curvature.
        With an indefinite factor, the matrix itself is factorised and its negative eigenvalues are counted. SuperLU does not give
        the signs of eigenvalues: with an indefinite factor of SuperLU, every matrix counts as definite.
        """
        if self._matrix_type != MatrixType.DEFINITE:
            self._factorise(MatrixType.SYMMETRIC, matrix)  # the current factor has the signs of another matrix
            return not self._factor.n_negative
        rhs = np.random.Generator(np.random.Philox(0)).standard_normal(matrix.shape[0])
        x, steps = self._engine.iterate(self._factor, "cg", matrix, rhs, 1e-6, PROBE_STEPS)
        return x is not None or steps == PROBE_STEPS


def has_pattern(matrix: sp.bsr_array, pattern: Pattern) -> bool:
    """Return whether a matrix has a sparsity pattern, with indices in the same order."""
    return all(a is b or np.array_equal(a, b) for a, b in zip((matrix.indptr, matrix.indices), pattern))


def _digits(tolerance: float) -> float:
    return max(-np.log10(tolerance), 1.0)


def _is_slow(steps: int, share: float, slowest: float) -> bool:
    """Return whether a Krylov method converges too slowly: more than ``slowest`` iterations per decimal digit.

    ``steps`` iterations have reduced the residual to the fraction ``share`` of the right-hand side.
    """
    if steps < MIN_JUDGED_ITERATIONS or slowest == np.inf:
        return False
    return steps > slowest * max(-np.log10(max(share, 1e-300)), 0.0)


def conjugate_gradients(
    matrix: sp.bsr_array, rhs: np.ndarray, precondition, tolerance: float, max_iterations: int, slowest: float = np.inf
) -> tuple[np.ndarray | None, int]:
    """Solve K x = b by preconditioned conjugate gradients to |b - K x| <= tolerance |b|.

    Return x (None if not reached) and the number of iterations. ``precondition`` applies the inverse of the preconditioner. The
    iteration stops at a direction of negative curvature, or after more than ``slowest`` iterations per decimal digit.
    Because the preconditioner has rounding errors (single precision), search directions are conjugated with the change of
    the residual (Polak & Ribiere; Notay 2000, flexible conjugate gradients).
    """
    x, r, p, rz = np.zeros_like(rhs), rhs.copy(), np.zeros_like(rhs), 1.0
    before, whole = np.zeros_like(rhs), float(np.linalg.norm(rhs))
    for step in range(max_iterations + 1):
        left = float(np.linalg.norm(r))
        if left <= tolerance * whole:
            return x, step
        if step == max_iterations or _is_slow(step, left / whole, slowest):
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
    matrix: sp.bsr_array, rhs: np.ndarray, precondition, tolerance: float, max_iterations: int, slowest: float = np.inf
) -> tuple[np.ndarray | None, int]:
    """Solve K x = b by SciPy's GMRES; arguments and result as for :func:`conjugate_gradients`."""
    shares = []

    def note(share: float) -> None:
        shares.append(share)
        if _is_slow(len(shares), share, slowest):
            raise _TooSlowError

    operator = LinearOperator(matrix.shape, matvec=precondition, dtype=float)  # pyright: ignore[reportCallIssue]
    try:
        x, left = scipy_gmres(
            *(matrix, rhs),
            **{"rtol": tolerance, "M": operator, "restart": max_iterations // 3, "maxiter": 3},
            callback=note,
            callback_type="pr_norm",
        )
    except _TooSlowError:
        return None, len(shares)
    return None if left else x, len(shares)
