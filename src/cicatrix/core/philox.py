"""Philox4x32-10, a counter-based random number generator: NumPy reference implementation of the compiled kernel.

Source: Salmon, Moraes, Dror, Shaw, Parallel random numbers: as easy as 1, 2, 3, SC11 (2011). A draw is a pure
function of (counter, key), so any implementation, thread count or order of evaluation gives the same numbers.
"""

from __future__ import annotations

import numpy as np

N_ROUNDS = 10
MULTIPLIERS = (np.uint64(0xD2511F53), np.uint64(0xCD9E8D57))
KEY_STEPS = (0x9E3779B9, 0xBB67AE85)  # golden ratio and sqrt(3) - 1, in 32 bits
LOW = np.uint64(0xFFFFFFFF)
SHIFT = np.uint64(32)


def philox4x32(counter: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Return four random words per counter: (..., 4) uint32, key (2,) uint32 -> (..., 4) uint32.

    Raises
    ------
    ValueError
        If the last axis of ``counter`` does not have length 4 or ``key`` is not two words.
    """
    counter, key = np.asarray(counter, np.uint32), np.asarray(key, np.uint32)
    if counter.ndim < 1 or counter.shape[-1] != 4 or key.shape != (2,):
        raise ValueError(f"philox4x32 takes a counter (..., 4) and a key (2,); got {counter.shape} and {key.shape}")
    words = tuple(counter[..., i].astype(np.uint64) for i in range(4))
    for i_round in range(N_ROUNDS):
        words = _mix(words, *((int(key[i]) + i_round * KEY_STEPS[i]) & 0xFFFFFFFF for i in range(2)))
    return np.stack(words, axis=-1).astype(np.uint32)


def _mix(words: tuple[np.ndarray, ...], key0: int, key1: int) -> tuple[np.ndarray, ...]:
    """Apply one round of the generator with two key words; return the four new words, each (...) uint64 below 2^32."""
    product0, product1 = words[0] * MULTIPLIERS[0], words[2] * MULTIPLIERS[1]
    return (
        (product1 >> SHIFT) ^ words[1] ^ np.uint64(key0),
        product1 & LOW,
        (product0 >> SHIFT) ^ words[3] ^ np.uint64(key1),
        product0 & LOW,
    )
