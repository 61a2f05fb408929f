"""What a healing model must offer, and what it is told about the mechanics."""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeVar

import numpy as np

H = TypeVar("H")


class Cue(NamedTuple):
    """What the tissue tells the cells.

    Parameters
    ----------
    W : float or array of the lattice's shape [kPa]
        Strain energy density at each site (or one number for all).
    W_ref : float [kPa]
        Energy density at which the feedback is one unit, for example its mean over the fresh wound edge.
    """

    W: np.ndarray | float = 0.0
    W_ref: float = 1.0


class HealingModel(Protocol[H]):
    """Wound closure, cell by cell or by fields; states are values: advancing returns a new one."""

    def initial_state(self) -> H:
        """Return the fresh wound."""
        ...

    def advance(self, state: H, cue: Cue, n_steps: int = 1) -> H:
        """Return the state after ``n_steps`` steps; the given state is not touched."""
        ...

    def filling(self, state: H) -> np.ndarray:
        """Tissue per site, 0 .. 1: array of the lattice's shape [1]."""
        ...
