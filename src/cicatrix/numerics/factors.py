"""Sparse matrix factorisations with a common interface: PARDISO if MKL is installed, otherwise SuperLU (SciPy) or pyamg.

A factor serves as a preconditioner: it may be in single precision, and may belong to a nearby matrix.
"""

from __future__ import annotations

import ctypes
import os
import site
import sys
import weakref
from abc import ABC, abstractmethod
from ctypes.util import find_library
from enum import IntEnum
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..core.deferred import Deferred
from ..core.threads import MKL_THREADS, mkl_threads

if TYPE_CHECKING:
    import pyamg  # pyright: ignore[reportMissingImports]
else:
    pyamg = Deferred("pyamg")

HAS_PYAMG = find_spec("pyamg") is not None  # an optional dependency

# bitwise reproducible runs on one type of processor: otherwise MKL's order of summation depends on threads and memory alignment.
# COMPATIBLE would give identical results on every x86-64 processor, but takes two to three times as long
os.environ[MKL_THREADS] = mkl_threads()
os.environ.setdefault("MKL_CBWR", "AUTO")


class MatrixType(IntEnum):
    """Type of a symmetric matrix: positive definite, or possibly indefinite; the values are PARDISO's codes."""

    DEFINITE = 2
    SYMMETRIC = -2


