"""Random switching of two-state sites in fixed steps: NumPy reference implementation of the compiled kernel."""

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
    """Return the states of sites after a number of steps, in each of which every site may switch once.

    Parameters
    ----------
    state : (g, n) uint8 array
        State 0 or 1 of n sites in each of g groups; not modified.
    up, down : (steps, g) uint64 array
        Thresholds from 0 to 2^32: in step s a site of group j switches from 0 to 1 if its random word is below ``up[s, j]``, and
        from 1 to 0 if it is below ``down[s, j]``. Probabilities are therefore multiples of 2^-32.
    key : (2,) uint32 array
        Key of the random number generator.
    first_step : int
        Number of the first step; all step numbers are below 2^32.
    phase : int
        Purpose of the draws (:class:`.random.Phase`).
    threads : int
        Number of threads of the compiled kernel; the result does not depend on it.

    Returns
    -------
    (g, n) uint8 array

    Raises
    ------
    ValueError
        If the shapes are inconsistent.

    Notes
    -----
    Every site has its own random word in every step. Site i of group j uses word ``i mod 4`` of the four words drawn with the
    counter (block, step, phase), where ``block = j ceil(n / 4) + i div 4`` takes two words of the counter.
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
