"""Linear systems whose matrix is summed over ranks, by PETSc: Krylov methods with MUMPS or algebraic multigrid."""

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
from .factors import Kind
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
    "mat_mumps_icntl_24": 1,  # tells of pivots that are zero
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
    """Which rank has which rows of a matrix of blocks.

    Parameters
    ----------
    ranks : Ranks
        Who solves together.
    owners : (n,) int array
        Rank that has each block of rows.
    positions : (n, 3) array [mm]
        Where the nodes are whose displacements these are: rigid-body motions, which multigrid must not lose, follow.
    """

    ranks: Ranks
    owners: np.ndarray
    positions: np.ndarray | None = None

    @cached_property
    def order(self) -> np.ndarray:
        """Blocks, those of the first rank first (n,)."""
        return np.argsort(self.owners, kind="stable")

    @cached_property
    def number(self) -> np.ndarray:
        """Place of each block in that order (n,)."""
        out = np.empty(self.owners.size, int)
        out[self.order] = np.arange(out.size)
        return out

    @cached_property
    def own(self) -> np.ndarray:
        """Blocks of this rank, in that order."""
        return self.order[self.owners[self.order] == self.ranks.rank]

    def collect(self, own: np.ndarray) -> np.ndarray:
        """All ranks' numbers from each one's own (n_own, b) -> (n, b)."""
        parts = [np.frombuffer(part) for part in self.ranks.gather(own.tobytes())]
        return np.concatenate(parts).reshape(-1, own.shape[1])[self.number]


@dataclass
class PetscEngine:
    """PETSc's solvers for :class:`.linear.LinearSolver`, on the ranks of a layout.

    Every rank calls all methods alike. A matrix is the sum of those that the ranks give; right-hand sides and solutions
    are whole on every rank.

    Parameters
    ----------
    layout : Layout, optional
        This process alone unless given.
    method : {"mumps", "gamg"}
        A direct factorisation, or smoothed aggregation (then MUMPS serves what is indefinite).
    """

    layout: Layout | None = None
    method: Method = "mumps"
    library: Petsc = field(default_factory=petsc)

    def factorisation(self, kind: Kind, matrix: sp.bsr_array) -> PetscSystem:  # noqa: D102
        layout = self.layout or Layout(Ranks(), np.zeros(matrix.shape[0] // matrix.blocksize[0], int))
        options = GAMG if self.method == "gamg" and kind == Kind.DEFINITE else MUMPS
        return PetscSystem(self.library, layout, kind, options, matrix)

    def iterate(  # noqa: D102
        self,
        factor: PetscSystem,
        method: Krylov,
        matrix: sp.bsr_array,
        rhs: np.ndarray,
        tolerance: float,
        most_steps: int,
        slowest: float = np.inf,
    ) -> tuple[np.ndarray | None, int]:
        return factor.iterate(method, matrix, rhs, tolerance, most_steps)

    def release(self, methods: Sequence[PetscSystem]) -> None:  # noqa: D102
        for method in methods:
            method.close()


class PetscSystem:
    """A matrix over ranks, a Krylov method and its preconditioner; factorisation and factor in one, as PARDISO's."""

    price = -1.0  # each matrix gets its own: many solves with an old one mean many messages between ranks

    def __init__(
        self, library: Petsc, layout: Layout, kind: Kind, preconditioner: dict[str, str | float], matrix: sp.bsr_array
    ) -> None:
        self._petsc, self._layout, self.kind = library, layout, kind
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
        if layout.ranks.size > 1:  # all would have to forget at the same moment
            self._end.detach()
            self._end = partial(_destroy, library, handles)

    def close(self) -> None:
        """Let PETSc's memory go; all ranks alike. It is of no use afterwards."""
        self._end()

    def _make_matrix(self, matrix: sp.bsr_array) -> None:
        """Rows to ranks, and where each entry of this rank's blocks goes, wherever that is."""
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
        call("MatSetOption", self._matrix, c_int(SYMMETRIC_OPTION), c_int(1))  # of what is factorised
        self._x, self._b = c_void_p(), c_void_p()
        call("MatCreateVecs", self._matrix, byref(self._x), byref(self._b))

    def _make_solver(self, name: str, krylov: dict[str, str | float], beside: c_void_p | None) -> c_void_p:
        """A Krylov method with a preconditioner of its own, or that of the one beside it."""
        call = self._petsc.call
        prefix = f"cicatrix_{self._preconditioner['pc_type']}_{self.kind.name.lower()}_{name}_"
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
        """The preconditioner that both methods share."""
        out = c_void_p()
        self._petsc.call("KSPGetPC", self._cg, byref(out))
        return out

    @property
    def most_steps(self) -> int:
        """Krylov steps after which it is no good."""
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
        """Set the preconditioner up; raises FloatingPointError where the matrix is singular, not finite or not definite."""
        return self.again(matrix.data.reshape(-1), matrix)

    def again(self, values: np.ndarray, matrix: sp.bsr_array | None = None) -> PetscSystem:
        """The preconditioner that was made of these numbers of this rank."""
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
        if self.n_negative and self.kind == Kind.DEFINITE:
            raise FloatingPointError("a pivot is not positive")

    def iterate(
        self, method: Krylov, matrix: sp.bsr_array, rhs: np.ndarray, tolerance: float, most_steps: int
    ) -> tuple[np.ndarray | None, int]:
        """Solve to |b - K x| <= tolerance |b|: the solution, or None where it is not reached, and the steps taken."""
        call, ksp = self._petsc.call, self._cg if method == "cg" else self._gmres
        self._load(matrix.data.reshape(-1), matrix)
        self._fill(self._b, rhs.reshape(-1, self._block)[self._layout.own])
        bounds = c_double(tolerance), c_double(0.0), c_double(1e12)
        call("KSPSetTolerances", ksp, *bounds, self._petsc.integer(most_steps))
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
        """Give a vector this rank's numbers (n_own, b)."""
        with self._memory(vector) as values:
            values[:] = own.reshape(-1)

    def _solution(self) -> np.ndarray:
        with self._memory(self._x) as values:
            own = values.reshape(-1, self._block)
            return self._layout.collect(own).reshape(-1)

    @contextmanager
    def _memory(self, vector: c_void_p) -> Iterator[np.ndarray]:
        """A vector's numbers on this rank, where PETSc has them (n_own b,)."""
        at, n = c_void_p(), self._layout.own.size * self._block
        self._petsc.call("VecGetArray", vector, byref(at))
        yield np.ctypeslib.as_array((c_double * n).from_address(at.value)) if n else np.zeros(0)
        self._petsc.call("VecRestoreArray", vector, byref(at))


def _at(array: np.ndarray) -> c_void_p:
    return array.ctypes.data_as(c_void_p)


def _destroy(library: Petsc, handles: list[tuple[str, c_void_p]]) -> None:
    for name, handle in handles if library.is_open else ():
        library.call(name, byref(handle))
