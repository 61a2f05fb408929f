"""Cell motility: diffuse the occupancy in integers, then threshold it so that the number of cells is conserved.

Source: Garbey et al., section 3.1 ("Cell Motility"). The diffusion uses integer arithmetic, so that every machine
gives the same bits: U' = (2 U + sum of 6 neighbours + 4) >> 3 in 2-D, U' = (4 U + sum of 12 neighbours + 8) >> 4 in
3-D; initially an occupied site has U = 8191 in 2-D and 4095 in 3-D ("bulk"), an empty one 0. Sites that cannot be
filled and the boundary of the lattice have no flux: a missing neighbour counts as the site's own value.

One sub-step carries information by one hop, so n sub-steps leave U at 0 or bulk farther than n hops from the front,
and the level set of this band is the level set of the lattice as long as 0 < U0 < bulk (U0: the threshold).
"""

from __future__ import annotations

import numpy as np

from ..core.random import Phase, site_word
from .window import Window

BULK = {2: 8191, 3: 4095}  # U of an undisturbed cell: 13 and 12 bits, so that the sums fit into 16 bits
OWN_WEIGHT = {2: 2, 3: 4}
SHIFT = {2: 3, 3: 4}


def diffuse(window: Window, occupied: np.ndarray, n_substeps: int) -> np.ndarray:
    """Diffuse the occupancy over ``n_substeps``: (size,) bool -> (size,) uint16 density U, 0 at unfillable sites."""
    ndim = window.lattice.ndim
    u = occupied.astype(np.uint16) * np.uint16(BULK[ndim])
    reach = int(abs(window.shifts).max())
    inner = slice(reach, u.size - reach)
    fillable = window.fillable.astype(np.uint16)
    own = np.uint16(OWN_WEIGHT[ndim] + len(window.shifts)) - _sum_of_neighbours(fillable, window.shifts, reach)
    own = own[inner] * fillable[inner]
    half, shift = np.uint16(1 << (SHIFT[ndim] - 1)), np.uint16(SHIFT[ndim])
    for _ in range(n_substeps):
        total = _sum_of_neighbours(u, window.shifts, reach)[inner]
        total += own * u[inner]
        total += half
        total >>= shift
        total *= fillable[inner]
        u[inner] = total
    return u


def _sum_of_neighbours(u: np.ndarray, shifts: np.ndarray, reach: int) -> np.ndarray:
    """Sum U over the neighbours of each site: (size,) uint16 -> (size,) uint16; 0 near the ends of the flat array."""
    total = np.zeros_like(u)
    inner = total[reach : u.size - reach]
    for shift in shifts:
        inner += u[reach + shift : u.size - reach + shift]
    return total


def move(window: Window, occupied: np.ndarray, n_substeps: int, seed: int, step: int) -> tuple[np.ndarray, bool]:
    """Perform a motility step: (size,) bool -> (size,) bool with equally many cells, and whether the window was large enough.

    The window is large enough if it is the whole lattice, if 0 < U0 < bulk, or if U0 = bulk and all sites at bulk keep their
    cells, as those outside the window do. Otherwise the result is invalid and the caller must use a larger window.
    """
    candidates, count = np.flatnonzero(window.fillable), int(np.count_nonzero(occupied))
    if n_substeps == 0 or count == 0:
        return occupied, True
    u = diffuse(window, occupied, n_substeps)
    level, kept = largest(window, u, candidates, count, seed, step, Phase.MOTILITY_TIE)
    moved = np.zeros_like(occupied)
    moved[kept] = True
    bulk = BULK[window.lattice.ndim]
    keeps_all_bulk = level == bulk and np.count_nonzero(u == bulk) == count
    return moved, window.is_whole or 0 < level < bulk or keeps_all_bulk


def largest(
    window: Window, u: np.ndarray, candidates: np.ndarray, count: int, seed: int, step: int, phase: Phase
) -> tuple[int, np.ndarray]:
    """Return the threshold U0 and the ``count`` candidates of largest density U, with equal U ordered by (random word, site).

    ``candidates`` are flat indices, ``1 <= count <= len(candidates)``; a histogram gives the threshold exactly.
    """
    values = u[candidates]
    at_least = np.bincount(values)[::-1].cumsum()[::-1]
    level = int(np.flatnonzero(at_least >= count)[-1])
    above, ties = candidates[values > level], candidates[values == level]
    site = window.site(ties)
    order = np.lexsort((site, site_word(seed, site, step, phase)))
    return level, np.concatenate([above, ties[order[: count - above.size]]])
