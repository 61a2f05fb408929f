"""Counter-based random numbers: a draw depends only on (seed, site, step, phase)."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from .native import philox4x32

__all__ = ["MAX_SEED", "ONE", "Phase", "below", "philox4x32", "site_word", "site_words", "threshold"]

MAX_SEED = 2**64 - 1
ONE = 1 << 32  # probability 1 on the scale of one 32-bit word


class Phase(IntEnum):
    """Purpose of a random draw; its number is part of the generator's counter, so never change or reuse it."""

    EDGE_DIVISION = 0
    MOTILITY_TIE = 1
    LAYER_DIVISION = 2
    PATH_COST = 3
    REDISTRIBUTION_TIE = 4
    SETTLE = 5
    BOND = 6
    BOND_WAIT = 7
    CLUSTER = 8
    CLUTCH = 9


def site_words(seed: int, site: np.ndarray, step: int, phase: Phase) -> np.ndarray:
    """Return four random words per site: sites (...) [index] -> (..., 4) uint32.

    Key = (seed low, seed high), counter = (site low, site high, step, phase).
    """
    site = np.asarray(site).astype(np.uint64)
    counter = np.empty((*site.shape, 4), np.uint32)
    counter[..., 0] = site & np.uint64(0xFFFFFFFF)
    counter[..., 1] = site >> np.uint64(32)
    counter[..., 2] = step & 0xFFFFFFFF
    counter[..., 3] = int(phase)
    return philox4x32(counter, np.array([seed & 0xFFFFFFFF, seed >> 32], np.uint32))


def site_word(seed: int, site: np.ndarray, step: int, phase: Phase) -> np.ndarray:
    """Return one random word per site: sites (...) [index] -> (...) uint32; four sites share one counter.

    Site i uses word ``i mod 4`` of the four words that ``site_words`` returns for ``i div 4``.
    """
    site = np.asarray(site).astype(np.uint64)
    words = site_words(seed, site >> np.uint64(2), step, phase)
    return np.take_along_axis(words, (site & np.uint64(3)).astype(np.int64)[..., None], axis=-1)[..., 0]


def threshold(probability: np.ndarray | float) -> np.ndarray:
    """Convert a probability to an integer: (...) in [0, 1] -> (...) uint64; an event happens where word < threshold."""
    return np.floor(np.asarray(probability, float) * ONE).astype(np.uint64)


def below(word: np.ndarray, n: np.ndarray | int) -> np.ndarray:
    """Map 32-bit words to integers in [0, n), floor(word n / 2^32): (...) uint32 -> (...) int64."""
    return ((word.astype(np.uint64) * np.asarray(n, np.uint64)) >> np.uint64(32)).astype(np.int64)
