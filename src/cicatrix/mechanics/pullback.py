"""The linear systems of a deformed body as seen from the shape that its mesh was made in, where they change little.

A deformation turns and shears the directions in which tissue is nearly incompressible, and so a factor of one shape's
tangent K0 is a poor preconditioner of another's, K. But a displacement that keeps the volume in the mesh's own shape
keeps it still once the deformation has carried it along, dx = G dY (Piola's identity), and so G^T K G is near K0, at a
Poisson ratio of 0.4999 too; docs/decisions/0003 has what that is worth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from ..core.native import turn_blocks
from .body import Body
from .elements import NORMAL
from .space import AnySpace

BELIEVED = (0.3, 3.0)  # volume ratio about a node within which its deformation is carried along


def nodal_deformation(body: Body, X: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Deformation gradient about each node: X, x (n_nodes, 3) [mm] -> (n_nodes, 3, 3) [1].

    The mean over the tissue elements that meet there, taken at their centres. It is the identity where there is no tissue,
    where the mean's volume ratio is out of all proportion, and at nodes that slide, whose direction is their wall's.
    """
    frame = body.frame
    cells, n = frame.space.element_nodes[body.fraction > 0.0], frame.space.n_nodes
    F = _centre_map(frame.space, x[cells]) @ np.linalg.inv(_centre_map(frame.space, X[cells]))
    columns = np.concatenate([F.reshape(-1, 9), np.ones((len(F), 1))], axis=1).repeat(cells.shape[1], axis=0)
    sums = frame.ranks.sum(np.stack([np.bincount(cells.ravel(), column, n) for column in columns.T], axis=1))
    mean = (sums[:, :9] / np.maximum(sums[:, 9:], 1.0)).reshape(-1, 3, 3)
    volume = np.linalg.det(mean)
    mean[~((volume > BELIEVED[0]) & (volume < BELIEVED[1]))] = np.eye(3)
    mean[frame.sliding_nodes] = np.eye(3)
    return mean


def _centre_map(space: AnySpace, x: np.ndarray) -> np.ndarray:
    """Derivative of position by the local axes, and a section's normal, at the centres: x (n, a, 3) -> (n, 3, 3) [mm]."""
    columns = np.einsum("eai,ab->eib", x, space.table.gradient.mean(axis=0))
    if space.n_axes == 3:
        return columns
    return np.concatenate([columns, np.broadcast_to(NORMAL[:, None], (len(columns), 3, 1))], axis=2)


@dataclass(frozen=True, eq=False)
class Pullback:
    """What turns K dx = f into a system for dY.

    Parameters
    ----------
    ways : (n_nodes, 3, 3) array [1]
        dx = ways dY.
    forces : (n_nodes, 3, 3) array [1]
        They turn f.
    """

    ways: np.ndarray
    forces: np.ndarray

    @classmethod
    def loaded(cls, body: Body, x: np.ndarray) -> Pullback:
        """Of the derivative by the loaded positions x (n_nodes, 3) [mm]: symmetric stays symmetric."""
        G = nodal_deformation(body, body.frame.space.positions, x)
        return cls(G, G.transpose(0, 2, 1))

    @classmethod
    def unloaded(cls, body: Body, X: np.ndarray, x: np.ndarray) -> Pullback:
        """Of the derivative by the unloaded positions X, x held: moving X by dX is near to moving x by -F dX."""
        at_x = cls.loaded(body, x)
        return cls(-np.linalg.inv(nodal_deformation(body, X, x)) @ at_x.ways, at_x.forces)

    def matrix(self, matrix: sp.bsr_array, nodes: np.ndarray) -> sp.bsr_array:
        """Turn the blocks of a matrix whose rows are those of ``nodes`` (n_free,); in place."""
        b = matrix.blocksize[0]
        left, right = (np.ascontiguousarray(part[nodes, :b, :b]) for part in (self.forces, self.ways))
        turn_blocks(matrix.data, matrix.indptr, matrix.indices, left, right)
        return matrix
