"""Cells and cytokine on a deforming body: diffusion, chemotaxis and haptotaxis between nodes, sources at nodes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jax import Array

from ..biology.turnover import Contents, Turnover
from ..core.law import Law, param
from ..mechanics.pattern import Pattern
from ..mechanics.space import AnySpace
from ..numerics.compiler import COMPILER
from ..numerics.factors import check_finite
from ..numerics.linear import gmres
from ..numerics.tensors import inv, right_cauchy_green

EXACT, MOST_STEPS = 1e-10, 300  # of a linear system: residual over right-hand side, and Krylov steps


class Mobility(Law):
    r"""How cells and cytokine move, on the reference configuration.

    .. math::
        Q_\rho &= -C^{-1} (D_\rho \nabla\rho + D_{\rho,c} \, \rho \nabla c + D_{\rho,\varphi} \, \rho \nabla\varphi) \\
        Q_c &= -D_c C^{-1} \nabla c

    Source: Guo, Mofrad & Buganza Tepole, Eq. (16), and docs/theory/wound.md, which the signs are from: cells go to where there is
    more cytokine, or collagen, where the second, or third, coefficient is negative.

    Parameters
    ----------
    D_rho, D_c : float [mm^2/s]
        Diffusivities.
    D_rho_c, D_rho_phi : float [mm^2/s]
        Of chemotaxis and haptotaxis.
    """

    D_rho: float = param("mm^2/s", "D_rho", low=0.0, default=0.0833 / 3600, typed="mm2/h")
    D_c: float = param("mm^2/s", "D_c", low=0.0, default=0.01208 / 3600, typed="mm2/h")
    D_rho_c: float = param("mm^2/s", "D_rho,c", default=0.0, typed="mm2/h")
    D_rho_phi: float = param("mm^2/s", "D_rho,phi", default=0.0, typed="mm2/h")


@dataclass(frozen=True, eq=False)
class Transport:
    """Where cells and cytokine are, and how much of them each node and element holds.

    They are linear between the corners of elements (bilinear in quadrilaterals). Storage and sources are lumped at the nodes, and
    what diffuses is limited where obtuse angles would draw it uphill (:func:`limited`): with sources that keep positive what is
    positive, so does an implicit Euler step; and what leaves a node arrives at its neighbours, to rounding.

    Parameters
    ----------
    space : AnySpace
        The body's elements.
    X : (n_nodes, 3) array [mm]
        Reference positions of its nodes.
    held : (m,) int array
        Nodes, of those that carry, where both fields keep the values that they have.
    """

    space: AnySpace
    X: np.ndarray
    held: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    @cached_property
    def carriers(self) -> np.ndarray:
        """Nodes of the body that carry (n,), ascending."""
        return np.unique(self.space.corners)

    @cached_property
    def cells(self) -> np.ndarray:
        """Carriers of each element (n_elements, a), by their place among the carriers."""
        return np.searchsorted(self.carriers, self.space.corners)

    @property
    def n(self) -> int:
        """Number of carriers."""
        return len(self.carriers)

    @cached_property
    def weights(self) -> np.ndarray:
        """Reference volume (a sheet's area) of each quadrature point (n_elements, n_qp) [mm^3, mm^2]."""
        return self._geometry[0]

    @cached_property
    def slopes(self) -> np.ndarray:
        """Gradient of each shape function (n_elements, n_qp, a, n_axes) [1/mm]."""
        return self._geometry[1]

    @cached_property
    def _geometry(self) -> tuple[np.ndarray, np.ndarray]:
        table, axes = self.space.corner_table, self.space.n_axes
        local = np.einsum("eai,qab->eqib", self.X[self.space.corners][..., :axes], table.gradient)
        slopes = np.einsum("qab,eqbi->eqai", table.gradient, np.linalg.inv(local))
        return table.weight * np.abs(np.linalg.det(local)), slopes

    @cached_property
    def volumes(self) -> np.ndarray:
        """Reference volume that each carrier stands for (n,) [mm^3, mm^2]."""
        return self.summed(np.einsum("eq,qa->ea", self.weights, self.space.corner_table.value))

    def summed(self, parts: np.ndarray) -> np.ndarray:
        """Sum parts of elements (n_elements, a) at the carriers (n,)."""
        return np.bincount(self.cells.ravel(), weights=np.asarray(parts).ravel(), minlength=self.n)

    def at_points(self, nodal: np.ndarray) -> np.ndarray:
        """Values (n,) at quadrature points (n_elements, n_qp)."""
        return np.asarray(nodal[self.cells] @ self.space.corner_table.value.T)

    def at_carriers(self, points: np.ndarray) -> np.ndarray:
        """Mean of what is about each carrier: (n_elements, n_qp) -> (n,)."""
        parts = np.einsum("eq,qa->ea", self.weights * points, self.space.corner_table.value)
        return self.summed(parts) / self.volumes

    def total(self, nodal: np.ndarray) -> float:
        """Integral over the reference body of a field (n,) [mm^3, mm^2]."""
        return float(self.volumes @ nodal)

    @cached_property
    def free(self) -> np.ndarray:
        """Carriers that are not held, ascending."""
        return np.setdiff1d(np.arange(self.n), self.held)

    @cached_property
    def pattern(self) -> Pattern:
        """Of matrices on the free carriers, cells and cytokine of a node side by side."""
        return Pattern([self.cells], self.free, self.n, components=2)

    def stiffness(self, F: np.ndarray) -> np.ndarray:
        """Integral of grad N_a . C^-1 grad N_b on a body deformed by F (n_elements, n_qp, 3, 3) -> (n_elements, a, a)."""
        return np.asarray(_stiffness(self.weights, self.slopes, F))

    def taxis(self, F: np.ndarray, cue: np.ndarray) -> np.ndarray:
        """Integral of grad N_a . C^-1 grad(cue) N_b, cue (n,) -> (n_elements, a, a): what carries cells along it."""
        return np.asarray(_taxis(self.weights, self.slopes, F, cue[self.cells], self.space.corner_table.value))


@dataclass(frozen=True, eq=False)
class Flow:
    """Cells and cytokine during a step: what moves them, and what makes them.

    Parameters
    ----------
    on : Transport
        Where.
    mobility : Mobility
        Coefficients.
    turnover : Turnover
        Sources.
    F : (n_elements, n_qp, 3, 3) array [1]
        Deformation at the end of the step.
    signal : (n,) array [1]
        H at the carriers.
    collagen : (n,) array [1]
        phi at the carriers; read if there is haptotaxis.
    """

    on: Transport
    mobility: Mobility
    turnover: Turnover
    F: np.ndarray
    signal: np.ndarray
    collagen: np.ndarray

    @cached_property
    def _stiffness(self) -> np.ndarray:
        return self.on.stiffness(self.F)

    @cached_property
    def _haptotaxis(self) -> np.ndarray | float:
        D = self.mobility.D_rho_phi
        return D * self.on.taxis(self.F, self.collagen) if D else 0.0

    def _moving(self, rho: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Matrices of what leaves each corner of each element (n_elements, a, a), of cells and cytokine."""
        m, cells = self.mobility, self.on.cells
        going = limited(m.D_rho * self._stiffness, rho[cells]) + self._haptotaxis
        if m.D_rho_c:
            going = going + m.D_rho_c * self.on.taxis(self.F, c)
        return going, limited(m.D_c * self._stiffness, c[cells])

    def leaving(self, rho: np.ndarray, c: np.ndarray) -> np.ndarray:
        """What leaves each carrier for its neighbours: (n,), (n,) -> (n, 2) [1/s, times its volume]."""
        both = zip(self._moving(rho, c), (rho, c))
        parts = [(moving @ values[self.on.cells][..., None])[..., 0] for moving, values in both]
        return np.stack([self.on.summed(part) for part in parts], axis=-1)

    def sources(self, rho: np.ndarray, c: np.ndarray) -> np.ndarray:
        """s_rho and s_c at the carriers: (n,), (n,) -> (n, 2) [1/s]."""
        return np.asarray(_sources(self.turnover, rho, c, self.signal))

    def residual(self, nodal: np.ndarray, start: np.ndarray, dt: float) -> np.ndarray:
        """Imbalance of an implicit Euler step: (n, 2), (n, 2) [1], dt [s] -> (n, 2) [1/s, times volume]."""
        rho, c = nodal.T
        stored = (nodal - start) / dt - self.sources(rho, c)
        return self.on.volumes[:, None] * stored + self.leaving(rho, c)

    def tangent(self, nodal: np.ndarray, dt: float) -> sp.bsr_array:
        """Derivative of the residual on the free carriers, limiters as they are."""
        rho, c = nodal.T
        K, m, on = self._stiffness, self.mobility, self.on
        blocks = np.zeros((*K.shape[:2], 3, K.shape[2], 3))  # of three components the pattern takes the first two
        blocks[:, :, 0, :, 0], blocks[:, :, 1, :, 1] = self._moving(rho, c)
        if m.D_rho_c:
            here = on.at_points(rho)
            blocks[:, :, 0, :, 1] += m.D_rho_c * np.asarray(_stiffness(on.weights * here, on.slopes, self.F))
        data = on.pattern.zeros()
        a = K.shape[1]
        on.pattern.add(data, 0, 0, blocks.reshape(-1, 3 * a, 3 * a))
        local = on.volumes[:, None, None] * (
            np.eye(2) / dt - np.asarray(_source_slopes(self.turnover, rho, c, self.signal))
        )
        on.pattern.add_diagonal(data, local[on.free])
        return on.pattern.matrix(data, np.zeros(on.pattern.n_dofs))

    def improved(self, nodal: np.ndarray, start: np.ndarray, dt: float) -> np.ndarray:
        """Fields (n, 2) after one iteration of Newton's method; raises FloatingPointError as :func:`solve`."""
        free, out = self.on.free, nodal.copy()
        wrong = self.residual(nodal, start, dt)[free]
        out[free] -= solve(self.tangent(nodal, dt), wrong.ravel()).reshape(-1, 2)
        return out


def limited(stiffness: np.ndarray, values: np.ndarray) -> np.ndarray:
    r"""Element matrices of diffusion (n_elements, a, a) that draw no more out of a node than a share of what it holds.

    Between nodes i and j of an obtuse angle the entry :math:`k_{ij}` is positive, and so what is at j draws on i. Only
    :math:`\min(u_i, u_j) / \max(u_i, u_j)` of it is left, the rest goes to the diagonal: rows and columns still add up to 0,
    fields that vary little are hardly changed, and the draw on i is below :math:`k_{ij} u_i`. Values (n_elements, a).
    """
    a = stiffness.shape[1]
    if not (stiffness[:, ~np.eye(a, dtype=bool)] > 0.0).any():
        return stiffness
    u = np.maximum(values, 0.0)
    low, high = np.minimum(u[:, :, None], u[:, None, :]), np.maximum(u[:, :, None], u[:, None, :])
    uphill = np.where(np.eye(a, dtype=bool), 0.0, np.maximum(stiffness, 0.0))
    away = (1.0 - low / np.maximum(high, 1e-300)) * uphill
    return stiffness - away + away.sum(axis=2)[..., None] * np.eye(a)


def solve(matrix: sp.bsr_array, rhs: np.ndarray) -> np.ndarray:
    """Solve a flow's linear system (n,) by generalised minimal residuals, the blocks of nodes as preconditioner.

    What is stored at a node outweighs what leaves it, unless steps are long for the elements, so a few iterations do.

    Raises
    ------
    FloatingPointError
        Where they do not, or the matrix is not finite.
    """
    check_finite(matrix)
    rows = np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))
    blocks = np.linalg.inv(matrix.data[rows == matrix.indices])

    def precondition(x: np.ndarray) -> np.ndarray:
        return np.einsum("nij,nj->ni", blocks, x.reshape(-1, 2)).ravel()

    if not rhs.any():
        return np.zeros_like(rhs)
    found, _ = gmres(matrix, rhs, precondition, EXACT, MOST_STEPS)
    if found is None:
        raise FloatingPointError(f"transport's linear system was not solved in {MOST_STEPS} steps")
    return found


