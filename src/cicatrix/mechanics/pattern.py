"""Assembly of element matrices into a sparsity pattern that is built once."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp


class Pattern:
    """Where each entry of each element matrix goes.

    Parameters
    ----------
    blocks : list of (n, k) int arrays
        Degrees of freedom of each element, one array per kind of element.
    free : (n_free,) int array
        Degrees of freedom that are solved for, ascending; the others are left out.
    n_dofs : int
        Number of all degrees of freedom.
    """

    def __init__(self, blocks: list[np.ndarray], free: np.ndarray, n_dofs: int) -> None:
        number = np.full(n_dofs, -1)
        number[free] = np.arange(free.size)
        rows = np.concatenate([np.repeat(number[b], b.shape[1], axis=1).ravel() for b in blocks])
        columns = np.concatenate([np.tile(number[b], (1, b.shape[1])).ravel() for b in blocks])
        kept = (rows >= 0) & (columns >= 0)
        diagonal = np.arange(free.size)
        keys = np.concatenate([rows[kept] * free.size + columns[kept], diagonal * free.size + diagonal])
        unique, slots = np.unique(keys, return_inverse=True)
        self._kept = np.flatnonzero(kept)
        self._slots = slots[: self._kept.size]
        self._diagonal = slots[self._kept.size :]
        self._indices = unique % free.size
        self._indptr = np.searchsorted(unique, np.arange(free.size + 1) * free.size)
        self._shape = (free.size, free.size)

    def assemble(self, matrices: list[np.ndarray], diagonal: np.ndarray) -> sp.csr_array:
        """Sum element matrices [(n, k, k), ...] and a diagonal (n_free,)."""
        values = np.concatenate([np.asarray(m).ravel() for m in matrices])[self._kept]
        data = np.bincount(self._slots, weights=values, minlength=self._indices.size)
        data[self._diagonal] += diagonal
        return sp.csr_array((data, self._indices, self._indptr), shape=self._shape)