class Factor(Protocol):
    """A factorised matrix, used as a preconditioner."""

    @property
    def n_negative(self) -> int | None:
        """Number of negative eigenvalues of a symmetric matrix; None if unknown."""
        ...

    @property
    def values(self) -> np.ndarray:
        """Matrix entries from which the factor was computed."""
        ...

    @property
    def max_iterations(self) -> int:
        """Maximum number of Krylov iterations; a solve that needs more has failed."""
        ...

    @property
    def refactor_cost(self) -> float:
        """Number of Krylov iterations beyond those at the best rate so far after which a new factorisation is worth its cost.

        If it is negative, every matrix is factorised.
        """
        ...

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve with the factor: (n,) -> (n,) float64."""
        ...


class Factorisation(Protocol):
    """Factorisation of matrices with one sparsity pattern, which PARDISO and PETSc analyse only once."""

    def factor(self, matrix: sp.bsr_array) -> Factor:
        """Factorise a matrix; raises FloatingPointError if it is singular, or not definite although Cholesky is used."""
        ...

    def from_values(self, values: np.ndarray) -> Factor:
        """Return the factor of the matrix with these stored entries, bitwise identical to the original factor."""
        ...


def _mkl() -> ctypes.CDLL | None:
    """Load MKL's runtime library from where its wheel installs it or from the system's library path; None if not found."""
    names = ("libmkl_rt.so*", "libmkl_rt*.dylib", "mkl_rt*.dll")
    folders = [Path(base, part) for base in (sys.prefix, site.getuserbase()) for part in ("lib", "Library/bin")]
    found = [str(file) for folder in folders for name in names for file in sorted(folder.glob(name))]
    for path in [*found, find_library("mkl_rt")]:
        try:
            return ctypes.CDLL(path) if path else None
        except OSError:
            continue
    return None


MKL = _mkl()
NOT_DEFINITE = -4  # PARDISO's error code for a pivot that is zero or negative
N_NEGATIVE, FACTOR_NNZ = 22, 17  # indices in iparm of the number of negative eigenvalues and of nonzeros in the factor
MIN_REFACTOR_COST = 10.0  # smallest ``refactor_cost``
REFACTOR_COST_PER_ENTRY = 0.04  # ``refactor_cost`` per nonzero in a row of the factor


def check_finite(matrix: sp.bsr_array) -> None:
    """Raise FloatingPointError if a matrix contains NaN or infinity."""
    if not np.isfinite(matrix.data).all():
        raise FloatingPointError("the matrix holds numbers that are not finite")


class Pardiso:
    """MKL PARDISO in single precision: Cholesky, or LDL^T for symmetric indefinite matrices.

    Parameters
    ----------
    matrix_type : MatrixType
        Assumed type of the matrices.
    matrix : bsr_array
        Any matrix with this sparsity pattern; only its upper triangle is used.

    Raises
    ------
    FloatingPointError
        If PARDISO finds the pattern singular.
    """

    max_iterations = 60

    def __init__(self, matrix_type: MatrixType, matrix: sp.bsr_array) -> None:
        self.matrix_type = matrix_type
        self._slots, self._indices, self._indptr = _triangle(matrix)
        self._handle = np.zeros(64, np.int64)
        self._iparm = np.zeros(64, np.int32)
        self._options(matrix_type)
        self.values = np.zeros(self._indices.size, np.float32)
        self._x = np.zeros(matrix.shape[0], np.float32)
        self.n_negative: int | None = None
        weakref.finalize(self, _release, self._handle, matrix_type, self._iparm, matrix.shape[0])
        self.values[:] = matrix.data.reshape(-1)[self._slots]
        self._call(11)

    def _options(self, matrix_type: MatrixType) -> None:
        own, ordering, perturbation, inertia, two_level, single, from_zero = 0, 1, 9, 20, 23, 27, 34
        self._iparm[[own, inertia, single, from_zero]] = 1
        self._iparm[ordering], self._iparm[perturbation] = 2, 8  # METIS ordering; perturb pivots below 1e-8
        self._iparm[two_level] = int(matrix_type == MatrixType.DEFINITE)  # two-level scheduling: 20 % faster
        self._iparm[FACTOR_NNZ] = -1

    @property
    def refactor_cost(self) -> float:
        """Half the measured cost of a factorisation, since the new factor will serve later solves too.

        Operations per row grow with the square of its nonzeros for a factorisation, and linearly for a Krylov iteration.
        The ratio was measured as 0.07 to 0.085 iterations per nonzero of a row.
        """
        return max(MIN_REFACTOR_COST, REFACTOR_COST_PER_ENTRY * int(self._iparm[FACTOR_NNZ]) / self._x.size)

    def factor(self, matrix: sp.bsr_array) -> Pardiso:
        """Factorise a matrix; raises FloatingPointError if it is singular, not finite, or not definite as its type requires."""
        check_finite(matrix)
        return self.from_values(matrix.data.reshape(-1)[self._slots])

    def from_values(self, values: np.ndarray) -> Pardiso:
        """Return the factor of stored entries, bitwise identical to the original; raises FloatingPointError as ``factor``."""
        self.values[:] = values
        self._call(22)
        self.n_negative = 0 if self.matrix_type == MatrixType.DEFINITE else int(self._iparm[N_NEGATIVE])
        return self

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve with the factor: (n,) -> (n,) float64."""
        return self._call(33, rhs.astype(np.float32)).astype(float)

    def _call(self, phase: int, rhs: np.ndarray | None = None) -> np.ndarray:
        arrays = self.values, self._indptr, self._indices
        error = _pardiso(self._handle, self.matrix_type, self._iparm, phase, self._x.size, arrays, rhs, self._x)
        if error:
            what = "a pivot is not positive" if error == NOT_DEFINITE else f"PARDISO reports error {error}"
            raise MemoryError("no memory for the factor") if error == -2 else FloatingPointError(what)
        return self._x


def _pardiso(handle, matrix_type, iparm, phase, n, matrix=(None, None, None), rhs=None, x=None) -> int:
    """Call PARDISO and return its error code."""

    def at(array: np.ndarray | None):
        return None if array is None else array.ctypes.data_as(ctypes.c_void_p)

    def number(value: int):
        return ctypes.byref(ctypes.c_int(value))

    error = ctypes.c_int(0)
    values, indptr, indices = map(at, matrix)
    MKL.pardiso(
        *(at(handle), number(1), number(1), number(matrix_type), number(phase), number(n), values, indptr, indices),
        *(None, number(1), at(iparm), number(0), at(rhs), at(x), ctypes.byref(error)),
    )
    return error.value


def _release(handle: np.ndarray, matrix_type: MatrixType, iparm: np.ndarray, n: int) -> None:
    _pardiso(handle, matrix_type, iparm, -1, n)


