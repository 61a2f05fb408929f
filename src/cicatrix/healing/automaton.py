"""The healing automaton: cells on a lattice divide, move and close the wound.

Source: Garbey et al., section 3, read in integers: edge division, motility, layer division and redistribution, in this
order, once per cell cycle. Every random number belongs to (seed, site, step, phase), so the occupancy and the number of
the step determine all that follows, bit for bit, on any machine and in any order of evaluation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..core.errors import InputError, InvariantError
from ..core.random import MAX_SEED, Phase, below, site_words, threshold
from ..geometry.hexgrid import Lattice
from .model import Cue
from .motility import move
from .redistribution import level_set, route
from .window import Window

REDISTRIBUTIONS = ("route", "level-set")


@dataclass(frozen=True, kw_only=True)
class AutomatonRules:
    """What a cell does in one step.

    Parameters
    ----------
    p_edge : float
        Probability that a cell with a free neighbour divides into it [1].
    p_layer : float
        Probability p0 that a cell of the active layer divides, without feedback [1].
    layer_sites : int
        Thickness of the active layer: hop distance from the nearest empty site. 0: no layer.
    motility_substeps : int
        Diffusion sub-steps per step. 0: cells stay where they are.
    redistribution : "route" or "level-set"
        Where daughters of the layer go: along noisy shortest paths, or by diffusion and level set.
    feedback : float
        F(W) = feedback W / W_ref; 0 is one-way coupling [1].
    min_free_neighbours : int
        Contact inhibition: a cell divides at the edge only with at least so many free neighbours.
    path_noise : float
        Largest random addition to the cost of a site on a path, as a fraction of the cost of a hop [1].

    Raises
    ------
    InputError
        If a number is outside its range.
    """

    p_edge: float
    p_layer: float
    layer_sites: int
    motility_substeps: int = 8
    redistribution: str = "route"
    feedback: float = 0.0
    min_free_neighbours: int = 1
    path_noise: float = 0.5

    def __post_init__(self):
        for name in ("p_edge", "p_layer"):
            _require(0 <= getattr(self, name) <= 1, f"{name} must lie in [0, 1]", getattr(self, name))
        for name, low in (("layer_sites", 0), ("motility_substeps", 0), ("min_free_neighbours", 1)):
            value = getattr(self, name)
            _require(float(value).is_integer() and value >= low, f"{name} must be a whole number >= {low}", value)
        known = " or ".join(f'"{name}"' for name in REDISTRIBUTIONS)
        _require(self.redistribution in REDISTRIBUTIONS, f"redistribution must be {known}", self.redistribution)
        _require(np.isfinite(self.feedback), "feedback must be finite", self.feedback)
        _require(0 <= self.path_noise <= 16, "path_noise must lie in [0, 16]", self.path_noise)
        if self.redistribution == "level-set" and self.motility_substeps == 0:
            raise InputError('AutomatonRules: redistribution = "level-set" needs motility_substeps >= 1; got 0')


@dataclass(frozen=True, eq=False)
class AutomatonState:
    """Cells and clock. ``occupancy`` and ``step`` are the whole checkpoint; the counts only report the last step.

    Parameters
    ----------
    occupancy : bool array of the lattice's shape, read-only
        Sites that hold a cell.
    step : int
        Steps done.
    n_edge_divisions, n_layer_divisions : int
        Divisions of the last step that placed a daughter.
    n_dropped : int
        Divisions of the layer that did not happen in the last step because no empty site was left or reachable.
    n_clamped : int
        Cells of the layer whose probability exceeded 1 in the last step and was taken as 1.
    """

    occupancy: np.ndarray
    step: int
    n_edge_divisions: int = 0
    n_layer_divisions: int = 0
    n_dropped: int = 0
    n_clamped: int = 0

    def __post_init__(self):
        self.occupancy.setflags(write=False)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return int(np.count_nonzero(self.occupancy))


@dataclass(frozen=True, eq=False)
class Automaton:
    """Healing model on a lattice (implements ``HealingModel``).

    Parameters
    ----------
    lattice : Lattice
        Where cells can sit.
    fillable : bool array of the lattice's shape
        Sites that may ever hold a cell; the others never do and carry no flux, and so does the frame.
    open0 : bool array of the lattice's shape
        Fillable sites that are empty at the start (the wound); all other fillable sites hold a cell.
    rules : AutomatonRules
        What a cell does in one step.
    seed : int
        Names the stream of random numbers, 0 .. 2^64 - 1.

    Raises
    ------
    InputError
        If the arrays do not fit the lattice, the wound holds a site that cannot be filled, or no cell is left.

    Notes
    -----
    Limits: a wound that is closed, or was never open, stays as it is (the step is counted). It may touch the frame.
    A pocket of the wound that no cell borders stays empty, except that motility may fill it.
    """

    lattice: Lattice
    fillable: np.ndarray
    open0: np.ndarray
    rules: AutomatonRules
    seed: int

    def __post_init__(self):
        for name in ("fillable", "open0"):
            array = np.asarray(getattr(self, name))
            if array.dtype != bool or array.shape != self.lattice.shape:
                kind = f"{array.dtype} {array.shape}"
                raise InputError(f"Automaton.{name} must be bool {self.lattice.shape} like the lattice; got {kind}")
        if (self.open0 & ~self.fillable).any():
            raise InputError("Automaton.open0 marks sites that can never be filled: the wound must lie inside fillable")
        if not (self.fillable & ~self.open0).any():
            raise InputError("Automaton.open0 leaves no cell: the wound must be smaller than the fillable lattice")
        n_neighbours = len(self.lattice.neighbours)
        if self.rules.min_free_neighbours > n_neighbours:
            raise InputError(f"AutomatonRules.min_free_neighbours must be at most {n_neighbours} on this lattice")
        if not 0 <= self.seed <= MAX_SEED:
            raise InputError(f"Automaton.seed must lie in 0 .. 2^64 - 1; got {self.seed}")

    def initial_state(self) -> AutomatonState:
        """Return the fresh wound at step 0."""
        return AutomatonState(self.fillable & ~self.open0, 0)

    def filling(self, state: AutomatonState) -> np.ndarray:
        """Tissue per site: 1 where a cell sits, else 0, of the lattice's shape [1]."""
        return state.occupancy.astype(float)

    def advance(self, state: AutomatonState, cue: Cue | None = None, n_steps: int = 1) -> AutomatonState:
        """Return the state after ``n_steps`` cell cycles under a constant cue; the given state is not touched.

        Raises
        ------
        InputError
            If the cue is not finite or does not fit the lattice.
        InvariantError
            If cells were lost or doubled (a fault of the program).
        """
        if state.occupancy.shape != self.lattice.shape:
            raise InputError(f"the state's lattice {state.occupancy.shape} is not the automaton's {self.lattice.shape}")
        chance = _LayerChance.of(self, cue or Cue())
        for _ in range(n_steps):
            state = self._step(state, chance)
        return state

    def _step(self, state: AutomatonState, chance: _LayerChance) -> AutomatonState:
        is_open = self.fillable & ~state.occupancy
        if not is_open.any():
            return AutomatonState(state.occupancy.copy(), state.step + 1)
        new = self._step_in(Window.around(self.lattice, self.fillable, is_open, self._margin), state, chance)
        if new is None:
            new = self._step_in(Window.whole(self.lattice, self.fillable), state, chance)
        if new is None:
            raise InvariantError(f"the whole lattice was called too narrow for the automaton's step {state.step}")
        return new

    @property
    def _margin(self) -> int:
        """Sites beyond the open region that one step can read or write, in hops."""
        n = self.rules.motility_substeps
        return n + max(n, self.rules.layer_sites) + 2

    def _step_in(self, window: Window, state: AutomatonState, chance: _LayerChance) -> AutomatonState | None:
        """One step with the work confined to a window; None if the window is too narrow for it to be exact."""
        rules, seed, step = self.rules, self.seed, state.step
        before = window.cut(state.occupancy)
        divided, n_edge = divide_at_edge(window, before, rules, seed, step)
        moved, is_exact = move(window, divided, rules.motility_substeps, seed, step)
        if not is_exact:
            return None
        layer = np.flatnonzero(window.within(window.fillable & ~moved, rules.layer_sites) & moved)
        parents, n_clamped = chance.draw(window, layer, seed, step)
        after = self._redistribute(window, moved, layer, parents, step)
        n_placed = int(np.count_nonzero(after)) - int(np.count_nonzero(moved))
        occupancy = window.paste(after, state.occupancy)
        new = AutomatonState(occupancy, step + 1, n_edge, n_placed, parents.size - n_placed, n_clamped)
        _check_count(state, new, self.fillable)
        return new

    def _redistribute(self, window, moved, layer, parents, step) -> np.ndarray:
        rules = self.rules
        if not parents.size:
            return moved
        if rules.redistribution == "route":
            return route(window, moved, layer, parents, rules.path_noise, self.seed, step)
        reach = max(rules.layer_sites, rules.motility_substeps)
        return level_set(window, moved, parents, reach, rules.motility_substeps, self.seed, step)


