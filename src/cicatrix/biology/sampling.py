"""Single bonds that close and open at random: in fixed steps, or at the very times."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..core.native import switch_states, threads
from ..core.random import Phase, site_words, threshold


def monte_carlo(
    bound: np.ndarray, chance_on: np.ndarray, chance_off: np.ndarray, seed: int, first_step: int
) -> np.ndarray:
    """Bonds after some fixed steps: Guo, Mofrad & Buganza Tepole, Eqs (20) and (21).

    Parameters
    ----------
    bound : (g, n) uint8 array
        1 where a bond is closed, n bonds in each of g cells.
    chance_on, chance_off : (steps, g) array [1]
        P_on and P_off in each step; :meth:`.adhesion.Adhesion.chances`. They are rounded down to multiples of 2^-32.
    seed, first_step : int
        A draw belongs to seed, bond and step: the same bits come from any number of threads, and in any portions of steps.

    Returns
    -------
    (g, n) uint8 array
    """
    key = np.array([seed & 0xFFFFFFFF, seed >> 32], np.uint32)
    return switch_states(
        np.ascontiguousarray(bound, np.uint8),
        threshold(chance_on),
        threshold(chance_off),
        key,
        first_step,
        int(Phase.BOND),
        threads(),
    )


def exact(
    bound: np.ndarray,
    times: tuple[float, float],
    k_on: np.ndarray,
    most: np.ndarray,
    k_off: Callable[[np.ndarray, np.ndarray], np.ndarray] | None,
    seed: int,
    interval: int,
) -> np.ndarray:
    """Bonds after an interval of time, each switched at the times that its rates ask for: no step, no error.

    Bonds that do not share their load are independent, so each has its own exponential waits (Gillespie 1976, bond by bond).
    Where a rate changes in time, candidates come at its upper bound and are taken with the ratio (Lewis & Shedler 1979).

    Parameters
    ----------
    bound : (g, n) uint8 array
        1 where a bond is closed, n bonds in each of g cells.
    times : (start, end) [s]
        The interval.
    k_on, most : (g,) array [1/s]
        Rate of closing, and of opening: an upper bound of it if ``k_off`` is given.
    k_off : callable, optional
        Rate of opening at times (m,) [s] of bonds in cells (m,) -> (m,) [1/s].
    seed, interval : int
        A draw belongs to seed, bond, interval and its number in there; intervals follow each other with numbers of their own.

    Returns
    -------
    (g, n) uint8 array
    """
    state = np.array(bound, bool).ravel()
    left, time = np.arange(state.size), np.full(state.size, times[0])
    n = np.shape(bound)[1]
    number = 0
    while left.size:
        words = site_words(seed, left + (number << 32), interval, Phase.BOND_WAIT)
        cell = left // n
        time = time - np.log(_uniform(words[:, 0], words[:, 1])) / np.where(state[left], most[cell], k_on[cell])
        is_due = time < times[1]
        left, time, words, cell = left[is_due], time[is_due], words[is_due], cell[is_due]
        if k_off is None:
            state[left] ^= True
        else:
            share = np.where(state[left], k_off(time, cell) / most[cell], 1.0)
            state[left] ^= _uniform(words[:, 2], words[:, 3]) < share
        number += 1
    return state.reshape(np.shape(bound)).astype(np.uint8)


def _uniform(high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Number between 0 and 1, never one of them, from two words (...) uint32."""
    whole = high.astype(np.uint64) << np.uint64(20) | low.astype(np.uint64) >> np.uint64(12)
    return (whole.astype(float) + 0.5) * 2.0**-52
