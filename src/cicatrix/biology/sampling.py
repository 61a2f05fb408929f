"""Stochastic simulation of independent bonds: in fixed time steps, or with exact event times."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..core.native import switch_states, threads
from ..core.random import Phase, site_words, threshold


def monte_carlo(
    bound: np.ndarray, chance_on: np.ndarray, chance_off: np.ndarray, seed: int, first_step: int
) -> np.ndarray:
    """Simulate bonds over fixed time steps: Guo, Mofrad & Buganza Tepole, Eqs (20) and (21).

    Parameters
    ----------
    bound : (g, n) uint8 array
        1 where a bond is closed, n bonds in each of g cells.
    chance_on, chance_off : (steps, g) array [1]
        P_on and P_off in each step; :meth:`.adhesion.Adhesion.step_probabilities`. They are rounded down to multiples of 2^-32.
    seed, first_step : int
        Random numbers depend only on seed, bond and step: the result is the same, to the bit, for any number of threads and
        any division of the steps into calls.

    Returns
    -------
    (g, n) uint8 array
        1 where a bond is closed at the end.
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
    """Simulate bonds over a time interval with exact event times, without time-step error.

    Bonds that do not share their load are independent, so each has its own exponential waiting times (Gillespie 1976, bond
    by bond). If a rate changes in time, candidate events are drawn at its upper bound and accepted with probability rate over
    bound (thinning, Lewis & Shedler 1979).

    Parameters
    ----------
    bound : (g, n) uint8 array
        1 where a bond is closed, n bonds in each of g cells.
    times : (start, end) [s]
        The interval.
    k_on, most : (g,) array [1/s]
        Closing rate, and opening rate or, if ``k_off`` is given, an upper bound of it.
    k_off : callable, optional
        Opening rate at times (m,) [s] of bonds in cells (m,) -> (m,) [1/s].
    seed, interval : int
        Random numbers depend only on the seed, the bond, the number of the interval, and the number of the event within it;
        successive intervals need different numbers.

    Returns
    -------
    (g, n) uint8 array
        1 where a bond is closed at the end.
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
    """Return numbers in the open interval (0, 1) from high and low random words, each (...) uint32 -> (...)."""
    whole = high.astype(np.uint64) << np.uint64(20) | low.astype(np.uint64) >> np.uint64(12)
    return (whole.astype(float) + 0.5) * 2.0**-52