def divide_at_edge(
    window: Window, occupied: np.ndarray, rules: AutomatonRules, seed: int, step: int
) -> tuple[np.ndarray, int]:
    """Edge division: (size,) bool -> (size,) bool and the number of divisions.

    A cell with enough free neighbours divides with probability p_edge into one of them, all equally likely. Where
    several choose the same site it is filled once, and the divisions of the others did not happen.
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


class _LayerChance(NamedTuple):
    """Division probability of the layer before clamping: p0 (1 + F(W)) per site of the lattice, or one number."""

    p: np.ndarray

    @classmethod
    def of(cls, automaton: Automaton, cue: Cue) -> _LayerChance:
        w, shape = np.asarray(cue.W, float), automaton.lattice.shape
        if w.shape not in ((), shape):
            raise InputError(f"Cue.W must be a number or an array of the lattice's shape {shape}; got {w.shape}")
        if not np.isfinite(w).all():
            raise InputError("Cue.W must be finite at every site; it holds NaN or infinity")
        if not (np.isfinite(cue.W_ref) and cue.W_ref > 0):
            raise InputError(f"Cue.W_ref must be positive (kPa); got {cue.W_ref}")
        rules = automaton.rules
        return cls((rules.p_layer * (1 + rules.feedback * w / cue.W_ref)).ravel())

    def draw(self, window: Window, layer: np.ndarray, seed: int, step: int) -> tuple[np.ndarray, int]:
        """Return the cells of the layer that divide (flat indices), and how many probabilities were clamped at 1."""
        site = window.site(layer)
        p = self.p[site] if self.p.size > 1 else np.broadcast_to(self.p, site.shape)
        word = site_words(seed, site, step, Phase.LAYER_DIVISION)[:, 0]
        return layer[word < threshold(np.clip(p, 0, 1))], int(np.count_nonzero(p > 1))


def _check_count(old: AutomatonState, new: AutomatonState, fillable: np.ndarray) -> None:
    expected = old.n_cells + new.n_edge_divisions + new.n_layer_divisions
    if new.n_cells != expected or new.n_dropped < 0 or (new.occupancy & ~fillable).any():
        raise InvariantError(
            f"the automaton lost or doubled cells at step {old.step}: {new.n_cells} cells where {expected} belong"
        )


def _require(is_fine: bool, rule: str, value: object) -> None:
    if not is_fine:
        raise InputError(f"AutomatonRules.{rule}; got {value}")
