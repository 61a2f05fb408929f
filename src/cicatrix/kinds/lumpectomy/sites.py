"""How many sites a lattice over the cavity takes, and whether they fit into memory."""

from __future__ import annotations

import numpy as np

from ...core.units import mm_from_um
from ...geometry.hexgrid import Lattice
from ...healing.rules import AutomatonRules

MOST_SITES = 30_000_000  # of a solid: a run on so many takes about 1.5 GB for them alone
FEWER = 0.9  # of them, when a coarser pitch is proposed


def box_around(points: np.ndarray, rules: AutomatonRules, pitch_um: float) -> np.ndarray:
    """Box (2, n_axes) [mm] that holds the cavity's points (n, n_axes) [mm], its active layer and what may move there."""
    margin = (rules.layer_sites + 3 * rules.motility_substeps + 4) * mm_from_um(pitch_um)
    return np.stack([points.min(axis=0) - margin, points.max(axis=0) + margin])


def too_many(lattice: Lattice, pitch_um: float) -> str:
    """Say of the key ``healing.pitch_um`` why a solid's lattice does not fit and which pitch would; empty if it does."""
    if lattice.ndim == 2 or lattice.n_sites <= MOST_SITES:
        return ""
    fits = pitch_um * np.cbrt(lattice.n_sites / (FEWER * MOST_SITES))
    return (
        f"puts {lattice.n_sites:.2g} sites over the cavity, and {MOST_SITES:.1g} fit into memory: "
        f"take at least {5 * np.ceil(fits / 5):.0f}; got {pitch_um:g}"
    )
