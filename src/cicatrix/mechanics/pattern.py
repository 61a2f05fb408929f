"""Assembly of element matrices into the blocks of a sparse matrix whose pattern is built once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from ..core.native import add_blocks, add_contracted


class Pattern:
    """Where each block of each element matrix goes.

    Parameters
    ----------
    elements : list of (n, a) int arrays
        Nodes of each element, one array per kind of element.
    nodes : (n_free,) int array
        Nodes that are solved for, ascending; the others are left out.
    n_nodes : int
        Number of all nodes.
    components : int
        Components of each node that are solved for, the first 2 or all 3.
    """

    def __init__(self, elements: list[np.ndarray], nodes: np.ndarray, n_nodes: int, components: int = 3) -> None:
        n = nodes.size
        number = np.full(n_nodes, -1)
        number[nodes] = np.arange(n)
        pairs = [_pairs(number[e], n) for e in elements]
        diagonal = np.arange(n) * (n + 1)
        unique = np.unique(np.concatenate([*(p[p >= 0] for p in pairs), diagonal]))
        self._slots = [np.where(p >= 0, np.searchsorted(unique, p), -1).astype(np.int32) for p in pairs]
        self._diagonal = np.searchsorted(unique, diagonal)
        self._indices = (unique % n).astype(np.int32)
        self._indptr = np.searchsorted(unique, np.arange(n + 1) * n).astype(np.int32)
        self._components = components

    @property
    def n_dofs(self) -> int:
        """Degrees of freedom solved for."""
        return (self._indptr.size - 1) * self._components

    def zeros(self) -> np.ndarray:
        """Blocks of an empty matrix (n_blocks, components, components), to add to."""
        return np.zeros((self._indices.size, self._components, self._components))

    def add(self, data: np.ndarray, kind: int, first: int, matrices: np.ndarray) -> None:
        """Add matrices (n, 3a, 3a) of the elements of a kind from number ``first`` on."""
        add_blocks(data, self._slots[kind][first : first + len(matrices)], np.ascontiguousarray(matrices))

    def add_contracted(self, data: np.ndarray, kind: int, first: int, factors: Sequence[np.ndarray]) -> None:
        """Add what element matrices are contracted from: slopes, tangents, columns and rows of ``core.scatter.contracted``."""
        arrays = [np.ascontiguousarray(array) for array in factors]
        add_contracted(data, self._slots[kind][first : first + len(arrays[0])], *arrays)

    def add_diagonal(self, data: np.ndarray, blocks: np.ndarray) -> None:
        """Add blocks (n_nodes solved for, components, components) on the diagonal."""
        data[self._diagonal] += blocks

    def matrix(self, data: np.ndarray, diagonal: np.ndarray) -> sp.bsr_array:
        """Make a matrix of the blocks and a diagonal (n_dofs,) that is added."""
        k = np.arange(self._components)
        data[self._diagonal[:, None], k, k] += diagonal.reshape(-1, self._components)
        return sp.bsr_array((data, self._indices, self._indptr), shape=(self.n_dofs, self.n_dofs))


def _pairs(nodes: np.ndarray, n: int) -> np.ndarray:
    """Number of each pair of an element's nodes (m, a) -> (m, a, a); -1 with a node that is left out (-1)."""
    rows, columns = nodes[:, :, None], nodes[:, None, :]
    return np.where((rows >= 0) & (columns >= 0), rows * n + columns, -1)
