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
