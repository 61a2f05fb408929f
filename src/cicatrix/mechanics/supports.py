"""Elimination of the constrained components of fixed nodes and of nodes that slide along walls."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import skfem

from ..numerics.linear import Pattern, has_pattern
from .space import SolidSpace, tabulate

PARALLEL = 0.05  # a direction is constrained if its mean squared cosine with the face normals at a node exceeds this
CORNERS_AND_MIDDLES = np.array(
    [[0.0, 1.0, 0.0, 0.5, 0.5, 0.0], [0.0, 0.0, 1.0, 0.0, 0.5, 0.5]]
)  # local coordinates of the six nodes of a face


class Supports:
    """Map between degrees of freedom and unknowns; at sliding nodes, unknowns are components along unconstrained axes.

    Parameters
    ----------
    free : (n_free,) int array
        Degrees of freedom (3 node + component) of nodes that are not fixed, ascending.
    sliding_nodes : (m,) int array
        Nodes constrained along one direction and free to move normal to it; a node may be listed several times.
    normals : (m, 3) array [1]
        Unit vectors of these directions.
    n_dofs : int
        Total number of degrees of freedom.
    """

    def __init__(self, free: np.ndarray, sliding_nodes: np.ndarray, normals: np.ndarray, n_dofs: int) -> None:
        self._free = free
        self._axes = _axes(free, sliding_nodes, normals, n_dofs) if sliding_nodes.size else None
        self._places: tuple[Pattern, sp.csr_array] | None = None
        self.n_unknowns = free.size if self._axes is None else self._axes.shape[1]

    def unknowns(self, x: np.ndarray) -> np.ndarray:
        """Return the unknowns of positions, or of forces: (n_nodes, 3) -> (n_unknowns,)."""
        values = x.reshape(-1)[self._free]
        return values if self._axes is None else self._axes.T @ values

    def positions(self, values: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return positions [mm] with given unknowns (n_unknowns,); constrained components are those of x (n_nodes, 3)."""
        out = x.copy()
        if self._axes is None:
            out.reshape(-1)[self._free] = values
        else:
            out.reshape(-1)[self._free] += self._axes @ (values - self.unknowns(x))
        return out

    def constrained_part(self, x: np.ndarray) -> np.ndarray:
        """Return the constrained components of vectors (n_nodes, 3), with 0 in free components."""
        return self.positions(np.zeros(self.n_unknowns), x)

    def matrix(self, matrix: sp.bsr_array) -> sp.bsr_array:
        """Transform a matrix of the free degrees of freedom (n_free, n_free) to the unknowns; equal patterns stay equal."""
        if self._axes is None:
            return matrix
        turned, places = self._turn(matrix.tocsr(), self._axes), self._pattern(matrix)
        data = np.zeros((places.nnz, 1, 1))
        data[np.searchsorted(_keys(places), _keys(turned)), 0, 0] = turned.data
        return sp.bsr_array((data, places.indices, places.indptr), shape=turned.shape)

    def _pattern(self, matrix: sp.bsr_array) -> sp.csr_array:
        """Return the pattern of the transformed matrix: SciPy drops zero entries, but the sparsity pattern must not change."""
        if self._places is None or not has_pattern(matrix, self._places[0]):
            ones = sp.bsr_array((np.ones_like(matrix.data), matrix.indices, matrix.indptr), shape=matrix.shape)
            self._places = (matrix.indptr, matrix.indices), self._turn(ones.tocsr(), abs(self._axes))
        return self._places[1]

    @staticmethod
    def _turn(matrix: sp.csr_array, axes: sp.csr_array) -> sp.csr_array:
        turned = sp.csr_array(axes.T @ matrix @ axes)
        turned.sort_indices()
        return turned


def _keys(matrix: sp.csr_array) -> np.ndarray:
    """Return, for each entry of a sparse matrix, its index in the row-major order of all entries (nnz,)."""
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    return rows * matrix.shape[1] + matrix.indices


def _axes(free: np.ndarray, nodes: np.ndarray, normals: np.ndarray, n_dofs: int) -> sp.csr_array:
    """Return orthonormal columns (n_free, n_unknowns): unit vectors, and at sliding nodes the axes normal to all ``normals``."""
    sliding, number = np.unique(nodes, return_inverse=True)
    walls = np.zeros((len(sliding), 3, 3))
    np.add.at(walls, number, normals[:, :, None] * normals[:, None, :])
    shares, directions = np.linalg.eigh(walls)
    node, axis = np.nonzero(shares < 1e-6)
    rows = (3 * sliding[node, None] + np.arange(3)).ravel()
    columns = np.repeat(3 * sliding[node] + axis, 3)
    others = np.setdiff1d(free, (3 * sliding[:, None] + np.arange(3)).ravel())
    values = np.concatenate([np.ones(others.size), directions[node, :, axis].ravel()])
    places = np.concatenate([others, rows]), np.concatenate([others, columns])
    axes = sp.csr_array(sp.coo_array((values, places), shape=(n_dofs, n_dofs)))
    axes.eliminate_zeros()
    axes = axes[free]
    return sp.csr_array(axes[:, np.unique(axes.indices)])


def walls(space: SolidSpace, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes and directions that constrain a body to slide on frictionless walls.

    On a smooth wall a node is constrained along the mean normal of its faces; where two faces meet at an angle above
    about 26 degrees, as two planes of symmetry do, it is constrained along both normals.

    Parameters
    ----------
    space : SolidSpace
        Space of the body.
    faces : (n,) int array
        Numbers of the boundary faces on the walls.

    Returns
    -------
    (m,) int array, (m, 3) array [1]
        Nodes and directions, for :class:`.body.Discretization`; a node at an edge of the walls is listed two or three times.
    """
    nodes = space.facet_nodes(faces)
    slopes = tabulate(skfem.ElementTriP2(), CORNERS_AND_MIDDLES, np.ones(6)).gradient
    tangents = np.einsum("fai,qab->fqib", space.positions[nodes], slopes)
    normals = np.cross(tangents[..., 0], tangents[..., 1]).reshape(-1, 3)  # their length is twice the area of the face
    on_wall, number = np.unique(nodes.ravel(), return_inverse=True)
    extent = np.linalg.norm(normals, axis=1)
    spread = np.zeros((len(on_wall), 3, 3))
    np.add.at(spread, number, normals[:, :, None] * normals[:, None, :] / extent[:, None, None])
    spread /= np.bincount(number, weights=extent)[:, None, None]
    shares, directions = np.linalg.eigh(spread)
    node, axis = np.nonzero(shares > PARALLEL)
    return on_wall[node], directions[node, :, axis]
