"""PETSc solvers for linear systems distributed over ranks: Krylov methods with MUMPS or algebraic multigrid."""

from __future__ import annotations

import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ctypes import byref, c_double, c_int, c_ssize_t, c_void_p
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Literal

import numpy as np
import scipy.sparse as sp

from ..core.ranks import Ranks
from .factors import MatrixType
from .petsc import INSERT, Petsc, petsc

Method = Literal["mumps", "gamg"]
Krylov = Literal["cg", "gmres"]
DIVERGED_BY_STEPS, DIVERGED_INDEFINITE = -3, -10  # KSP_DIVERGED_ITS, KSP_DIVERGED_INDEFINITE_MAT
SYMMETRIC_OPTION = 1  # MAT_SYMMETRIC

CONJUGATE_GRADIENTS = {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned"}
MINIMAL_RESIDUALS = {"ksp_type": "gmres", "ksp_gmres_restart": 20, "ksp_pc_side": "right"}
MUMPS = {
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_24": 1,  # detect zero pivots
}
GAMG = {
    "pc_type": "gamg",
    "pc_gamg_type": "agg",
    "pc_gamg_threshold": 0.01,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 4,
    "mg_levels_pc_type": "jacobi",
    "mg_levels_esteig_ksp_type": "cg",
}


@dataclass(frozen=True, eq=False)
class Layout:
    """Distribution of the block rows of a matrix over ranks.

    Parameters
    ----------
    ranks : Ranks
        Ranks that solve together.
    owners : (n,) int array
        Rank that owns each block row.
    positions : (n, 3) array [mm]
        Positions of the nodes of the block rows, from which multigrid computes its near-null space (rigid-body modes).
    """

    ranks: Ranks
    owners: np.ndarray
    positions: np.ndarray | None = None

    @cached_property
    def order(self) -> np.ndarray:
        """Indices of the block rows, sorted by the rank that owns them (n,)."""
        return np.argsort(self.owners, kind="stable")

    @cached_property
    def number(self) -> np.ndarray:
        """Position of each block row in ``order`` (n,)."""
        out = np.empty(self.owners.size, int)
        out[self.order] = np.arange(out.size)
        return out

    @cached_property
    def own(self) -> np.ndarray:
        """Indices of the block rows that this rank owns (n_own,), in the order of ``order``."""
        return self.order[self.owners[self.order] == self.ranks.rank]

    def collect(self, own: np.ndarray) -> np.ndarray:
        """Gather the values of all block rows on every rank, from those of the rows that each rank owns: (n_own, b) -> (n, b)."""
        parts = [np.frombuffer(part) for part in self.ranks.gather(own.tobytes())]
        return np.concatenate(parts).reshape(-1, own.shape[1])[self.number]


@dataclass
class PetscEngine:
    """PETSc back end of :class:`.linear.LinearSolver` on the ranks of a layout.

    All methods are collective. The matrix is the sum of the contributions of all ranks; right-hand sides and solutions are
    complete on every rank.

    Parameters
    ----------
    layout : Layout, optional
        Distribution over ranks; by default this process alone.
    method : {"mumps", "gamg"}
        Direct factorisation, or smoothed-aggregation multigrid (with MUMPS for indefinite matrices).
    """

    layout: Layout | None = None
    method: Method = "mumps"
    library: Petsc = field(default_factory=petsc)

    def factorisation(self, matrix_type: MatrixType, matrix: sp.bsr_array) -> PetscSystem:  # noqa: D102
        layout = self.layout or Layout(Ranks(), np.zeros(matrix.shape[0] // matrix.blocksize[0], int))
        options = GAMG if self.method == "gamg" and matrix_type == MatrixType.DEFINITE else MUMPS
        return PetscSystem(self.library, layout, matrix_type, options, matrix)

    def iterate(  # noqa: D102
        self,
        factor: PetscSystem,
        method: Krylov,
        matrix: sp.bsr_array,
        rhs: np.ndarray,
        tolerance: float,
        max_iterations: int,
        slowest: float = np.inf,
    ) -> tuple[np.ndarray | None, int]:
        return factor.iterate(method, matrix, rhs, tolerance, max_iterations)

    def release(self, methods: Sequence[PetscSystem]) -> None:  # noqa: D102
        for method in methods:
            method.close()


class PetscSystem:
    """Distributed matrix with Krylov solvers and a preconditioner; like ``Pardiso`` both a ``Factorisation`` and a ``Factor``."""

    refactor_cost = -1.0  # always refactorise: the extra iterations with an old factor need many messages between ranks

    def __init__(
        self,
        library: Petsc,
        layout: Layout,
        matrix_type: MatrixType,
        preconditioner: dict[str, str | float],
        matrix: sp.bsr_array,
    ) -> None:
        self._petsc, self._layout, self.matrix_type = library, layout, matrix_type
        self._preconditioner = preconditioner
        self._block = matrix.blocksize[0]
        self._comm = library.communicator(layout.ranks)
        self.n_negative: int | None = None
        self.values = np.zeros(0)
        self._loaded = lambda: None
        self._make_matrix(matrix)
        if self._is_multigrid and layout.positions is not None:
            self._keep_rigid_motions(layout.positions)
        self._cg = self._make_solver("cg", CONJUGATE_GRADIENTS, None)
        self._gmres = self._make_solver("gmres", MINIMAL_RESIDUALS, self._cg)
        handles = [
            ("KSPDestroy", self._gmres),
            ("KSPDestroy", self._cg),
            ("VecDestroy", self._x),
            ("VecDestroy", self._b),
            ("MatDestroy", self._matrix),
        ]
        self._end = weakref.finalize(self, _destroy, library, handles)
        if layout.ranks.size > 1:  # destruction is collective, so it cannot be left to each rank's garbage collection
            self._end.detach()
            self._end = partial(_destroy, library, handles)

    def close(self) -> None:
        """Free PETSc's memory (collective); the object cannot be used afterwards."""
        self._end()

    def _make_matrix(self, matrix: sp.bsr_array) -> None:
        """Create the matrix: distribute its rows and register the row and column of each entry of this rank's contribution."""
        call, integer, block = self._petsc.call, self._petsc.integer, self._block
        n_own, n = block * self._layout.own.size, matrix.shape[0]
        self._matrix = self._petsc.new("MatCreate", self._comm)
        call("MatSetSizes", self._matrix, *map(integer, (n_own, n_own, n, n)))
        call("MatSetBlockSize", self._matrix, integer(block))
        call("MatSetType", self._matrix, b"aij")
        rows = np.repeat(np.arange(n // block), np.diff(matrix.indptr))
        places = [block * self._layout.number[nodes] for nodes in (rows, matrix.indices)]
        k = np.arange(block)
        i, j = (places[0][:, None, None] + k[:, None]), (places[1][:, None, None] + k[None, :])
        i, j = (np.ascontiguousarray(np.broadcast_to(m, matrix.data.shape), self._petsc.int_type) for m in (i, j))
        call("MatSetPreallocationCOO", self._matrix, c_ssize_t(i.size), _at(i), _at(j))
        call("MatSetOption", self._matrix, c_int(SYMMETRIC_OPTION), c_int(1))  # the factorised matrix is symmetric
        self._x, self._b = c_void_p(), c_void_p()
        call("MatCreateVecs", self._matrix, byref(self._x), byref(self._b))

    def _make_solver(self, name: str, krylov: dict[str, str | float], beside: c_void_p | None) -> c_void_p:
        """Create a Krylov solver with a new preconditioner, or, if ``beside`` is given, with the preconditioner that exists."""
        call = self._petsc.call
        prefix = f"cicatrix_{self._preconditioner['pc_type']}_{self.matrix_type.name.lower()}_{name}_"
        ksp = self._petsc.new("KSPCreate", self._comm)
        if beside is not None:
            call("KSPSetPC", ksp, self._conditioner)
        self._petsc.set_options({**krylov, **self._preconditioner}, prefix)
        call("KSPSetOptionsPrefix", ksp, prefix.encode())
        call("KSPSetOperators", ksp, self._matrix, self._matrix)
        call("KSPSetFromOptions", ksp)
        return ksp

    @property
    def _conditioner(self) -> c_void_p:
        """Preconditioner shared by both Krylov methods."""
        out = c_void_p()
        self._petsc.call("KSPGetPC", self._cg, byref(out))
        return out

    @property
    def max_iterations(self) -> int:
        """Maximum number of Krylov iterations; a solve that needs more has failed."""
        return 1000 if self._is_multigrid else 60

    @property
    def _is_multigrid(self) -> bool:
        return self._preconditioner["pc_type"] == "gamg"

    def _keep_rigid_motions(self, positions: np.ndarray) -> None:
        call, integer = self._petsc.call, self._petsc.integer
        own = np.ascontiguousarray(positions[self._layout.own, : self._block])
        places = self._petsc.new("VecDuplicate", self._x)
        call("VecSetBlockSize", places, integer(self._block))
        self._fill(places, own)
        motions = self._petsc.new("MatNullSpaceCreateRigidBody", places)
        call("MatSetNearNullSpace", self._matrix, motions)
        call("MatNullSpaceDestroy", byref(motions))
        call("VecDestroy", byref(places))

    def factor(self, matrix: sp.bsr_array) -> PetscSystem:
        """Set up the preconditioner; raises FloatingPointError if the matrix is singular, not finite or not definite."""
        return self.from_values(matrix.data.reshape(-1), matrix)

    def from_values(self, values: np.ndarray, matrix: sp.bsr_array | None = None) -> PetscSystem:
        """Set up the preconditioner from stored matrix entries, this rank's contribution; raises as ``factor``."""
        finite = [part == b"1" for part in self._layout.ranks.gather(b"1" if np.isfinite(values).all() else b"0")]
        if not all(finite):
            raise FloatingPointError("the matrix holds numbers that are not finite")
        self.values = values
        self._load(values, matrix)
        self._petsc.call("PCSetReusePreconditioner", self._conditioner, c_int(0))
        self._petsc.call("PCSetUp", self._conditioner)
        self._petsc.call("PCSetReusePreconditioner", self._conditioner, c_int(1))
        if not self._is_multigrid:
            self._check_factor()
        return self

    def _load(self, values: np.ndarray, matrix: sp.bsr_array | None) -> None:
        if matrix is not None and self._loaded() is matrix:
            return
        values = np.ascontiguousarray(values, float)
        self._petsc.call("MatSetValuesCOO", self._matrix, _at(values), c_int(INSERT))
        self._petsc.call("PCSetOperators", self._conditioner, self._matrix, self._matrix)
        self._loaded = weakref.ref(matrix) if matrix is not None else lambda: None

    def _check_factor(self) -> None:
        reason = c_int()
        self._petsc.call("PCGetFailedReason", self._conditioner, byref(reason))
        if reason.value:
            raise FloatingPointError("MUMPS finds the matrix singular")
        factor, counts = c_void_p(), [self._petsc.integer(0) for _ in range(3)]
        self._petsc.call("PCFactorGetMatrix", self._conditioner, byref(factor))
        self._petsc.call("MatGetInertia", factor, *map(byref, counts))
        self.n_negative = counts[0].value
        if counts[1].value:
            raise FloatingPointError("MUMPS finds the matrix singular")
        if self.n_negative and self.matrix_type == MatrixType.DEFINITE:
            raise FloatingPointError("a pivot is not positive")

    def iterate(
        self, method: Krylov, matrix: sp.bsr_array, rhs: np.ndarray, tolerance: float, max_iterations: int
    ) -> tuple[np.ndarray | None, int]:
        """Solve K x = b to |b - K x| <= tolerance |b|; return x (None if not reached) and the number of iterations."""
        call, ksp = self._petsc.call, self._cg if method == "cg" else self._gmres
        self._load(matrix.data.reshape(-1), matrix)
        self._fill(self._b, rhs.reshape(-1, self._block)[self._layout.own])
        bounds = c_double(tolerance), c_double(0.0), c_double(1e12)
        call("KSPSetTolerances", ksp, *bounds, self._petsc.integer(max_iterations))
        call("KSPSolve", ksp, self._b, self._x)
        reason, steps = c_int(), self._petsc.integer(0)
        call("KSPGetConvergedReason", ksp, byref(reason))
        call("KSPGetIterationNumber", ksp, byref(steps))
        taken = steps.value - (reason.value == DIVERGED_INDEFINITE)
        return (self._solution() if reason.value > 0 else None), taken

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Apply the preconditioner: (n,) -> (n,) float64."""
        self._fill(self._b, rhs.reshape(-1, self._block)[self._layout.own])
        self._petsc.call("PCApply", self._conditioner, self._b, self._x)
        return self._solution()

    def _fill(self, vector: c_void_p, own: np.ndarray) -> None:
        """Copy this rank's values (n_own, b) into a PETSc vector."""
        with self._memory(vector) as values:
            values[:] = own.reshape(-1)

    def _solution(self) -> np.ndarray:
        with self._memory(self._x) as values:
            own = values.reshape(-1, self._block)
            return self._layout.collect(own).reshape(-1)

    @contextmanager
    def _memory(self, vector: c_void_p) -> Iterator[np.ndarray]:
        """Yield this rank's part of a PETSc vector as an array (n_own b,) that shares its memory."""
        at, n = c_void_p(), self._layout.own.size * self._block
        self._petsc.call("VecGetArray", vector, byref(at))
        yield np.ctypeslib.as_array((c_double * n).from_address(at.value)) if n else np.zeros(0)
        self._petsc.call("VecRestoreArray", vector, byref(at))


def _at(array: np.ndarray) -> c_void_p:
    return array.ctypes.data_as(c_void_p)


def _destroy(library: Petsc, handles: list[tuple[str, c_void_p]]) -> None:
    for name, handle in handles if library.is_open else ():
        library.call(name, byref(handle))
