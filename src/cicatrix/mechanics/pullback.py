"""Change of variables in the linear systems of a deforming body, to displacements in the original shape of its mesh.

The transformed matrices change little as the body deforms. A deformation rotates and shears the directions in which tissue
is nearly incompressible, so the factor of the tangent K0 of one shape is a poor preconditioner for the tangent K of another
shape. A displacement dY that preserves the volume in the original shape still does so after push-forward by the deformation
gradient G, dx = G dY (Piola's identity). Therefore G^T K G is close to K0, even at a Poisson ratio of 0.4999. Measured
gain: docs/decisions/0003.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..core.native import turn_blocks
from .body import Body
from .elements import NORMAL
from .space import AnySpace

VOLUME_RATIO_RANGE = (0.3, 3.0)  # range of the nodal volume ratio in which the nodal deformation is used


def nodal_deformation(body: Body, X: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return a deformation gradient at each node: X, x (n_nodes, 3) [mm] -> (n_nodes, 3, 3) [1].

    The gradient is the mean over the adjacent tissue elements, evaluated at their centres. It is replaced by the identity where
    there is no tissue or the volume ratio of the mean is extreme, and at sliding nodes, to preserve their constrained directions.
    """
    discretization = body.discretization
    cells, n = discretization.space.element_nodes[body.fraction > 0.0], discretization.space.n_nodes
    F = _centre_map(discretization.space, x[cells]) @ np.linalg.inv(_centre_map(discretization.space, X[cells]))
    columns = np.concatenate([F.reshape(-1, 9), np.ones((len(F), 1))], axis=1).repeat(cells.shape[1], axis=0)
    sums = discretization.ranks.sum(np.stack([np.bincount(cells.ravel(), column, n) for column in columns.T], axis=1))
    mean = (sums[:, :9] / np.maximum(sums[:, 9:], 1.0)).reshape(-1, 3, 3)
    volume = np.linalg.det(mean)
    mean[~((volume > VOLUME_RATIO_RANGE[0]) & (volume < VOLUME_RATIO_RANGE[1]))] = np.eye(3)
    mean[discretization.sliding_nodes] = np.eye(3)
    return mean


def _centre_map(space: AnySpace, x: np.ndarray) -> np.ndarray:
    """Return the derivative of position with respect to local coordinates at element centres: x (n, a, 3) -> (n, 3, 3) [mm].

    In a section the third column is its unit normal.
    """
    columns = np.einsum("eai,ab->eib", x, space.table.gradient.mean(axis=0))
    if space.n_axes == 3:
        return columns
    return np.concatenate([columns, np.broadcast_to(NORMAL[:, None], (len(columns), 3, 1))], axis=2)


@dataclass(frozen=True, eq=False)
class Pullback:
    """Change of variables that turns K dx = f into a system for dY.

    Parameters
    ----------
    right : (n_nodes, 3, 3) array [1]
        Nodal matrices that map the new unknowns: dx = right dY.
    left : (n_nodes, 3, 3) array [1]
        Nodal matrices applied to the equations: (left K right) dY = left f.
    """

    right: np.ndarray
    left: np.ndarray

    @classmethod
    def loaded(cls, body: Body, x: np.ndarray) -> Pullback:
        """Return the pull-back for the derivative with respect to loaded positions x (n_nodes, 3) [mm]; it preserves symmetry."""
        G = nodal_deformation(body, body.discretization.space.positions, x)
        return cls(G, G.transpose(0, 2, 1))

    @classmethod
    def unloaded(cls, body: Body, X: np.ndarray, x: np.ndarray) -> Pullback:
        """Return the pull-back for the derivative with respect to unloaded positions X at fixed x.

        A change dX of X has nearly the same effect as a change -F dX of x.
        """
        at_x = cls.loaded(body, x)
        return cls(-np.linalg.inv(nodal_deformation(body, X, x)) @ at_x.right, at_x.left)

    def matrix(self, matrix: sp.bsr_array, nodes: np.ndarray) -> sp.bsr_array:
        """Return left K right for a matrix K whose block rows belong to ``nodes`` (n_free,); K is changed in place."""
        b = matrix.blocksize[0]
        left, right = (np.ascontiguousarray(part[nodes, :b, :b]) for part in (self.left, self.right))
        turn_blocks(matrix.data, matrix.indptr, matrix.indices, left, right)
        return matrix
