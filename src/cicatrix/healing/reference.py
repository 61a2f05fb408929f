"""NumPy reference implementation of the automaton, bit-identical to native/automaton.cpp; practical up to 10^6 sites.

docs/theory/automaton.md specifies a step to the bit.
"""

from __future__ import annotations

import numpy as np

from ..core.errors import InvariantError
from ..core.random import Phase, below, site_word, site_words, threshold
from ..geometry.hexgrid import Lattice
from .motility import move
from .redistribution import level_set, route
from .rules import AutomatonRules
from .window import Window


class ReferenceCore:
    """Automaton on a lattice, advanced step by step with NumPy.

    Parameters
    ----------
    fillable, occupancy : bool arrays of the lattice's shape
        Sites that can be occupied by a cell, and sites that are occupied.
    step : int
        Number of steps done before.
    """

    def __init__(
        self,
        lattice: Lattice,
        fillable: np.ndarray,
        occupancy: np.ndarray,
        rules: AutomatonRules,
        seed: int,
        step: int,
    ) -> None:
        self.lattice, self.fillable, self.rules, self.seed = lattice, fillable, rules, seed
        self._occupancy, self.step = occupancy.copy(), step
        self.last: list[int] = []  # counts of the last step, in the order of the columns that ``advance`` returns

    ranks_of_last_step = 1  # every rank does the whole step

    def occupancy(self) -> np.ndarray:
        """Return the sites occupied by a cell: bool array of the lattice's shape."""
        return self._occupancy.copy()

    def advance(self, n_steps: int, W: np.ndarray, W_ref: float) -> np.ndarray:
        """Perform automaton steps with a strain energy density that is constant in time.

        Parameters
        ----------
        W : (1,) or (n_sites,) array [kPa]
            Strain energy density, one value for all sites or one per site in C order.
        W_ref : float [kPa]
            Reference energy density of the feedback.

        Returns
        -------
        (n_steps, 5) int64 array
            Numbers of edge divisions, layer divisions, dropped divisions, clamped probabilities and cells after each step.
        """
        p = self.rules.p_layer * (1 + self.rules.feedback * W / W_ref)
        return np.array([self._step(p) for _ in range(n_steps)], np.int64).reshape(n_steps, 5)

    def _step(self, p: np.ndarray) -> tuple[int, ...]:
        is_open, n_before = self.fillable & ~self._occupancy, int(np.count_nonzero(self._occupancy))
        counts: tuple[int, ...] = (0, 0, 0, 0)
        if is_open.any():
            done = self._step_in(Window.around(self.lattice, self.fillable, is_open, self._margin), p)
            if done is None:
                done = self._step_in(Window.whole(self.lattice, self.fillable), p)
            if done is None:
                raise InvariantError(f"the automaton's step {self.step} needs more than the whole lattice (a bug)")
            self._occupancy, counts = done
        n_cells = int(np.count_nonzero(self._occupancy))
        if n_cells != n_before + counts[0] + counts[1] or counts[2] < 0 or (self._occupancy & ~self.fillable).any():
            raise InvariantError(
                f"the automaton lost or doubled cells at step {self.step}: {n_cells} cells where "
                f"{n_before + counts[0] + counts[1]} are expected"
            )
        self.step, self.last = self.step + 1, [*counts, n_cells]
        return (*counts, n_cells)

    @property
    def _margin(self) -> int:
        """Number of hops beyond the open region within which one step can read or write."""
        n = self.rules.motility_substeps
        return n + max(n, self.rules.layer_sites) + 2

    def _step_in(self, window: Window, p: np.ndarray) -> tuple[np.ndarray, tuple[int, int, int, int]] | None:
        """Perform one step within a window; return occupancy and counts, or None if the window is too small to be exact."""
        rules, seed, step = self.rules, self.seed, self.step
        divided, n_edge = divide_at_edge(window, window.cut(self._occupancy), rules, seed, step)
        moved, is_exact = move(window, divided, rules.motility_substeps, seed, step)
        if not is_exact:
            return None
        layer = np.flatnonzero(window.within(window.fillable & ~moved, rules.layer_sites) & moved)
        parents, n_clamped = divide_in_layer(window, layer, p, seed, step)
        after = self._redistribute(window, moved, layer, parents)
        n_placed = int(np.count_nonzero(after)) - int(np.count_nonzero(moved))
        return window.paste(after, self._occupancy), (n_edge, n_placed, parents.size - n_placed, n_clamped)

    def _redistribute(self, window: Window, moved: np.ndarray, layer: np.ndarray, parents: np.ndarray) -> np.ndarray:
        rules = self.rules
        if not parents.size:
            return moved
        if rules.redistribution == "route":
            return route(window, moved, layer, parents, rules.path_noise, self.seed, self.step)
        reach = max(rules.layer_sites, rules.motility_substeps)
        return level_set(window, moved, parents, reach, rules.motility_substeps, self.seed, self.step)


def divide_at_edge(
    window: Window, occupied: np.ndarray, rules: AutomatonRules, seed: int, step: int
) -> tuple[np.ndarray, int]:
    """Perform the edge division: (size,) bool -> (size,) bool and the number of divisions.

    A cell with enough free neighbours divides with probability p_edge into one of them, all equally likely. If several
    cells choose the same site, only one of them divides.
    """
    free = window.fillable & ~occupied
    cells = np.flatnonzero(window.beside(free) & occupied)
    is_free = free[cells + window.shifts[:, None]]
    n_free = is_free.sum(axis=0)
    words = site_words(seed, window.site(cells), step, Phase.EDGE_DIVISION)
    divides = (n_free >= rules.min_free_neighbours) & (words[:, 0] < threshold(rules.p_edge))
    chosen = is_free.cumsum(axis=0) > below(words[:, 1], n_free)
    target = (cells + window.shifts[chosen.argmax(axis=0)])[divides]
    result = occupied.copy()
    result[target] = True
    return result, int(np.count_nonzero(result) - np.count_nonzero(occupied))


def divide_in_layer(window: Window, layer: np.ndarray, p: np.ndarray, seed: int, step: int) -> tuple[np.ndarray, int]:
    """Return the layer cells that divide (flat indices), and the number of probabilities that were clamped at 1.

    p: (1,) or (n_sites,) probability before clamping, one for all sites or one per site of the lattice [1].
    """
    site = window.site(layer)
    here = p[site] if p.size > 1 else np.broadcast_to(p, site.shape)
    word = site_word(seed, site, step, Phase.LAYER_DIVISION)
    return layer[word < threshold(np.clip(here, 0, 1))], int(np.count_nonzero(here > 1))
