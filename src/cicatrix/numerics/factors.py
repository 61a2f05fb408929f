"""Sparse factorisations behind one small protocol: MKL PARDISO where MKL is installed; SuperLU (SciPy) and pyamg elsewhere.

A factor here is a preconditioner: it may be single precision, and it may be that of another matrix that is near.
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
from pathlib import Path
from typing import Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

try:
    import pyamg
except ImportError:
    pyamg = None

# the same bits in every run on one kind of machine: MKL may order its sums by threads and by where memory happens to lie, unless
# told not to; COMPATIBLE would give them on every x86-64, at two to three times the time
os.environ.setdefault("MKL_NUM_THREADS", os.environ.get("CICATRIX_THREADS", "1"))
os.environ.setdefault("MKL_CBWR", "AUTO")


class Kind(IntEnum):
    """What is known of a symmetric matrix; the values are PARDISO's."""

    DEFINITE = 2
    SYMMETRIC = -2


class Factor(Protocol):
    """A factorised matrix."""

    @property
    def n_negative(self) -> int | None:
        """Negative eigenvalues of a symmetric matrix; None where that is not known."""
        ...

    @property
    def values(self) -> np.ndarray:
        """Numbers it was made of."""
        ...

    @property
    def most_steps(self) -> int:
        """Krylov steps after which it is no good."""
        ...

    @property
    def price(self) -> float:
        """Krylov steps in excess of its best that are worth another one; below 0 where it is not to be used again."""
        ...

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """(n,) -> (n,) float64."""
        ...


class Factorisation(Protocol):
    """Factor matrices of one pattern; what a pattern alone decides is found once."""

    def factor(self, matrix: sp.bsr_array) -> Factor:
        """Factorise; raises FloatingPointError where the matrix is singular, or not definite where it should be."""
        ...

    def again(self, values: np.ndarray) -> Factor:
        """The factor that was made of these numbers, to the bit."""
        ...


def _mkl() -> ctypes.CDLL | None:
    """Find MKL's one library where its wheel puts it, or where the system looks."""
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
NOT_DEFINITE = -4  # PARDISO's word for a pivot that is not positive, or zero
N_NEGATIVE, FACTOR_NNZ = 22, 17  # where it tells of them
PRICE, PRICE_PER_ENTRY = 10.0, 0.04  # of a factor in steps: at least, and for each entry of a row of it


def check_finite(matrix: sp.bsr_array) -> None:
    """Raise FloatingPointError where a matrix holds NaN or infinity."""
    if not np.isfinite(matrix.data).all():
        raise FloatingPointError("the matrix holds numbers that are not finite")


class Pardiso:
    """MKL PARDISO in single precision: Cholesky, or symmetric indefinite.

    Parameters
    ----------
    kind : Kind
        What to take for granted.
    matrix : bsr_array
        Any matrix of the pattern; its upper triangle is read.

    Raises
    ------
    FloatingPointError
        Where PARDISO finds the pattern singular.
    """

    most_steps = 60

    def __init__(self, kind: Kind, matrix: sp.bsr_array) -> None:
        self.kind = kind
        self._slots, self._indices, self._indptr = _triangle(matrix)
        self._handle = np.zeros(64, np.int64)
        self._iparm = np.zeros(64, np.int32)
        self._options(kind)
        self.values = np.zeros(self._indices.size, np.float32)
        self._x = np.zeros(matrix.shape[0], np.float32)
        self.n_negative: int | None = None
        weakref.finalize(self, _release, self._handle, kind, self._iparm, matrix.shape[0])
        self.values[:] = matrix.data.reshape(-1)[self._slots]
        self._call(11)

    def _options(self, kind: Kind) -> None:
        own, ordering, perturbation, inertia, two_level, single, from_zero = 0, 1, 9, 20, 23, 27, 34
        self._iparm[[own, inertia, single, from_zero]] = 1
        self._iparm[ordering], self._iparm[perturbation] = 2, 8  # METIS; pivots no smaller than 1e-8
        self._iparm[two_level] = int(kind == Kind.DEFINITE)  # a fifth faster, on one thread too
        self._iparm[FACTOR_NNZ] = -1

    @property
    def price(self) -> float:
        """Half of what it costs, 0.07 to 0.085 as measured: the next one will serve later solves too.

        The arithmetic of a factor grows with the square of what its rows hold, that of a step with it.
        """
        return max(PRICE, PRICE_PER_ENTRY * int(self._iparm[FACTOR_NNZ]) / self._x.size)

    def factor(self, matrix: sp.bsr_array) -> Pardiso:
        """Factorise; raises FloatingPointError where the matrix is singular, not finite, or not definite where it should be."""
        check_finite(matrix)
        return self.again(matrix.data.reshape(-1)[self._slots])

    def again(self, values: np.ndarray) -> Pardiso:
        """The factor that was made of these numbers, to the bit; raises FloatingPointError as ``factor``."""
        self.values[:] = values
        self._call(22)
        self.n_negative = 0 if self.kind == Kind.DEFINITE else int(self._iparm[N_NEGATIVE])
        return self

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """(n,) -> (n,) float64."""
        return self._call(33, rhs.astype(np.float32)).astype(float)

    def _call(self, phase: int, rhs: np.ndarray | None = None) -> np.ndarray:
        arrays = self.values, self._indptr, self._indices
        error = _pardiso(self._handle, self.kind, self._iparm, phase, self._x.size, arrays, rhs, self._x)
        if error:
            what = "a pivot is not positive" if error == NOT_DEFINITE else f"PARDISO reports error {error}"
            raise MemoryError("no memory for the factor") if error == -2 else FloatingPointError(what)
        return self._x


