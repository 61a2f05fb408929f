"""Equations of equilibrium of a body about a trial shape, and their linearisation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from ..numerics.linear import LinearSolver
from .body import Body, VolumeRates
from .pullback import Pullback
from .supports import Supports

FD_STEP = 1e-6  # finite-difference step, relative to body size


@dataclass(frozen=True, eq=False)
class Problem:
    """Equations of equilibrium of a body, which determine its loaded shape from the unloaded one, or the reverse.

    Parameters
    ----------
    body : Body
        Tissue, skin, supports and pressure, the pressure at the current fraction of the load.
    X : (n_nodes, 3) array [mm]
        Positions in the known shape: the unloaded one, or the loaded one if ``inverse``.
    x : (n_nodes, 3) array [mm]
        Initial guess of the positions in the unknown shape.
    gravity, full : (3,) arrays [mm/s^2]
        Acceleration at the current fraction of the load, and at full load.
    residual_offset : (n_unknowns,) array [mN/mm] or 0
        Value that the residual must reach; it is reduced to zero in steps.
    inverse : bool
        If True, solve for the unloaded shape.
    other_loads_norm : float [mN]
        Norm of the loads other than gravity, at full load.
    """

    body: Body
    X: np.ndarray
    x: np.ndarray
    gravity: np.ndarray
    full: np.ndarray
    residual_offset: np.ndarray | float = 0.0
    inverse: bool = False
    other_loads_norm: float = 0.0

    @property
    def in_plane(self) -> bool:
        """True for a section without gravity along its normal, whose unknowns are the in-plane components only."""
        return self.body.discretization.space.n_axes == 2 and bool(self.full[2] == 0.0)

    @property
    def supports(self) -> Supports:
        """Map between the nodal degrees of freedom and the unknowns of the equations."""
        return self.body.discretization.supports(self.in_plane)

    def with_load_share(self, share: float, x: np.ndarray) -> Problem:
        """Return the problem under a fraction ``share`` of the loads, with initial guess x."""
        return replace(self, body=self.body.with_pressure_share(share), x=x, gravity=share * self.full)

    @property
    def pressure_load_norm(self) -> float:
        """Euclidean norm of the nodal forces that the pressure exerts on the known shape [mN]; 0 without pressure."""
        if self.body.pressure is None:
            return 0.0
        return float(np.linalg.norm(self.free_part(self.body.residual(self.X, self.X, np.zeros(3)))))

    def response(self, solver: LinearSolver, matrix: sp.bsr_array, pullback: Pullback) -> np.ndarray:
        """Return the first-order displacement from shape x per unit of load share, with the tangent there (n_nodes, 3) [mm]."""
        shapes, step = self.shapes(self.unknowns(self.x)), 1e-3
        body, gravity = self.body, self.full
        loads = [
            body.with_pressure_share(share).residual(*shapes, share * gravity, body.volume_ratio(*shapes))
            for share in (1.0 - step, 1.0)
        ]
        tangent = Tangent(matrix, VolumeRates.empty(0, 0, 0), pullback, self, None)
        return self.spread(tangent.solve(solver, self.free_part((loads[0] - loads[1]) / step), 1e-8))

    def directional_derivative(self, direction: np.ndarray) -> np.ndarray:
        """Return the directional derivative of the residual along ``direction`` (n_nodes, 3) [mm] -> (n_nodes, 3) [mN]."""
        step = FD_STEP * np.ptp(self.X, axis=0).max() / max(np.abs(direction).max(), 1e-300)
        there, back = (self.body.residual(self.X, self.x + s * direction, self.gravity) for s in (step, -step))
        return (there - back) / (2.0 * step)

    @cached_property
    def weight(self) -> float:
        """Euclidean norm of the nodal weights and other loads at full load [mN/mm], to which the residual is compared."""
        mass = self.body.lumped_mass(self.X)
        return float(np.hypot(np.linalg.norm(mass) * max(np.linalg.norm(self.full), 1.0), self.other_loads_norm))

    @cached_property
    def volume_ratios(self) -> np.ndarray:
        """Initial guess of J_bar: volume ratios of the shape x, clipped to near stress-free (n_elements, n_qp) [1]."""
        return self.body.initial_volume_ratio(*self._ordered(self.x))

    @cached_property
    def out_of_balance(self) -> np.ndarray:
        """Residual at the initial guess x, for the unknowns (n_unknowns,) [mN/mm]."""
        return self.free_part(self.body.residual(*self._ordered(self.x), self.gravity, self.volume_ratios))

    def positions(self, values: np.ndarray) -> np.ndarray:
        """Return the positions of all nodes from the unknowns: (n_unknowns,) -> (n_nodes, 3) [mm]."""
        return self.supports.positions(values, self.x)

    def unknowns(self, x: np.ndarray) -> np.ndarray:
        """Return the unknowns that correspond to positions x: (n_nodes, 3) [mm] -> (n_unknowns,)."""
        return self.supports.unknowns(x)

    def shapes(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the unloaded and the loaded positions from the unknowns: (n_unknowns,) -> two (n_nodes, 3) [mm]."""
        return self._ordered(self.positions(values))

    def _ordered(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (unknown, self.X) if self.inverse else (self.X, unknown)

    @property
    def is_symmetric(self) -> bool:
        """True if the tangent matrix is symmetric: the forces derive from a potential, and the loaded shape is the unknown."""
        return not self.inverse and self.body.has_potential

    def linearised(self, values: np.ndarray, J_bar: np.ndarray, damping: float = 0.0) -> Tangent:
        """Return the linearisation of the residual with respect to the unknown shape and the volume ratios J_bar.

        It is evaluated at the unknowns ``values`` (n_unknowns,) and J_bar (n_elements, n_qp) [1]; ``damping`` times the nodal
        mass is added to its diagonal if the loaded shape is the unknown.
        """
        shapes, in_plane = self.shapes(values), self.in_plane
        if self.inverse:
            matrix, rates = self.body.linearised_reference(*shapes, J_bar, self.gravity, in_plane=in_plane)
            pullback = Pullback.unloaded(self.body, *shapes)
        else:
            matrix, rates = self.body.linearised(*shapes, J_bar, in_plane=in_plane, damping=damping)
            pullback = Pullback.loaded(self.body, shapes[1])

        def near() -> sp.bsr_array:
            """Return the symmetric part of the tangent with respect to loaded positions, without pressure.

            Contact acts on the loaded shape: it has no part in the tangent where that shape is known.
            """
            body = replace(self.body, pressure=None, contact=None if self.inverse else self.body.contact)
            matrix, _ = body.linearised(*shapes, J_bar, in_plane=in_plane)
            if not body.has_potential:
                matrix = _symmetric_part(matrix)
            return self.pulled_back(matrix, Pullback.loaded(body, shapes[1]))

        return Tangent(self.pulled_back(matrix, pullback), rates, pullback, self, None if self.is_symmetric else near)

    def pulled_back(self, matrix: sp.bsr_array, pullback: Pullback) -> sp.bsr_array:
        """Return a matrix on the free degrees of freedom in the unknowns, after the change of variables."""
        return self.supports.matrix(pullback.matrix(matrix, self.body.discretization.free_nodes))

    def free_part(self, forces: np.ndarray) -> np.ndarray:
        """Restrict nodal forces to the unknowns, with 0 at nodes without tissue: (n_nodes, 3) -> (n_unknowns,)."""
        return self.supports.unknowns(np.where(self.body.active_nodes[:, None], forces, 0.0))

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Expand values of the unknowns to nodal vectors, with 0 in constrained components: (n_unknowns,) -> (n_nodes, 3)."""
        return self.supports.positions(values, np.zeros_like(self.X))


class Tangent(NamedTuple):
    """Linearised equations of equilibrium about a shape, in the variables of :class:`.pullback.Pullback`."""

    matrix: sp.bsr_array
    """Matrix of the linear system after the change of variables (n_unknowns, n_unknowns)."""
    rates: VolumeRates
    """Coupling of the positions to the volume ratios J_bar."""
    pullback: Pullback
    """Change of variables that gives ``matrix``."""
    problem: Problem
    near: Callable[[], sp.bsr_array] | None
    """Function that returns a symmetric matrix close to ``matrix``, for the preconditioner; None if ``matrix`` is symmetric."""

    def solve(self, solver: LinearSolver, forces: np.ndarray, tolerance: float) -> np.ndarray:
        """Solve K du = forces to a relative tolerance, with K in the original variables: forces, du (n_unknowns,)."""
        problem, (right, left) = self.problem, (self.pullback.right, self.pullback.left)
        rhs = problem.supports.unknowns((left @ problem.spread(forces)[..., None])[..., 0])
        found = solver.solve(self.matrix, rhs, tolerance, self.near)
        return problem.supports.unknowns((right @ problem.spread(found)[..., None])[..., 0])


def _symmetric_part(matrix: sp.bsr_array) -> sp.bsr_array:
    """Return the symmetric part of a matrix with symmetric sparsity pattern; the pattern is kept, with explicit zeros."""
    turned = sp.bsr_array(matrix.T, blocksize=matrix.blocksize)
    turned.sort_indices()
    return sp.bsr_array((0.5 * (matrix.data + turned.data), matrix.indices, matrix.indptr), shape=matrix.shape)