def _metric(F: Array, axes: int) -> Array:
    """C^-1 in the axes of the elements (..., axes, axes)."""
    F = F[..., :axes, :axes]
    if axes == 2:
        C = [[jnp.sum(F[..., :, i] * F[..., :, j], axis=-1) for j in range(2)] for i in range(2)]
        whole = C[0][0] * C[1][1] - C[0][1] * C[1][0]
        rows = [C[1][1], -C[0][1], -C[1][0], C[0][0]]
        return jnp.stack([entry / whole for entry in rows], axis=-1).reshape(F.shape)
    return inv(right_cauchy_green(F))


@partial(jax.jit, compiler_options=COMPILER)
def _stiffness(weights: Array, slopes: Array, F: Array) -> Array:
    pulled = jnp.einsum("eqij,eqbj->eqbi", _metric(F, slopes.shape[-1]), slopes)
    return jnp.einsum("eq,eqai,eqbi->eab", weights, slopes, pulled)


@partial(jax.jit, compiler_options=COMPILER)
def _taxis(weights: Array, slopes: Array, F: Array, cue: Array, value: Array) -> Array:
    climb = jnp.einsum("eqij,eqbj,eb->eqi", _metric(F, slopes.shape[-1]), slopes, cue)
    return jnp.einsum("eq,eqai,eqi,qb->eab", weights, slopes, climb, value)


def _pair(turnover: Turnover, rho: Array, c: Array, signal: Array) -> Array:
    made = turnover.rates(Contents(rho, c, jnp.zeros_like(rho)), signal)
    return jnp.stack([made.rho, made.c], axis=-1)


_sources = jax.jit(_pair, compiler_options=COMPILER)


@partial(jax.jit, compiler_options=COMPILER)
def _source_slopes(turnover: Turnover, rho: Array, c: Array, signal: Array) -> Array:
    one, none = jnp.ones_like(rho), jnp.zeros_like(rho)
    columns = [
        jax.jvp(lambda r, k: _pair(turnover, r, k, signal), (rho, c), direction)[1]
        for direction in ((one, none), (none, one))
    ]
    return jnp.stack(columns, axis=-1)
