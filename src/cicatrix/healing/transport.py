"""Transport of cells and cytokine in a deforming body: diffusion, chemotaxis, haptotaxis and sources, by finite elements."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jax import Array

from ..biology.turnover import Densities, Turnover
from ..core.law import Law, param
from ..mechanics.pattern import Pattern
from ..mechanics.space import AnySpace
from ..numerics.compiler import COMPILER
from ..numerics.factors import check_finite
from ..numerics.linear import gmres
from ..numerics.tensors import inv, right_cauchy_green

EXACT, MAX_KRYLOV_ITERATIONS = 1e-10, 300  # linear systems: relative residual and maximum number of Krylov iterations


class Mobility(Law):
    r"""Coefficients of the fluxes of cells and cytokine in the reference configuration.

    .. math::
        Q_\rho &= -C^{-1} (D_\rho \nabla\rho + D_{\rho,c} \, \rho \nabla c + D_{\rho,\varphi} \, \rho \nabla\varphi) \\
        Q_c &= -D_c C^{-1} \nabla c

    Source: Guo, Mofrad & Buganza Tepole, Eq. (16), with the signs of docs/theory/wound.md: cells move towards more cytokine if
    D_rho,c is negative, and towards more collagen if D_rho,phi is negative.

    Parameters
    ----------
    D_rho, D_c : float [mm^2/s]
        Diffusivities.
    D_rho_c, D_rho_phi : float [mm^2/s]
        Coefficients of chemotaxis and haptotaxis.
    """

    D_rho: float = param("mm^2/s", "D_rho", low=0.0, default=0.0833 / 3600, typed="mm2/h")
    D_c: float = param("mm^2/s", "D_c", low=0.0, default=0.01208 / 3600, typed="mm2/h")
    D_rho_c: float = param("mm^2/s", "D_rho,c", default=0.0, typed="mm2/h")
    D_rho_phi: float = param("mm^2/s", "D_rho,phi", default=0.0, typed="mm2/h")


@dataclass(frozen=True, eq=False)
class Transport:
    """Finite-element space of cells and cytokine, with its volumes and element matrices.

    The fields are linear between the vertices of elements (bilinear in quadrilaterals). Storage and sources are lumped at the
    nodes, and diffusion is limited where obtuse angles would cause flow from a node to a higher value (:func:`limited`). So an
    implicit Euler step keeps positive fields positive if the sources do, and transport conserves the totals to rounding.

    Parameters
    ----------
    space : AnySpace
        The body's elements.
    X : (n_nodes, 3) array [mm]
        Reference positions of the nodes of the body.
    fixed_vertices : (m,) int array
        Vertex nodes, as indices into ``vertex_nodes``, at which both fields keep their present values (Dirichlet condition).
    """

    space: AnySpace
    X: np.ndarray
    fixed_vertices: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    @cached_property
    def vertex_nodes(self) -> np.ndarray:
        """Vertex nodes of the elements, which carry the fields (n,), ascending."""
        return np.unique(self.space.corners)

    @cached_property
    def element_vertices(self) -> np.ndarray:
        """Vertex nodes of each element (n_elements, a), as indices into ``vertex_nodes``."""
        return np.searchsorted(self.vertex_nodes, self.space.corners)

    @property
    def n(self) -> int:
        """Number of vertex nodes."""
        return len(self.vertex_nodes)

    @cached_property
    def weights(self) -> np.ndarray:
        """Reference volume (area of a sheet) of each quadrature point (n_elements, n_qp) [mm^3, mm^2]."""
        return self._geometry[0]

    @cached_property
    def slopes(self) -> np.ndarray:
        """Gradients of the linear shape functions at the quadrature points (n_elements, n_qp, a, n_axes) [1/mm]."""
        return self._geometry[1]

    @cached_property
    def _geometry(self) -> tuple[np.ndarray, np.ndarray]:
        table, axes = self.space.corner_table, self.space.n_axes
        local = np.einsum("eai,qab->eqib", self.X[self.space.corners][..., :axes], table.gradient)
        slopes = np.einsum("qab,eqbi->eqai", table.gradient, np.linalg.inv(local))
        return table.weight * np.abs(np.linalg.det(local)), slopes

    @cached_property
    def volumes(self) -> np.ndarray:
        """Lumped reference volume (area of a sheet) of each vertex node (n,) [mm^3, mm^2]."""
        return self.summed(np.einsum("eq,qa->ea", self.weights, self.space.corner_table.value))

    def summed(self, parts: np.ndarray) -> np.ndarray:
        """Sum element contributions (n_elements, a) at the vertex nodes (n,)."""
        return np.bincount(self.element_vertices.ravel(), weights=np.asarray(parts).ravel(), minlength=self.n)

    def at_points(self, nodal: np.ndarray) -> np.ndarray:
        """Interpolate nodal values (n,) to the quadrature points (n_elements, n_qp)."""
        return np.asarray(nodal[self.element_vertices] @ self.space.corner_table.value.T)

    def at_vertices(self, points: np.ndarray) -> np.ndarray:
        """Average values at quadrature points around each vertex node: (n_elements, n_qp) -> (n,)."""
        parts = np.einsum("eq,qa->ea", self.weights * points, self.space.corner_table.value)
        return self.summed(parts) / self.volumes

    def total(self, nodal: np.ndarray) -> float:
        """Return the integral of a nodal field (n,) over the reference body, in the field's unit times mm^3 (mm^2 in a sheet)."""
        return float(self.volumes @ nodal)

    @cached_property
    def free(self) -> np.ndarray:
        """Vertex nodes whose values are not prescribed, as indices into ``vertex_nodes``, ascending."""
        return np.setdiff1d(np.arange(self.n), self.fixed_vertices)

    @cached_property
    def pattern(self) -> Pattern:
        """Sparsity pattern of matrices on the free vertex nodes, with a 2 x 2 block of cells and cytokine per node pair."""
        return Pattern([self.element_vertices], self.free, self.n, components=2)

    def stiffness(self, F: np.ndarray) -> np.ndarray:
        """Integrate grad N_a . C^-1 grad N_b over each element, deformed by F (n_elements, n_qp, 3, 3) -> (n_elements, a, a)."""
        return np.asarray(_stiffness(self.weights, self.slopes, F))

    def taxis(self, F: np.ndarray, cue: np.ndarray) -> np.ndarray:
        """Return element matrices of taxis along a field ``cue`` (n,) in a body deformed by F (n_elements, n_qp, 3, 3).

        Integrals of grad N_a . C^-1 grad(cue) N_b -> (n_elements, a, a).
        """
        return np.asarray(
            _taxis(self.weights, self.slopes, F, cue[self.element_vertices], self.space.corner_table.value)
        )