def _pardiso(handle, kind, iparm, phase, n, matrix=(None, None, None), rhs=None, x=None) -> int:
    """One call of PARDISO; returns its error."""

    def at(array: np.ndarray | None):
        return None if array is None else array.ctypes.data_as(ctypes.c_void_p)

    def number(value: int):
        return ctypes.byref(ctypes.c_int(value))

    error = ctypes.c_int(0)
    values, indptr, indices = map(at, matrix)
    MKL.pardiso(
        *(at(handle), number(1), number(1), number(kind), number(phase), number(n), values, indptr, indices),
        *(None, number(1), at(iparm), number(0), at(rhs), at(x), ctypes.byref(error)),
    )
    return error.value


def _release(handle: np.ndarray, kind: Kind, iparm: np.ndarray, n: int) -> None:
    _pardiso(handle, kind, iparm, -1, n)


def _triangle(matrix: sp.bsr_array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where the upper triangle's entries lie in the blocks' data, their columns, and where their rows begin."""
    places = np.arange(matrix.data.size, dtype=np.int32).reshape(matrix.data.shape)
    scalar = sp.bsr_array((places + 1, matrix.indices, matrix.indptr), shape=matrix.shape).tocsr()
    scalar.sort_indices()
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int32), np.diff(scalar.indptr))
    upper = scalar.indices >= rows
    counts = np.bincount(rows[upper], minlength=matrix.shape[0])
    indptr = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return scalar.data[upper] - 1, scalar.indices[upper].astype(np.int32), indptr


class _Blocks(ABC):
    """What SuperLU and multigrid share: the pattern, and the numbers of the last matrix."""

    n_negative, price = None, 30.0

    def __init__(self, matrix: sp.bsr_array) -> None:
        self._pattern = (matrix.indices, matrix.indptr), matrix.shape
        self.values = matrix.data

    def factor(self, matrix: sp.bsr_array) -> Factor:
        """Factorise; raises FloatingPointError where the matrix is singular or not finite."""
        check_finite(matrix)
        return self.again(matrix.data)

    @abstractmethod
    def again(self, values: np.ndarray) -> Factor:
        """The factor that was made of these numbers, to the bit; raises FloatingPointError as ``factor``."""


class SuperLU(_Blocks):
    """SciPy's SuperLU: slower, everywhere; it tells nothing of the signs of eigenvalues."""

    most_steps = 60

    def again(self, values: np.ndarray) -> SuperLU:  # noqa: D102
        self.values = values
        blocks = sp.bsr_array((values, *self._pattern[0]), shape=self._pattern[1])
        try:
            self._lu = splu(blocks.tocsc(), permc_spec="MMD_AT_PLUS_A")
        except RuntimeError as error:
            raise FloatingPointError(str(error)) from error
        return self

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """(n,) -> (n,) float64."""
        return self._lu.solve(rhs)


class Multigrid(_Blocks):
    """Smoothed aggregation by pyamg, for definite matrices too large for SuperLU; no factor, and many more steps.

    Near-null space: one constant for each component of a block, which are the translations of a body that does not slide.
    It notices an indefinite matrix only by the negative curvature that the iteration meets.
    """

    most_steps = 500

    def again(self, values: np.ndarray) -> Multigrid:  # noqa: D102
        self.values = values
        matrix = sp.bsr_matrix((values, *self._pattern[0]), shape=self._pattern[1])
        translations = np.tile(np.eye(values.shape[1]), (matrix.shape[0] // values.shape[1], 1))
        before = np.random.get_state()  # noqa: NPY002  pyamg starts its estimates of eigenvalues from there
        np.random.seed(0)  # noqa: NPY002
        try:
            levels = pyamg.smoothed_aggregation_solver(matrix, B=translations, strength=("symmetric", {"theta": 0.08}))
        finally:
            np.random.set_state(before)  # noqa: NPY002
        self._cycle = levels.aspreconditioner()
        return self

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """(n,) -> (n,) float64."""
        return np.asarray(self._cycle @ rhs)


LARGEST_SUPERLU = 30_000  # unknowns of a definite matrix; beyond, its factor of a solid takes minutes and gigabytes


def factorisation(kind: Kind, matrix: sp.bsr_array) -> Factorisation:
    """Return the best one of this machine; CICATRIX_LINEAR_SOLVER = "scipy" or "pyamg" asks for what works without MKL."""
    asked = os.environ.get("CICATRIX_LINEAR_SOLVER")
    if MKL is not None and asked not in ("scipy", "pyamg"):
        return Pardiso(kind, matrix)
    is_large = matrix.shape[0] > LARGEST_SUPERLU and asked != "scipy"
    if pyamg is not None and kind == Kind.DEFINITE and (is_large or asked == "pyamg"):
        return Multigrid(matrix)
    return SuperLU(matrix)
