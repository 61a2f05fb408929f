"""Number of sites of a lattice on the cavity, and whether they fit into memory."""

from __future__ import annotations

import numpy as np

from ...core.units import mm_from_um
from ...geometry.hexgrid import Lattice
from ...healing.rules import AutomatonRules

# largest lattice of a section and of a solid; the sites of a solid alone take about 1.5 GB
MAX_SITES = {2: 200_000_000, 3: 30_000_000}
FEWER = 0.9  # fraction of MAX_SITES that a proposed coarser pitch fills


def box_around(points: np.ndarray, rules: AutomatonRules, pitch_um: float) -> np.ndarray:
    """Return the box (2, n_axes) [mm] around the cavity's points (n, n_axes) [mm], its active layer and a margin for motion."""
    margin = (rules.layer_sites + 3 * rules.motility_substeps + 4) * mm_from_um(pitch_um)
    return np.stack([points.min(axis=0) - margin, points.max(axis=0) + margin])


def too_many(box: np.ndarray, pitch_um: float) -> str:
    """Return why a lattice over a box does not fit into memory, to follow the key ``healing.pitch_um``; empty if it fits.

    The box has a lower and an upper corner (2, n_axes) [mm].
    """
    n_axes, pitch_mm = box.shape[1], mm_from_um(pitch_um)
    sites = float(np.prod((box[1] - box[0]) / pitch_mm))  # at least; a lattice too large for this count is not laid out
    if sites <= MAX_SITES[n_axes]:
        sites = Lattice.covering(box[0], box[1], pitch_mm).n_sites
    if sites <= MAX_SITES[n_axes]:
        return ""
    fits = pitch_um * (sites / (FEWER * MAX_SITES[n_axes])) ** (1.0 / n_axes)
    return (
        f"puts {sites:.2g} sites over the cavity, and {MAX_SITES[n_axes]:.1g} fit into memory: "
        f"take at least {5 * np.ceil(fits / 5):.0f}; got {pitch_um:g}"
    )
