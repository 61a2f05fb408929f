"""A signalling network as read from a file: rate law, start and inputs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .network import RateLaw


class Model(NamedTuple):
    """A network, where it starts, and what its states are measured by."""

    law: RateLaw
    start: np.ndarray
    """(n_species,)."""
    inputs: np.ndarray
    """Its own values of the inputs (n_inputs,)."""
    high: np.ndarray
    """Greatest activities (n_species,); of SBML twice the start, or 1."""
    slowest_h: float | None
    """Slowest time of the network, if it has one."""
    is_normalised: bool
    """Inputs lie in [0, 1]; a start anywhere below ``high`` makes sense."""
    notes: tuple[str, ...] = ()
