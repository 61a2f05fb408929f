"""Rules of the automaton: probabilities and other parameters of one step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.errors import InputError

REDISTRIBUTIONS = ("route", "level-set")


@dataclass(frozen=True, kw_only=True)
class AutomatonRules:
    """Probabilities and other parameters of one step of the automaton.

    Parameters
    ----------
    p_edge : float
        Probability that a cell with a free neighbour site divides into that site [1].
    p_layer : float
        Probability p0 that a cell of the active layer divides, without feedback [1].
    layer_sites : int
        Thickness of the active layer, as the hop distance from the nearest empty site. 0: no layer.
    motility_substeps : int
        Number of diffusion sub-steps per step. 0: no motility.
    redistribution : "route" or "level-set"
        How daughters of the layer reach the wound: along noisy shortest paths, or by diffusion and a level set.
    feedback : float
        Factor of the mechanical feedback F(W) = feedback W / W_ref; the division probability in the layer is
        p_layer (1 + F). 0: one-way coupling [1].
    min_free_neighbours : int
        Contact inhibition: smallest number of free neighbours with which a cell divides at the edge.
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
            object.__setattr__(self, name, int(value))
        known = " or ".join(f'"{name}"' for name in REDISTRIBUTIONS)
        _require(self.redistribution in REDISTRIBUTIONS, f"redistribution must be {known}", self.redistribution)
        _require(np.isfinite(self.feedback), "feedback must be finite", self.feedback)
        _require(0 <= self.path_noise <= 16, "path_noise must lie in [0, 16]", self.path_noise)
        if self.redistribution == "level-set" and self.motility_substeps == 0:
            raise InputError('AutomatonRules: redistribution = "level-set" needs motility_substeps >= 1; got 0')


def _require(is_fine: bool, rule: str, value: object) -> None:
    if not is_fine:
        raise InputError(f"AutomatonRules.{rule}; got {value}")