def _triangle(matrix: sp.bsr_array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the upper triangle of a block matrix in CSR form: positions of entries in ``matrix.data``, columns, row starts."""
    places = np.arange(matrix.data.size, dtype=np.int32).reshape(matrix.data.shape)
    scalar = sp.bsr_array((places + 1, matrix.indices, matrix.indptr), shape=matrix.shape).tocsr()
    scalar.sort_indices()
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int32), np.diff(scalar.indptr))
    upper = scalar.indices >= rows
    counts = np.bincount(rows[upper], minlength=matrix.shape[0])
    indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return scalar.data[upper] - 1, scalar.indices[upper].astype(np.int32), indptr


class _BlockFactorisation(ABC):
    """Base class of SuperLU and multigrid, which stores the sparsity pattern and the entries of the last matrix."""

    n_negative, refactor_cost = None, 30.0

    def __init__(self, matrix: sp.bsr_array) -> None:
        self._pattern = (matrix.indices, matrix.indptr), matrix.shape
        self.values = matrix.data

    def factor(self, matrix: sp.bsr_array) -> Factor:
        """Factorise a matrix; raises FloatingPointError if it is singular or not finite."""
        check_finite(matrix)
        return self.from_values(matrix.data)

    @abstractmethod
    def from_values(self, values: np.ndarray) -> Factor:
        """Return the factor of stored entries, bitwise identical to the original; raises FloatingPointError as ``factor``."""


class SuperLU(_BlockFactorisation):
    """SciPy's SuperLU: always available, but slower than PARDISO, and it does not give the signs of the eigenvalues."""

    max_iterations = 60

    def from_values(self, values: np.ndarray) -> SuperLU:  # noqa: D102
        self.values = values
        blocks = sp.bsr_array((values, *self._pattern[0]), shape=self._pattern[1])
        try:
            self._lu = splu(blocks.tocsc(), permc_spec="MMD_AT_PLUS_A")
        except RuntimeError as error:
            raise FloatingPointError(str(error)) from error
        return self

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve with the factor: (n,) -> (n,) float64."""
        return self._lu.solve(rhs)


class Multigrid(_BlockFactorisation):
    """Smoothed-aggregation multigrid (pyamg), for definite matrices too large for SuperLU; needs many more iterations.

    The near-null space is one constant vector per component of a block: the translations, for a body without sliding supports.
    An indefinite matrix is detected only by negative curvature during the iteration.
    """

    max_iterations = 500

    def from_values(self, values: np.ndarray) -> Multigrid:  # noqa: D102
        self.values = values
        matrix = sp.bsr_matrix((values, *self._pattern[0]), shape=self._pattern[1])
        translations = np.tile(np.eye(values.shape[1]), (matrix.shape[0] // values.shape[1], 1))
        before = np.random.get_state()  # noqa: NPY002  pyamg draws the start vectors of its eigenvalue estimates from NumPy's global generator
        np.random.seed(0)  # noqa: NPY002
        try:
            levels = pyamg.smoothed_aggregation_solver(matrix, B=translations, strength=("symmetric", {"theta": 0.08}))
        finally:
            np.random.set_state(before)  # noqa: NPY002
        self._cycle = levels.aspreconditioner()
        return self

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve with the factor: (n,) -> (n,) float64."""
        return np.asarray(self._cycle @ rhs)


LARGEST_SUPERLU = 30_000  # largest definite matrix for SuperLU (unknowns); larger solids take minutes and gigabytes


def factorisation(matrix_type: MatrixType, matrix: sp.bsr_array) -> Factorisation:
    """Return the fastest installed factorisation for a matrix; CICATRIX_LINEAR_SOLVER = "scipy" or "pyamg" avoids MKL."""
    asked = os.environ.get("CICATRIX_LINEAR_SOLVER")
    if MKL is not None and asked not in ("scipy", "pyamg"):
        return Pardiso(matrix_type, matrix)
    is_large = matrix.shape[0] > LARGEST_SUPERLU and asked != "scipy"
    if HAS_PYAMG and matrix_type == MatrixType.DEFINITE and (is_large or asked == "pyamg"):
        return Multigrid(matrix)
    return SuperLU(matrix)