@dataclass(frozen=True, eq=False)
class Flow:
    """Transport equations of cells and cytokine in one implicit Euler step: residual, tangent and Newton step.

    Parameters
    ----------
    on : Transport
        Finite-element space.
    mobility : Mobility
        Diffusion and taxis coefficients.
    turnover : Turnover
        Source terms.
    F : (n_elements, n_qp, 3, 3) array [1]
        Deformation gradient at the end of the step.
    signal : (n,) array [1]
        Mechanical signal H at the vertex nodes.
    collagen : (n,) array [1]
        Collagen phi at the vertex nodes; used only if there is haptotaxis.
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

    def _outflow_matrices(self, rho: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the element matrices of the outflow from each vertex (n_elements, a, a), for cells and for cytokine."""
        m, vertices = self.mobility, self.on.element_vertices
        going = limited(m.D_rho * self._stiffness, rho[vertices]) + self._haptotaxis
        if m.D_rho_c:
            going = going + m.D_rho_c * self.on.taxis(self.F, c)
        return going, limited(m.D_c * self._stiffness, c[vertices])

    def outflux(self, rho: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Return the net outflow from each vertex node to its neighbours: (n,), (n,) -> (n, 2) [1/s times nodal volume]."""
        both = zip(self._outflow_matrices(rho, c), (rho, c))
        parts = [(moving @ values[self.on.element_vertices][..., None])[..., 0] for moving, values in both]
        return np.stack([self.on.summed(part) for part in parts], axis=-1)

    def sources(self, rho: np.ndarray, c: np.ndarray) -> np.ndarray:
        """Return the source terms s_rho and s_c at the vertex nodes: (n,), (n,) -> (n, 2) [1/s]."""
        return np.asarray(_sources(self.turnover, rho, c, self.signal))

    def residual(self, nodal: np.ndarray, start: np.ndarray, dt: float) -> np.ndarray:
        """Return the residual of an implicit Euler step: (n, 2), (n, 2) [1], dt [s] -> (n, 2) [1/s times nodal volume]."""
        rho, c = nodal.T
        stored = (nodal - start) / dt - self.sources(rho, c)
        return self.on.volumes[:, None] * stored + self.outflux(rho, c)

    def tangent(self, nodal: np.ndarray, dt: float) -> sp.bsr_array:
        """Return the derivative of the residual on the free vertex nodes, with the limiter factors frozen."""
        rho, c = nodal.T
        K, m, on = self._stiffness, self.mobility, self.on
        blocks = np.zeros((*K.shape[:2], 3, K.shape[2], 3))  # the pattern uses the first two of three components
        blocks[:, :, 0, :, 0], blocks[:, :, 1, :, 1] = self._outflow_matrices(rho, c)
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

    def newton_step(self, nodal: np.ndarray, start: np.ndarray, dt: float) -> np.ndarray:
        """Return the fields (n, 2) after one Newton iteration; raises FloatingPointError as :func:`solve` does."""
        free, out = self.on.free, nodal.copy()
        wrong = self.residual(nodal, start, dt)[free]
        out[free] -= solve(self.tangent(nodal, dt), wrong.ravel()).reshape(-1, 2)
        return out


def limited(stiffness: np.ndarray, values: np.ndarray) -> np.ndarray:
    r"""Limit the element matrices of diffusion (n_elements, a, a) so that an implicit step cannot make a field negative.

    With an obtuse angle in the element, an off-diagonal entry :math:`k_{ij}` can be positive; then a positive value at node j
    lowers the value at node i, possibly below 0. Only the fraction :math:`\min(u_i, u_j) / \max(u_i, u_j)` of such an entry is
    kept, and the rest is added to the diagonal. Rows and columns still sum to 0, smooth fields hardly change, and the term
    :math:`k_{ij} u_j` becomes at most :math:`k_{ij} u_i`. ``values``: u (n_elements, a).
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
    """Solve a linear system of transport (n,) by GMRES with a block-Jacobi preconditioner (one 2 x 2 block per node).

    Unless the time step is long for the size of the elements, storage dominates transport, and a few iterations suffice.

    Raises
    ------
    FloatingPointError
        If the iteration does not converge, or the matrix is not finite.
    """
    check_finite(matrix)
    rows = np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))
    blocks = np.linalg.inv(matrix.data[rows == matrix.indices])

    def precondition(x: np.ndarray) -> np.ndarray:
        return np.einsum("nij,nj->ni", blocks, x.reshape(-1, 2)).ravel()

    if not rhs.any():
        return np.zeros_like(rhs)
    found, _ = gmres(matrix, rhs, precondition, EXACT, MAX_KRYLOV_ITERATIONS)
    if found is None:
        raise FloatingPointError(
            f"the linear system of transport did not converge in {MAX_KRYLOV_ITERATIONS} GMRES iterations"
        )
    return found


def _metric(F: Array, axes: int) -> Array:
    """Return C^-1 in the first ``axes`` coordinates at a deformation gradient F (..., 3, 3): (..., axes, axes) [1]."""
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
    made = turnover.rates(Densities(rho, c, jnp.zeros_like(rho)), signal)
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
