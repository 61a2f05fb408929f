"""Sparse direct solvers behind one small protocol: MKL PARDISO where it is installed, SuperLU (SciPy) elsewhere."""

from __future__ import annotations

import os
import weakref
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

# the same bits in every run on one kind of machine: MKL may order its sums by threads and by where memory happens to lie, unless
# told not to; COMPATIBLE would give them on every x86-64, at two to three times the time
os.environ.setdefault("MKL_NUM_THREADS", "1")
os.environ.setdefault("MKL_CBWR", "AUTO")

try:
    import pypardiso
except (ImportError, OSError):  # no wheel for this machine: SciPy serves
    pypardiso = None


NEGATIVE_EIGENVALUES = 23  # number of the entry of PARDISO's iparm


class LinearSolver(Protocol):
    """Factor a matrix of a fixed pattern again and again, and solve with the last factor."""

    n_factorizations: int
    n_negative: int | None
    """Negative eigenvalues of the last symmetric matrix; None where the solver cannot tell."""

    def factor(self, matrix: sp.csr_array) -> None:
        """Factorise; raises FloatingPointError where the matrix is singular or not finite."""
        ...

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve with the last factor: (n,) -> (n,)."""
        ...


class SuperLU:
    """SciPy's SuperLU: slower, everywhere."""

    n_negative = None

    def __init__(self) -> None:
        self.n_factorizations = 0

    def factor(self, matrix: sp.csr_array) -> None:
        """Factorise; raises FloatingPointError where the matrix is singular or not finite."""
        _check_finite(matrix)
        self.n_factorizations += 1
        try:
            self._lu = splu(sp.csc_array(matrix), permc_spec="COLAMD")
        except RuntimeError as error:
            raise FloatingPointError(str(error)) from error

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve with the last factor: (n,) -> (n,)."""
        return self._lu.solve(rhs)


class Pardiso:
    """MKL PARDISO through pypardiso: the symbolic analysis of the pattern is done once.

    Parameters
    ----------
    symmetric : bool
        Factor the upper triangle as symmetric indefinite (half the work) instead of as a general matrix.
    """

    def __init__(self, symmetric: bool) -> None:
        self.n_factorizations = 0
        self.n_negative: int | None = None
        self._symmetric = symmetric
        self._solver = pypardiso.PyPardisoSolver(mtype=-2 if symmetric else 11)
        self._upper: tuple | None = None
        weakref.finalize(self, self._solver.free_memory, everything=True)

    def factor(self, matrix: sp.csr_array) -> None:
        """Factorise; raises FloatingPointError where the matrix is singular or not finite."""
        _check_finite(matrix)
        self._matrix = self._upper_triangle(matrix) if self._symmetric else sp.csr_matrix(matrix)
        self._solver.set_phase(12 if self.n_factorizations == 0 else 22)
        self.n_factorizations += 1
        try:
            self._solver._call_pardiso(self._matrix, np.zeros((matrix.shape[0], 1)))
        except pypardiso.pardiso_wrapper.PyPardisoError as error:
            raise FloatingPointError(str(error)) from error
        if self._symmetric:
            self.n_negative = int(self._solver.get_iparm(NEGATIVE_EIGENVALUES))

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve with the last factor: (n,) -> (n,)."""
        self._solver.set_phase(33)
        return self._solver._call_pardiso(self._matrix, np.asfortranarray(rhs[:, None]))[:, 0]

    def _upper_triangle(self, matrix: sp.csr_array) -> sp.csr_matrix:
        if self._upper is None:
            rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
            keep = np.flatnonzero(matrix.indices >= rows)
            indptr = np.concatenate([[0], np.cumsum(np.bincount(rows[keep], minlength=matrix.shape[0]))])
            self._upper = keep, matrix.indices[keep], indptr
        keep, indices, indptr = self._upper
        return sp.csr_matrix((matrix.data[keep], indices, indptr), shape=matrix.shape)


def linear_solver(symmetric: bool) -> LinearSolver:
    """Return the best direct solver of this machine; CICATRIX_LINEAR_SOLVER = "scipy" asks for SuperLU."""
    if pypardiso is not None and os.environ.get("CICATRIX_LINEAR_SOLVER") != "scipy":
        return Pardiso(symmetric)
    return SuperLU()  # pyright: ignore[reportReturnType]


def _check_finite(matrix: sp.csr_array) -> None:
    if not np.isfinite(matrix.data).all():
        raise FloatingPointError("the matrix holds numbers that are not finite")
