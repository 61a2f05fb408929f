"""Element matrices into the blocks of a sparse matrix: the twin of native/scatter.cpp."""

from __future__ import annotations

import numpy as np


def add_blocks(data: np.ndarray, slots: np.ndarray, matrices: np.ndarray) -> None:
    """Add element matrices to the blocks of a sparse matrix, element after element.

    Parameters
    ----------
    data : (n_blocks, b, b) array
        Changed in place.
    slots : (n, a, a) int32 array
        Block of each pair of an element's nodes; -1: left out.
    matrices : (n, 3 a, 3 a) array
        Element matrices; the first b of each node's three components are taken.
    """
    n, a, _ = slots.shape
    b = data.shape[1]
    blocks = matrices.reshape(n, a, 3, a, 3).transpose(0, 1, 3, 2, 4)[..., :b, :b]
    kept = slots >= 0
    np.add.at(data, slots[kept], blocks[kept])


def turn_blocks(
    data: np.ndarray, starts: np.ndarray, columns: np.ndarray, left: np.ndarray, right: np.ndarray, chunk: int = 65536
) -> None:
    """Multiply the blocks of a sparse matrix from both sides: block (i, j) becomes left_i block right_j.

    Parameters
    ----------
    data : (n_blocks, b, b) array
        Changed in place.
    starts, columns : (n + 1,), (n_blocks,) int32 arrays
        Where each row begins, and the column of each block.
    left, right : (n, b, b) arrays
        Factors of rows and columns.
    chunk : int
        Blocks that are turned at a time.
    """
    rows = np.repeat(np.arange(len(left)), np.diff(starts))
    for first in range(0, len(rows), chunk):
        part = slice(first, first + chunk)
        data[part] = left[rows[part]] @ data[part] @ right[columns[part]]


def contracted(slopes: np.ndarray, A: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Element matrices (n, 3 a, 3 a): the sum over points of B A B, and of columns times rows.

    Parameters
    ----------
    slopes : (n, n_qp, a, d) array
        B, gradients of the shape functions along d axes.
    A : (n, n_qp, 3, d, 3, d) array
        Tangent of each point, times its weight.
    columns, rows : (n, m, 3 a) arrays
        What is multiplied with each other.
    """
    n, _, a, _ = slopes.shape
    AB = np.einsum("eqiJkL,eqbL->eqiJbk", A, slopes, optimize=True)
    K = np.einsum("eqaJ,eqiJbk->eaibk", slopes, AB, optimize=True).reshape(n, 3 * a, 3 * a)
    return K + np.einsum("eom,eon->emn", columns, rows, optimize=True)


def add_contracted(
    data: np.ndarray, slots: np.ndarray, slopes: np.ndarray, A: np.ndarray, columns: np.ndarray, rows: np.ndarray
) -> None:
    """``add_blocks`` of ``contracted``; the compiled one sums in another order."""
    add_blocks(data, slots, contracted(slopes, A, columns, rows))
