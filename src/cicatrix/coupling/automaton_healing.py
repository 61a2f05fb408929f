"""The cellular automaton as a model of wound healing: cells fill sites, and filled sites are new tissue (Garbey et al.)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..healing.automaton import Automaton, AutomatonState
from ..healing.cue import Cue
from ..mechanics.body import Body
from .cavity import Cavity
from .deposition import Deposition
from .healing import Advance, TissueState
from .ruler import Ruler

COUNTS = ("step", "n_edge_divisions", "n_layer_divisions", "n_dropped", "n_clamped")


@dataclass(frozen=True, eq=False)
class AutomatonTissue:
    """State of healing by the automaton: the cells, and the tissue that they have deposited.

    Parameters
    ----------
    cells : AutomatonState
        Cells on the lattice.
    filled : (n_elements,) array [1]
        Tissue fraction of each element.
    natural : (n_elements, n_qp, 3, 3) array [1]
        Natural configuration of the tissue.
    """

    cells: AutomatonState
    filled: np.ndarray
    natural: np.ndarray


@dataclass(frozen=True, eq=False)
class AutomatonHealing:
    """Wound healing by the automaton (:class:`.healing.Healing`): cells divide faster where the strain energy density is larger.

    Parameters
    ----------
    cavity : Cavity
        The body and its cavity.
    ruler : Ruler
        Lattice of the cells, and its map to the elements.
    automaton : Automaton
        Rules of the cells, on the same lattice.
    deposition : Deposition
        Stress-free state of new tissue.
    days_per_step : float [days]
        Duration of one automaton step.
    closes : str
        Text that says when the wound counts as closed.
    notes : tuple of str
        Sentences for the run's manifest.
    """

    cavity: Cavity
    ruler: Ruler
    automaton: Automaton
    deposition: Deposition
    days_per_step: float
    closes: str = "the automaton step that filled the last site"
    notes: tuple[str, ...] = ()

    def fresh(self, x: np.ndarray, x_intact: np.ndarray) -> AutomatonTissue:
        """Return the state after surgery, with cells around an empty cavity; the shapes x, x_intact (n_nodes, 3) are not used."""
        cells = self.automaton.initial_state()
        return AutomatonTissue(cells, self.ruler.filled(cells.occupancy), self.cavity.unstrained)

    def advance(self, state: TissueState[AutomatonTissue], until: float) -> Advance[AutomatonTissue]:
        """Advance the automaton to the time ``until`` [days] at constant strain energy, and add tissue at newly filled sites."""
        old = state.healing
        W = self.ruler.energy(self.body(old), self.cavity.X, state.x, old.filled)
        cells, closure_days = self._stepped(state, Cue(W, state.W_ref or 1.0), until)
        filled = self.ruler.filled(cells.occupancy)
        natural = self.deposition.natural(old.natural, old.filled, filled, self.cavity.deformation(state.x))
        return Advance(AutomatonTissue(cells, filled, natural), closure_days)

    def _stepped(self, state: TissueState[AutomatonTissue], cue: Cue, until: float) -> tuple[AutomatonState, float]:
        """Return the cells after all automaton steps up to a time [days], and the time of closure [days] (below 0 while open)."""
        cells, closure_days = state.healing.cells, state.closure_days
        last = int(np.floor(until / self.days_per_step + 1e-9))
        while cells.step < last:
            cells = self.automaton.advance(cells, cue)
            if closure_days < 0.0 and not self.ruler.open_sites(cells.occupancy).any():
                closure_days = cells.step * self.days_per_step
        return cells, closure_days

    def is_over(self, state: TissueState[AutomatonTissue]) -> bool:
        """Whether the wound is closed."""
        return state.is_closed

    def body(self, state: AutomatonTissue) -> Body:
        """Return the body with the tissue that the cells have deposited."""
        return self.cavity.body(state.filled, state.natural)

    def occupancy(self, state: AutomatonTissue) -> np.ndarray:
        """Return the sites occupied by a cell: bool array of the lattice's shape."""
        return state.cells.occupancy

    def filled(self, state: AutomatonTissue) -> np.ndarray:
        """Return the fraction of each element that is filled by cells (n_elements,) [1]."""
        return state.filled

    def shown(self, state: AutomatonTissue) -> dict[str, np.ndarray]:
        """Return an empty mapping: this model has no further fields."""
        return {}

    def measured(self, state: TissueState[AutomatonTissue]) -> dict[str, float]:
        """Return the number of cells whose division probability exceeded 1 and was set to 1."""
        return {"clamped_cells": state.healing.cells.n_clamped}

    def pack(self, state: AutomatonTissue) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the state as named arrays, and scalars that JSON can store."""
        arrays = {"occupancy": state.cells.occupancy, "filled": state.filled, "natural": state.natural}
        return arrays, {name: getattr(state.cells, name) for name in COUNTS}

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> AutomatonTissue:
        """Return the state that ``pack`` stored, to the bit."""
        cells = AutomatonState(arrays["occupancy"].astype(bool), **{name: scalars[name] for name in COUNTS})
        return AutomatonTissue(cells, arrays["filled"], arrays["natural"])
