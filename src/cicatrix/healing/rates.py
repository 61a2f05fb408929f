"""Conversion of physical rates to automaton rules on a lattice of any pitch h, and the calibrated default rates.

The reference is one cell per site: pitch 10 um, one cell cycle (``hours_per_step``) per step. A coarser site stands for
a block of cells, and one step takes k cell cycles. In 2-D k = h / 10 um, but at most 5, so that the mechanical feedback can
raise the division probability without exceeding 1. In 3-D k is also at most h / (2 p_layer layer_um), so that without feedback
a straight front advances half a site per step: a front that advances several sites per step becomes faceted along the lattice
planes, however large the motility. The rates are converted as follows:

* layer: a cell of the layer divides at the rate p_layer / hours_per_step at any pitch. The daughters of a layer of
  thickness delta advance a straight front at the speed v = (p_layer / hours_per_step) delta. So p(h) = k p_layer, and
  layer_sites = layer_um / h, rounded.
* edge: per step the front advances by a fraction of a site that is proportional to p_edge,
  v = f p_edge h / (k hours_per_step), so p_edge(h) = k p_edge 10 um / h.
* motility: n sub-steps diffuse with D = n h^2 c / dt (c = 3/16 in 2-D, 1/8 in 3-D), so the same D needs
  n(h) = n k (10 um / h)^2, rounded to a whole number, at least 1.

The conversion preserves the speed of the front in mm/day from both kinds of division, the thickness of the layer up to rounding,
and D as long as the unrounded n(h) is at least 1. At coarser pitches the single sub-step makes D too large: 2.5 times at 100 um
in 2-D, and 10, 16 and 26 times at 100, 150 and 250 um in 3-D, which still smooths no more than 1 mm while a wound closes.
The following are not preserved: the noise of the front, which grows with the pitch; features smaller than a few sites; and
curvature flow where the lattice pins the level set. docs/decisions/0005 has the measurements.
"""

from __future__ import annotations

import numpy as np

from ..core.errors import InputError
from .rules import AutomatonRules

CELL_UM = 10.0  # pitch at which one site is one cell; the rates refer to this pitch

# Calibrated to clinical closure times: docs/decisions/0005-closure-rates.md, papers/clinic-closure.
HOURS_PER_STEP = 15.0
P_EDGE = 0.2
P_LAYER = 0.035
LAYER_UM = 1200.0
MOTILITY_SUBSTEPS = 8

MAX_STEP = 5.0  # upper limit of a step [cell cycles]
SITES_PER_STEP = 0.5  # upper limit of the advance of a straight front per step, in 3-D [sites]


def cycles_per_step(pitch_um: float, n_axes: int = 2, p_layer: float = P_LAYER, layer_um: float = LAYER_UM) -> float:
    """Return the number k of cell cycles per step on a lattice of given pitch; raises InputError if the pitch is not positive."""
    if not (np.isfinite(pitch_um) and pitch_um > 0):
        raise InputError(f"pitch_um must be positive; got {pitch_um}")
    most = min(pitch_um / CELL_UM, MAX_STEP)
    is_fast = n_axes == 3 and p_layer * layer_um > SITES_PER_STEP * CELL_UM
    return min(most, SITES_PER_STEP * pitch_um / (p_layer * layer_um)) if is_fast else most


def rules_at_pitch(
    pitch_um: float,
    n_axes: int = 2,
    *,
    p_edge: float = P_EDGE,
    p_layer: float = P_LAYER,
    layer_um: float = LAYER_UM,
    motility_substeps: int = MOTILITY_SUBSTEPS,
    **others,
) -> AutomatonRules:
    """Return automaton rules for a lattice of given pitch from rates at 10 um; ``others`` are passed to ``AutomatonRules``.

    Parameters
    ----------
    pitch_um : float
        Pitch of the lattice [um].
    n_axes : int
        Dimension of the lattice, 2 or 3.
    p_edge, p_layer : float
        Probabilities per cell cycle at 10 um [1].
    layer_um : float
        Thickness of the active layer [um].
    motility_substeps : int
        Sub-steps per cell cycle at 10 um.

    Raises
    ------
    InputError
        If the pitch is not positive, the layer is thinner than one site, or a probability at the lattice's pitch exceeds 1.
    """
    cycles, scale = cycles_per_step(pitch_um, n_axes, p_layer, layer_um), pitch_um / CELL_UM
    if not (np.isfinite(layer_um) and layer_um >= 0):
        raise InputError(f"layer_um must be zero or positive; got {layer_um}")
    if not p_layer * cycles <= 1:
        raise InputError(
            f"p_layer = {p_layer} at 10 um becomes {p_layer * cycles:.3g} at pitch_um = {pitch_um}, above 1: "
            f"take pitch_um <= {CELL_UM / p_layer:.3g}"
        )
    layer_sites = round(layer_um / pitch_um)
    if layer_um > 0 and layer_sites < 1:
        raise InputError(f"layer_um = {layer_um} is thinner than one site of pitch_um = {pitch_um}: take a finer pitch")
    n_substeps = max(1, round(motility_substeps * cycles / scale**2)) if motility_substeps else 0
    return AutomatonRules(
        p_edge=p_edge * (cycles / scale),
        p_layer=p_layer * cycles,
        layer_sites=layer_sites,
        motility_substeps=n_substeps,
        **others,
    )


def hours_per_step_at_pitch(
    pitch_um: float,
    hours_per_step: float = HOURS_PER_STEP,
    n_axes: int = 2,
    *,
    p_layer: float = P_LAYER,
    layer_um: float = LAYER_UM,
) -> float:
    """Return the duration of one automaton step [h] on a lattice of given pitch.

    ``hours_per_step`` is the duration of a cell cycle [h]; the other arguments are those of ``rules_at_pitch``.
    """
    if not (np.isfinite(hours_per_step) and hours_per_step > 0):
        raise InputError(f"hours_per_step must be positive; got {hours_per_step}")
    return hours_per_step * cycles_per_step(pitch_um, n_axes, p_layer, layer_um)


def straight_front_speed(
    p_layer: float = P_LAYER, layer_um: float = LAYER_UM, hours_per_step: float = HOURS_PER_STEP
) -> float:
    """Return the speed at which layer division alone advances a straight front [mm/day]: p_layer layer_um / hours_per_step."""
    return p_layer * layer_um * 1e-3 * 24 / hours_per_step
