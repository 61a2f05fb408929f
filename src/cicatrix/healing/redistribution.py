"""Redistribution of the daughter cells of the active layer, in two variants.

Source: Garbey et al., section 3.3. ``route`` (the default) shifts cells along a noisy shortest path. As cells are
indistinguishable, shifting a chain of cells towards the wound is the same as sending one token down the chain.
``level_set`` is the paper's second variant: diffusion, then the level set that contains the new number of cells. Here
the number is conserved in each wound component, because one global level set could remove cells at one wound and add
them at another.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label

from ..core.random import Phase, below, site_word
from .motility import diffuse, largest
from .window import Window

HOP_COST = 64  # cost of one occupied site of a path, without noise
SETTLE_COST = 48  # cost of settling at an empty site that has no occupied neighbour
FAR = np.int32(65535)  # distance of a site without a path
WHOLE_LAYER = 0  # value of ``reach`` that stands for no limit, used in the first round


def path_noise_limit(noise: float) -> int:
    """Return the largest integer that is randomly added to the cost of a site, for noise as a fraction of the cost of a hop."""
    return int(HOP_COST * noise)


def route(
    window: Window, occupied: np.ndarray, layer: np.ndarray, parents: np.ndarray, noise: float, seed: int, step: int
) -> np.ndarray:
    """Send every daughter to an empty site along a noisy shortest path: (size,) bool -> (size,) bool.

    The cost of an occupied site is 64 plus an integer drawn from 0 .. floor(64 noise) by (site, step). Settling at
    an empty site costs s per empty neighbour (s = 48 / number of neighbours) plus an integer drawn from 0 .. s - 1: less
    than a hop, and cheapest where most neighbours are occupied. Without the settling cost a token would choose among
    adjacent empty sites at random, and the front would grow fingers. The field d is the least cost of a path to an
    empty site. A token moves to the neighbour with the smallest d (the first in the lattice's order among equals) until
    it reaches an empty site. Of the tokens at one empty site, one stays there; the site is now occupied, and the others
    move on in the next round, with d computed for the remaining empty sites. Paths use only the layer and the sites
    filled in this redistribution. Tokens without such a path are dropped, and so are the divisions that made them. All
    tokens of a round move at once, and only their number per site matters, so the result does not depend on their order.

    Parameters
    ----------
    layer, parents : int arrays
        Flat indices of the cells of the active layer, and of those among them that divide (one token each).
    """
    descent = _Descent(window, occupied, layer, noise, seed, step)
    tokens, reach = parents, WHOLE_LAYER
    while tokens.size:
        tokens = descent.walk(tokens, reach)
        landed, counts = np.unique(tokens, return_counts=True)
        descent.fill(landed)
        tokens, reach = np.repeat(landed, counts - 1), 2
    return descent.occupied


class _Descent:
    """Noisy distance d to the nearest empty site, along which tokens descend; ``occupied`` is updated at each new cell."""

    def __init__(self, window: Window, occupied: np.ndarray, layer: np.ndarray, noise: float, seed: int, step: int):
        self.window, self.noise, self.seed, self.step = window, noise, seed, step
        self.occupied = occupied.copy()
        self.free = window.fillable & ~occupied
        self.distance = np.full(occupied.size, FAR)
        self.in_reach = np.zeros(occupied.size, bool)
        self.stamp = np.zeros(occupied.size, np.int64)
        self.cost = np.zeros(occupied.size, np.int32)  # 0: paths cannot use this site
        self._open_paths(layer)
        self.layer = layer

    def _open_paths(self, sites: np.ndarray) -> None:
        word = site_word(self.seed, self.window.site(sites), self.step, Phase.PATH_COST)
        self.cost[sites] = HOP_COST + below(word, path_noise_limit(self.noise) + 1)
        self.distance[sites] = FAR

    def _price(self, sites: np.ndarray) -> None:
        """Set d at empty sites to the cost of settling there, which is higher the fewer neighbours are occupied."""
        unit = SETTLE_COST // len(self.window.shifts)
        n_free = self.free[sites + self.window.shifts[:, None]].sum(axis=0)
        word = site_word(self.seed, self.window.site(sites), self.step, Phase.SETTLE)
        self.distance[sites] = unit * n_free + below(word, unit)

    def fill(self, sites: np.ndarray) -> None:
        """Put one cell at each of the given empty sites, so that later paths can use these sites."""
        self.occupied[sites], self.free[sites] = True, False
        self._open_paths(sites)

    def walk(self, tokens: np.ndarray, reach: int) -> np.ndarray:
        """Move tokens (n,) to empty sites and return the flat indices of these (m,); tokens without a path are left out.

        d is solved within ``reach`` hops of the tokens, or in the whole layer. A path that leaves this range costs at
        least HOP_COST (reach + 1), so smaller values are exact; for the other tokens the range is doubled.
        """
        done = []
        while tokens.size:
            near, is_all = self._near(tokens, reach)
            self._solve(near)
            known = self.distance[tokens] < (FAR if is_all else min(FAR, HOP_COST * (reach + 1)))
            done.append(self._descend(tokens[known]))
            self.distance[near] = FAR
            if is_all:
                break
            tokens, reach = tokens[~known], 2 * reach
        return np.concatenate(done) if done else tokens

    def _near(self, tokens: np.ndarray, reach: int) -> tuple[np.ndarray, bool]:
        """Return the path sites within ``reach - 1`` hops of the tokens, and whether a larger reach would add none."""
        if reach == WHOLE_LAYER:
            return self.layer, True
        ring = near = self._once(tokens)
        self.in_reach[near] = True
        for _ in range(reach - 1):
            around = ring + self.window.shifts[:, None]
            ring = self._once(around[(self.cost[around] > 0) & ~self.in_reach[around]])
            self.in_reach[ring] = True
            near = np.concatenate([near, ring])
        return near, ring.size == 0

    def _once(self, sites: np.ndarray) -> np.ndarray:
        """Return the given sites (n,) without duplicates, in arbitrary order, by two array look-ups instead of a sort."""
        number = np.arange(sites.size)
        self.stamp[sites] = number
        return sites[self.stamp[sites] == number]

    def _solve(self, sites: np.ndarray) -> None:
        """Solve d(s) = cost(s) + min of d over the neighbours by relaxation to convergence (the solution is unique).

        A site is updated again only if a neighbour changed.
        """
        around = sites + self.window.shifts[:, None]
        self._price(self._once(around[self.free[around]]))
        self.in_reach[sites] = True
        active = sites
        while active.size:
            best = self.distance[active + self.window.shifts[:, None]].min(axis=0) + self.cost[active]
            is_new = best < self.distance[active]
            active, best = active[is_new], best[is_new]
            self.distance[active] = best
            around = active + self.window.shifts[:, None]
            active = self._once(around[self.in_reach[around]])
        self.in_reach[sites] = False

    def _descend(self, tokens: np.ndarray) -> np.ndarray:
        """Move tokens that have a path along steepest descent of d to empty sites."""
        tokens = tokens.copy()
        walking = np.flatnonzero(~self.free[tokens])
        while walking.size:
            around = tokens[walking] + self.window.shifts[:, None]
            steepest = self.distance[around].argmin(axis=0)
            tokens[walking] += self.window.shifts[steepest]
            walking = walking[~self.free[tokens[walking]]]
        return tokens


def level_set(
    window: Window, occupied: np.ndarray, parents: np.ndarray, reach: int, n_substeps: int, seed: int, step: int
) -> np.ndarray:
    """Diffuse, then threshold each wound component at its new number of cells: (size,) bool -> (size,) bool.

    A wound component is a connected set of fillable sites within ``reach`` hops of an empty site: the open region with
    the tissue around it; ``reach`` is the larger of the layer's thickness and the number of sub-steps. The new number
    is the number of cells before plus the divisions in this step, but at most the number of sites; excess divisions are
    dropped. A component without divisions does not change. Wounds whose surroundings touch form one component with a
    common number of cells, until their surroundings no longer touch.
    """
    zone = window.within(window.fillable & ~occupied, reach) & window.fillable
    u = diffuse(window, occupied, n_substeps)
    result = occupied.copy()
    for sites in _components(window, zone):
        n_new = int(np.count_nonzero(np.isin(parents, sites)))
        if n_new:
            count = min(int(np.count_nonzero(occupied[sites])) + n_new, sites.size)
            result[sites] = False
            result[largest(window, u, sites, count, seed, step, Phase.REDISTRIBUTION_TIE)[1]] = True
    return result


def _components(window: Window, zone: np.ndarray) -> list[np.ndarray]:
    """Return the flat indices of each connected component of a zone: (size,) bool -> list of (n_sites,) int64."""
    structure = np.zeros((3,) * window.lattice.ndim, bool)
    structure[tuple((window.lattice.neighbours + 1).T)] = True
    structure[(1,) * window.lattice.ndim] = True
    names, _ = label(zone.reshape(window.shape), structure)  # pyright: ignore[reportGeneralTypeIssues]
    sites = np.flatnonzero(zone)
    names = names.ravel()[sites]
    order = np.argsort(names, kind="stable")
    return np.split(sites[order], np.flatnonzero(np.diff(names[order])) + 1) if sites.size else []
