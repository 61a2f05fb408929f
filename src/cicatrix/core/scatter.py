"""Assembly of element matrices into a block-sparse matrix: NumPy reference implementation of native/scatter.cpp."""

from __future__ import annotations

import numpy as np


def add_blocks(data: np.ndarray, slots: np.ndarray, matrices: np.ndarray) -> None:
    """Add element matrices to the blocks of a sparse matrix, in the order of the elements.

    Parameters
    ----------
    data : (n_blocks, b, b) array
        Blocks of the matrix; changed in place.
    slots : (n, a, a) int32 array
        Index in ``data`` of the block of each pair of nodes of an element; -1 if the pair is not assembled.
    matrices : (n, 3 a, 3 a) array
        Element matrices; the first b of each node's three components are used.
    """
    n, a, _ = slots.shape
    b = data.shape[1]
    blocks = matrices.reshape(n, a, 3, a, 3).transpose(0, 1, 3, 2, 4)[..., :b, :b]
    kept = slots >= 0
    np.add.at(data, slots[kept], blocks[kept])


def turn_blocks(
    data: np.ndarray, starts: np.ndarray, columns: np.ndarray, left: np.ndarray, right: np.ndarray, chunk: int = 65536
) -> None:
    """Multiply the blocks of a sparse matrix from both sides: block (i, j) becomes left_i block_ij right_j.

    Parameters
    ----------
    data : (n_blocks, b, b) array
        Blocks of the matrix; changed in place.
    starts, columns : (n + 1,), (n_blocks,) int32 arrays
        Start of each block row, and column of each block (CSR).
    left, right : (n, b, b) arrays
        Left factor of each block row and right factor of each block column.
    chunk : int
        Number of blocks multiplied at a time.
    """
    rows = np.repeat(np.arange(len(left)), np.diff(starts))
    for first in range(0, len(rows), chunk):
        part = slice(first, first + chunk)
        data[part] = left[rows[part]] @ data[part] @ right[columns[part]]


def contracted(slopes: np.ndarray, A: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Compute element matrices (n, 3 a, 3 a): sum over quadrature points of B^T A B, plus columns times rows.

    Parameters
    ----------
    slopes : (n, n_qp, a, d) array
        B: gradients of the shape functions along d axes.
    A : (n, n_qp, 3, d, 3, d) array
        Tangent dP/dF at each point, times its quadrature weight.
    columns, rows : (n, m, 3 a) arrays
        Factors of m rank-one terms; their outer products are added.
    """
    n, _, a, _ = slopes.shape
    AB = np.einsum("eqiJkL,eqbL->eqiJbk", A, slopes, optimize=True)
    K = np.einsum("eqaJ,eqiJbk->eaibk", slopes, AB, optimize=True).reshape(n, 3 * a, 3 * a)
    return K + np.einsum("eom,eon->emn", columns, rows, optimize=True)


def add_contracted(
    data: np.ndarray, slots: np.ndarray, slopes: np.ndarray, A: np.ndarray, columns: np.ndarray, rows: np.ndarray
) -> None:
    """Compute element matrices by ``contracted`` and add them by ``add_blocks``; the compiled kernel sums in another order."""
    add_blocks(data, slots, contracted(slopes, A, columns, rows))
