"""Number of sites of a lattice on the cavity, and whether they fit into memory."""

from __future__ import annotations

import numpy as np

from ...core.units import mm_from_um
from ...geometry.hexgrid import Lattice
from ...healing.rules import AutomatonRules

MAX_SOLID_SITES = 30_000_000  # largest lattice of a solid; its sites alone take about 1.5 GB
FEWER = 0.9  # fraction of MAX_SOLID_SITES that a proposed coarser pitch fills


def box_around(points: np.ndarray, rules: AutomatonRules, pitch_um: float) -> np.ndarray:
    """Return the box (2, n_axes) [mm] around the cavity's points (n, n_axes) [mm], its active layer and a margin for motion."""
    margin = (rules.layer_sites + 3 * rules.motility_substeps + 4) * mm_from_um(pitch_um)
    return np.stack([points.min(axis=0) - margin, points.max(axis=0) + margin])


def too_many(lattice: Lattice, pitch_um: float) -> str:
    """Return an error if a solid's lattice does not fit into memory, to follow the key ``healing.pitch_um``; empty if it fits."""
    if lattice.ndim == 2 or lattice.n_sites <= MAX_SOLID_SITES:
        return ""
    fits = pitch_um * np.cbrt(lattice.n_sites / (FEWER * MAX_SOLID_SITES))
    return (
        f"puts {lattice.n_sites:.2g} sites over the cavity, and {MAX_SOLID_SITES:.1g} fit into memory: "
        f"take at least {5 * np.ceil(fits / 5):.0f}; got {pitch_um:g}"
    )
