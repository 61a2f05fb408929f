"""Signalling network read from a file: rate law, initial state and inputs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .network import RateLaw


class NetworkModel(NamedTuple):
    """A network with its initial state and the scales of its states."""

    law: RateLaw
    start: np.ndarray
    """Initial state (n_species,)."""
    inputs: np.ndarray
    """Values of the inputs given in the network's file (n_inputs,)."""
    high: np.ndarray
    """Upper limit of each state (n_species,): the maximum activity; without meaning where the states are not normalised."""
    slowest_h: float | None
    """Largest time constant of the network [h]; None if its file declares no time constants."""
    is_normalised: bool
    """Whether inputs lie in [0, 1] and every state from 0 to ``high`` is meaningful."""
    notes: tuple[str, ...] = ()
