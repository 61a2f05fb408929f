"""Assembly of element matrices into the blocks of a sparse matrix whose pattern is built once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from ..core.native import add_blocks, add_contracted


class Pattern:
    """Sparsity pattern of an assembled matrix, with the position of each block of each element matrix.

    Parameters
    ----------
    elements : list of (n, a) int arrays
        Nodes of each element, one array per kind of element.
    nodes : (n_free,) int array
        Nodes whose components are unknowns, ascending; rows and columns of other nodes are omitted.
    n_nodes : int
        Number of all nodes.
    components : int
        Number of unknown components at each node: 2 (the first two) or 3.
    """

    def __init__(self, elements: list[np.ndarray], nodes: np.ndarray, n_nodes: int, components: int = 3) -> None:
        n = nodes.size
        number = np.full(n_nodes, -1)
        number[nodes] = np.arange(n)
        pairs = [_pairs(number[e], n) for e in elements]
        diagonal = np.arange(n) * (n + 1)
        unique, places = _distinct(np.concatenate([diagonal, *(p.ravel() for p in pairs)]))
        ends = np.cumsum([n, *(p.size for p in pairs)])
        self._diagonal = places[:n]
        self._slots = [part.astype(np.int32).reshape(p.shape) for part, p in zip(np.split(places, ends)[1:-1], pairs)]
        self._indices = (unique % n).astype(np.int32)
        self._indptr = np.searchsorted(unique, np.arange(n + 1) * n).astype(np.int32)
        self._components = components

    @property
    def n_dofs(self) -> int:
        """Number of unknowns: rows of the matrix."""
        return (self._indptr.size - 1) * self._components

    def zeros(self) -> np.ndarray:
        """Return zero blocks (n_blocks, components, components) to assemble into."""
        return np.zeros((self._indices.size, self._components, self._components))

    def add(self, data: np.ndarray, kind: int, first: int, matrices: np.ndarray) -> None:
        """Add to the blocks ``data`` the matrices (n, 3a, 3a) of n consecutive elements, the first of which is number ``first``.

        ``kind`` is the index of the array of ``elements`` to which they belong.
        """
        add_blocks(data, self._slots[kind][first : first + len(matrices)], np.ascontiguousarray(matrices))

    def add_contracted(self, data: np.ndarray, kind: int, first: int, factors: Sequence[np.ndarray]) -> None:
        """Add element matrices as ``add`` does, computed from their factors (arguments of ``core.scatter.contracted``)."""
        arrays = [np.ascontiguousarray(array) for array in factors]
        add_contracted(data, self._slots[kind][first : first + len(arrays[0])], *arrays)

    def add_diagonal(self, data: np.ndarray, blocks: np.ndarray) -> None:
        """Add blocks (n_free, components, components) to the diagonal blocks of ``data``."""
        data[self._diagonal] += blocks

    def matrix(self, data: np.ndarray, diagonal: np.ndarray) -> sp.bsr_array:
        """Add a diagonal (n_dofs,) to the blocks ``data``, and return them as a sparse matrix (n_dofs, n_dofs)."""
        k = np.arange(self._components)
        data[self._diagonal[:, None], k, k] += diagonal.reshape(-1, self._components)
        return sp.bsr_array((data, self._indices, self._indptr), shape=(self.n_dofs, self.n_dofs))


def _distinct(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the ascending distinct values other than -1, and the index of each value among them (-1 for -1): (m,) -> (k,), (m,).

    NumPy's ``unique`` with ``searchsorted`` takes five times as long.
    """
    order = np.argsort(values)
    ascending = values[order]
    is_new = np.diff(ascending, prepend=-1) > 0
    places = np.empty(values.size, int)
    places[order] = np.cumsum(is_new) - 1
    return ascending[is_new], places


def _pairs(nodes: np.ndarray, n: int) -> np.ndarray:
    """Return a number i n + j for all pairs of nodes i, j of each element: (m, a) -> (m, a, a); -1 if one of them is -1."""
    rows, columns = nodes[:, :, None], nodes[:, None, :]
    return np.where((rows >= 0) & (columns >= 0), rows * n + columns, -1)
