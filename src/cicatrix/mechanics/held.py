"""What holds nodes of a body while the set of those that are held changes: one pattern of the matrix throughout."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from ..core.native import turn_blocks
from .body import Frame


class Held:
    r"""What holds nodes now: those of the frame that slide, and those that touch.

    With the normals n of all that holds a node, :math:`S = \sum n n^T` and its pseudo-inverse, :math:`I - S S^+` projects on
    what is free there, and :math:`n \cdot S^+ r` is the share of a force r that acts along n. The matrix of what is left to
    solve, :math:`P K P + c (I - P)`, has the same pattern whoever touches.

    Parameters
    ----------
    frame : Frame
        Fixed nodes are left out, sliding ones held along their directions.
    normals : (n_plates, 3) array [1]
        Out of the plates, of length 1.
    touching : (n_plates, n_nodes) bool array
        Who is held by them.
    """

    def __init__(self, frame: Frame, normals: np.ndarray, touching: np.ndarray) -> None:
        self._frame, self._free = frame, frame.solved(False)[0]
        self._normals, self._touching = normals, touching
        S = np.einsum("pn,pi,pj->nij", touching.astype(float), self._normals, self._normals)
        np.add.at(S, frame.sliding_nodes, np.einsum("ni,nj->nij", frame.sliding_normals, frame.sliding_normals))
        self._nodes = np.flatnonzero(S.any(axis=(1, 2)))
        self._inverse = np.zeros_like(S)
        self._inverse[self._nodes] = np.linalg.pinv(S[self._nodes], rcond=1e-6, hermitian=True)
        self._P = np.broadcast_to(np.eye(3), S.shape).copy()
        self._P[self._nodes] -= S[self._nodes] @ self._inverse[self._nodes]

    def way(self, targets: Sequence[np.ndarray], back: np.ndarray) -> np.ndarray:
        """Displacement (n_nodes, 3) [mm] that takes touching nodes by (n_nodes,) [mm] along each plate's normal.

        The frame's sliding nodes go back (n_nodes, 3) [mm] along theirs.
        """
        along = np.einsum("pn,pi->ni", np.where(self._touching, targets, 0.0), self._normals)
        nodes, normals = self._frame.sliding_nodes, self._frame.sliding_normals
        np.add.at(along, nodes, np.sum(normals * back[nodes], axis=1)[:, None] * normals)
        return np.einsum("nij,nj->ni", self._inverse, along)

    def push(self, r: np.ndarray) -> np.ndarray:
        """Share of forces (n_nodes, 3) [mN] that acts along the plates' normals at touching nodes (n_plates, n_nodes) [mN]."""
        return np.where(self._touching, np.einsum("pi,nij,nj->pn", self._normals, self._inverse, r), 0.0)

    def free_part(self, r: np.ndarray) -> np.ndarray:
        """What nothing holds of forces (n_nodes, 3) -> (n_free,)."""
        return self.project(self.on_free(r))

    def on_free(self, vectors: np.ndarray) -> np.ndarray:
        """(n_nodes, 3) -> (n_free,), nodes that are not fixed."""
        return vectors.reshape(-1)[self._free]

    def from_free(self, values: np.ndarray) -> np.ndarray:
        """(n_free,) -> (n_nodes, 3), 0 at fixed nodes."""
        out = np.zeros(self._P.shape[:2])
        out.reshape(-1)[self._free] = values
        return out

    def project(self, values: np.ndarray) -> np.ndarray:
        """(n_free,) -> (n_free,), 0 along what is held."""
        return np.einsum("nij,nj->ni", self._P[self._frame.free_nodes], values.reshape(-1, 3)).reshape(-1)

    def matrix(self, matrix: sp.bsr_array) -> sp.bsr_array:
        """P K P + c (I - P) of K (n_free, n_free), c its mean diagonal."""
        nodes = self._frame.free_nodes
        rows = np.repeat(np.arange(nodes.size), np.diff(matrix.indptr))
        P, data = self._P[nodes], matrix.data.copy()
        turn_blocks(data, matrix.indptr, matrix.indices, P, P)
        is_held = np.isin(nodes, self._nodes)
        on = np.flatnonzero((rows == matrix.indices) & is_held[rows])
        data[on] += matrix.diagonal().mean() * (np.eye(3) - P[rows[on]])
        return sp.bsr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)
