"""Mechanical input of the cellular automaton."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Cue(NamedTuple):
    """Mechanical input of a healing model.

    Parameters
    ----------
    W : float or array of the lattice's shape [kPa]
        Strain energy density at each site (or one number for all).
    W_ref : float [kPa]
        Reference energy density of the feedback, for example the mean over the edge of the fresh wound.
    """

    W: np.ndarray | float = 0.0
    W_ref: float = 1.0
