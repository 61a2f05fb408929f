"""Projection for a changing set of constrained nodes (contact) that keeps the sparsity pattern of the matrix fixed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from ..core.native import turn_blocks
from .body import Discretization


class ContactProjection:
    r"""Projection on the directions left free by the current constraints of sliding nodes and of nodes in contact with plates.

    With the normals n of all constraints at a node, :math:`S = \sum n n^T` and its pseudo-inverse :math:`S^+`, the matrix
    :math:`P = I - S S^+` projects on the unconstrained directions, and :math:`n \cdot S^+ r` is the component of a force r
    carried by the constraint n. The reduced matrix :math:`P K P + c (I - P)` has the same pattern for any set of contacts.

    Parameters
    ----------
    discretization : Discretization
        Discretisation; its fixed nodes are eliminated, its sliding nodes constrained along their directions.
    normals : (n_plates, 3) array [1]
        Unit normals of the plates, towards the body.
    in_contact : (n_plates, n_nodes) bool array
        True for nodes in contact with each plate.
    """

    def __init__(self, discretization: Discretization, normals: np.ndarray, in_contact: np.ndarray) -> None:
        self._discretization, self._free = discretization, discretization.solved(False)[0]
        self._normals, self._in_contact = normals, in_contact
        S = np.einsum("pn,pi,pj->nij", in_contact.astype(float), self._normals, self._normals)
        np.add.at(
            S,
            discretization.sliding_nodes,
            np.einsum("ni,nj->nij", discretization.sliding_normals, discretization.sliding_normals),
        )
        self._nodes = np.flatnonzero(S.any(axis=(1, 2)))
        self._inverse = np.zeros_like(S)
        self._inverse[self._nodes] = np.linalg.pinv(S[self._nodes], rcond=1e-6, hermitian=True)
        self._P = np.broadcast_to(np.eye(3), S.shape).copy()
        self._P[self._nodes] -= S[self._nodes] @ self._inverse[self._nodes]

    def constrained_displacement(self, targets: Sequence[np.ndarray], back: np.ndarray) -> np.ndarray:
        """Return the displacement that satisfies the constraints (n_nodes, 3) [mm].

        ``targets`` has an array (n_nodes,) [mm] for each plate: the displacements of its nodes in contact along its normal.
        Sliding nodes move by the component of ``back`` (n_nodes, 3) [mm] along their constrained directions.
        """
        along = np.einsum("pn,pi->ni", np.where(self._in_contact, targets, 0.0), self._normals)
        nodes, normals = self._discretization.sliding_nodes, self._discretization.sliding_normals
        np.add.at(along, nodes, np.sum(normals * back[nodes], axis=1)[:, None] * normals)
        return np.einsum("nij,nj->ni", self._inverse, along)

    def contact_forces(self, r: np.ndarray) -> np.ndarray:
        """Return the contact forces along the plates' normals that balance r: (n_nodes, 3) [mN] -> (n_plates, n_nodes) [mN]."""
        return np.where(self._in_contact, np.einsum("pi,nij,nj->pn", self._normals, self._inverse, r), 0.0)

    def free_part(self, r: np.ndarray) -> np.ndarray:
        """Return the unconstrained components of forces (n_nodes, 3) -> (n_free,)."""
        return self.project(self.on_free(r))

    def on_free(self, vectors: np.ndarray) -> np.ndarray:
        """Restrict nodal vectors to the free degrees of freedom: (n_nodes, 3) -> (n_free,)."""
        return vectors.reshape(-1)[self._free]

    def from_free(self, values: np.ndarray) -> np.ndarray:
        """Expand values of the free degrees of freedom, with 0 at fixed nodes: (n_free,) -> (n_nodes, 3)."""
        out = np.zeros(self._P.shape[:2])
        out.reshape(-1)[self._free] = values
        return out

    def project(self, values: np.ndarray) -> np.ndarray:
        """Apply P, which sets constrained components to 0: (n_free,) -> (n_free,)."""
        return np.einsum("nij,nj->ni", self._P[self._discretization.free_nodes], values.reshape(-1, 3)).reshape(-1)

    def matrix(self, matrix: sp.bsr_array) -> sp.bsr_array:
        """Return the reduced matrix P K P + c (I - P) for K (n_free, n_free), with c the mean of the diagonal of K."""
        nodes = self._discretization.free_nodes
        rows = np.repeat(np.arange(nodes.size), np.diff(matrix.indptr))
        P, data = self._P[nodes], matrix.data.copy()
        turn_blocks(data, matrix.indptr, matrix.indices, P, P)
        is_constrained = np.isin(nodes, self._nodes)
        on = np.flatnonzero((rows == matrix.indices) & is_constrained[rows])
        data[on] += matrix.diagonal().mean() * (np.eye(3) - P[rows[on]])
        return sp.bsr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)
