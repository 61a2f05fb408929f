"""Build the wound on its lattice and the cue of its cells from a case of kind "automaton"."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...core.errors import InputError
from ...core.units import mm_from_um
from ...files.arrays import read_array
from ...geometry.hexgrid import Lattice
from ...healing.automaton import Automaton
from ...healing.cue import Cue
from ...healing.rules import AutomatonRules
from .case import AutomatonCase


def automaton_of(case: AutomatonCase) -> Automaton:
    """Build the automaton with the wound of a case on its lattice.

    Raises
    ------
    InputError
        If a mask does not fit the lattice, the wound is larger than the lattice, or there is no cell or no open site.
    """
    pitch = mm_from_um(case.lattice.pitch_um)
    lattice = Lattice(case.lattice.size, pitch, (0.0,) * len(case.lattice.size))
    fillable = np.ones(lattice.shape, bool)
    if case.lattice.fillable is not None:
        fillable = _read_mask(case.lattice.fillable, "lattice.fillable", lattice)
    open0 = _open_sites(case, lattice) & fillable
    if not open0.any():
        raise InputError("the wound has no site that can be filled: make it larger, or check lattice.fillable")
    if not (fillable & ~open0).any():
        raise InputError(
            "the wound leaves no cell that could close it: make it smaller, or check that wound.mask is not inverted"
        )
    r = case.rules
    rules = AutomatonRules(
        p_edge=r.p_edge,
        p_layer=r.p_layer,
        layer_sites=r.layer_sites,
        motility_substeps=r.motility_substeps,
        redistribution=r.redistribution,
        feedback=r.feedback,
        min_free_neighbours=r.contact_inhibition,
        path_noise=r.path_noise,
    )
    return Automaton(lattice, fillable, open0, rules, case.run.seed)


def cue_of(case: AutomatonCase) -> Cue:
    """Build the cue of a case: the strain energy density that the cells sense.

    Raises
    ------
    InputError
        If the file of the cue does not contain numbers.
    """
    if isinstance(case.cue.W, Path):
        W = read_array(case.cue.W, "cue.W")
        if W.dtype.kind not in "fiu":
            raise InputError(f"cue.W must hold numbers; {case.cue.W.name} holds {W.dtype}")
        return Cue(W.astype(float), case.cue.W_ref)
    return Cue(case.cue.W, case.cue.W_ref)


def _open_sites(case: AutomatonCase, lattice: Lattice) -> np.ndarray:
    if case.wound.mask is not None:
        return _read_mask(case.wound.mask, "wound.mask", lattice)
    return lattice.near_middle(mm_from_um(case.wound.radius_um or 0.0))


def _read_mask(path: Path, key: str, lattice: Lattice) -> np.ndarray:
    mask = read_array(path, key)
    if mask.shape != lattice.shape or mask.dtype.kind not in "bui":
        raise InputError(
            f"{key} must be a mask (true or false, or 0 and 1) of the lattice's shape {list(lattice.shape)}; "
            f"{path.name} holds {mask.dtype} {list(mask.shape)}"
        )
    return mask != 0
