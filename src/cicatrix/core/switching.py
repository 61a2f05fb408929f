"""Sites of two states that switch at random, step by step: the NumPy twin of the compiled kernel."""

from __future__ import annotations

import numpy as np

from .philox import philox4x32


def switch_states(
    state: np.ndarray,
    up: np.ndarray,
    down: np.ndarray,
    key: np.ndarray,
    first_step: int,
    phase: int,
    threads: int = 1,
) -> np.ndarray:
    """States of sites after some steps, in each of which every site may switch once.

    Parameters
    ----------
    state : (g, n) uint8 array
        0 or 1 of n sites in each of g groups; not changed.
    up, down : (steps, g) uint64 array
        Limits 0 to 2^32: in step s a site of group j that is 0 becomes 1 where its word is below ``up[s, j]``, one that is 1
        becomes 0 where it is below ``down[s, j]``. So chances are multiples of 2^-32.
    key : (2,) uint32 array
        Key of the generator.
    first_step : int
        Number of the first step, below 2^32 with those that follow.
    phase : int
        What the draws are for.
    threads : int
        Of the kernel; the answer does not depend on them.

    Returns
    -------
    (g, n) uint8 array

    Raises
    ------
    ValueError
        If the shapes do not go together.

    Notes
    -----
    Every site has its own word in every step: word ``i mod 4`` of the block with the counter (block, step, phase), where the
    block is ``j ceil(n / 4) + i div 4`` in two words, for site i of group j.
    """
    state, up, down = np.array(state, np.uint8), np.asarray(up, np.uint64), np.asarray(down, np.uint64)
    groups, n = state.shape
    if up.shape != down.shape or up.shape[1:] != (groups,) or np.shape(key) != (2,):
        raise ValueError("switch_states takes states (g, n), limits (steps, g) twice and a key (2,)")
    calls = -(-n // 4)
    block = np.arange(groups * calls, dtype=np.uint64)
    counter = np.empty((groups * calls, 4), np.uint32)
    counter[:, 0], counter[:, 1], counter[:, 3] = block & np.uint64(0xFFFFFFFF), block >> np.uint64(32), phase
    for s in range(len(up)):
        counter[:, 2] = (first_step + s) & 0xFFFFFFFF
        word = philox4x32(counter, key).reshape(groups, 4 * calls)[:, :n].astype(np.uint64)
        state ^= word < np.where(state == 1, down[s][:, None], up[s][:, None])
    return state
