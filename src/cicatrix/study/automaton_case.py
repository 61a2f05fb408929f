"""What a case of kind "automaton" says, and the wound that it describes; sizes in sites where no unit is named."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, model_validator
from pydantic_core import PydanticCustomError

from ..core.errors import InputError
from ..core.units import mm_from_um
from ..geometry.hexgrid import Lattice
from ..healing.automaton import Automaton
from ..healing.model import Cue
from ..healing.rules import AutomatonRules
from .case import Table
from .limits import OUT_OF_RANGE, Integer, NotNegative, Number, Positive, Probability, fault, limits

DIMENSIONS = {"hex": 2, "fcc": 3}
NEIGHBOURS = {"hex": 6, "fcc": 12}
Whole = Annotated[Integer, limits(least=0)]
Size = Annotated[Integer, limits(least=1)]


class LatticeTable(Table):
    """A block of sites: hexagonal (2-D) or face-centred cubic (3-D)."""

    type: Literal["hex", "fcc"] = "hex"
    size: tuple[Size, ...] = (512, 512)
    pitch_um: Annotated[Number, limits(least=1e-3, most=1e6)] = 10.0
    fillable: Path | None = None  # .npy: sites that may ever hold a cell; all without it

    @model_validator(mode="after")
    def _has_its_axes(self) -> LatticeTable:
        if len(self.size) != DIMENSIONS[self.type]:
            raise fault(
                "size", f'must be {DIMENSIONS[self.type]} numbers for type = "{self.type}"; got {list(self.size)}'
            )
        return self


class Wound(Table):
    """The open sites: a disc or ball about the middle of the lattice, or a mask."""

    shape: Literal["disc", "ball"] | None = None
    radius_um: Positive | None = None
    mask: Path | None = None  # .npy: true where the wound is open

    @model_validator(mode="after")
    def _one_wound(self) -> Wound:
        if (self.mask is None) == (self.radius_um is None):
            raise fault("radius_um", "or mask must be given, one of the two")
        return self


class Rules(Table):
    """What a cell does in one step; see ``AutomatonRules``."""

    p_edge: Probability = 0.2
    p_layer: Probability = 0.02
    layer_sites: Annotated[Integer, limits(least=0, most=4096)] = 8
    motility_substeps: Annotated[Integer, limits(least=0, most=4096)] = 8
    redistribution: Literal["route", "level-set"] = "route"
    feedback: Number = 0.0
    contact_inhibition: Annotated[Integer, limits(least=1, most=12)] = 1
    path_noise: Annotated[NotNegative, limits(most=16.0)] = 0.5

    @model_validator(mode="after")
    def _level_set_moves(self) -> Rules:
        if self.redistribution == "level-set" and self.motility_substeps == 0:
            raise fault("motility_substeps", 'must be at least 1 for redistribution = "level-set"; got 0')
        return self


def _number_or_file(value: object) -> object:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if isinstance(value, Path) or is_number:
        return value
    raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": "must be a finite number or the name of a .npy file"})


class CueTable(Table):
    """Strain energy density that the cells feel [kPa]: one number, or an array on the lattice."""

    W_ref: Positive = 1.0
    W: Annotated[float | Path, BeforeValidator(_number_or_file)] = 0.0


class Run(Table):
    """Seed of the random numbers and the last step."""

    seed: Annotated[Integer, limits(least=0, below=2**63)] = 1
    max_steps: Annotated[Integer, limits(least=1)] = 100_000


class AutomatonCase(Table):
    """Healing alone: a wound on a lattice, closed by cells."""

    kind: Literal["automaton"] = "automaton"
    lattice: LatticeTable = LatticeTable()
    wound: Wound
    rules: Rules = Rules()
    cue: CueTable = CueTable()
    run: Run = Run()

    @model_validator(mode="after")
    def _shape_fits_lattice(self) -> AutomatonCase:
        fitting = {"hex": "disc", "fcc": "ball"}[self.lattice.type]
        if self.wound.shape not in (None, fitting):
            raise fault("wound.shape", f'must be "{fitting}" on a lattice of type "{self.lattice.type}"')
        most, given = NEIGHBOURS[self.lattice.type], self.rules.contact_inhibition
        if given > most:
            raise fault(
                "rules.contact_inhibition",
                f'must be at most {most} on a lattice of type "{self.lattice.type}"; got {given}',
            )
        return self


def automaton_of(case: AutomatonCase) -> Automaton:
    """The wound of a case on its lattice.

    Raises
    ------
    InputError
        If a mask does not fit the lattice, the wound is larger than it, or no cell or no wound is left.
    """
    pitch = mm_from_um(case.lattice.pitch_um)
    lattice = Lattice(case.lattice.size, pitch, (0.0,) * len(case.lattice.size))
    fillable = np.ones(lattice.shape, bool)
    if case.lattice.fillable is not None:
        fillable = _read_mask(case.lattice.fillable, "lattice.fillable", lattice)
    open0 = _open_sites(case, lattice) & fillable
    if not open0.any():
        raise InputError("the wound holds no site that can be filled: make it larger, or look at lattice.fillable")
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
    """The cue of a case.

    Raises
    ------
    InputError
        If its file holds no numbers.
    """
    if isinstance(case.cue.W, Path):
        W = _read_array(case.cue.W, "cue.W")
        if W.dtype.kind not in "fiu":
            raise InputError(f"cue.W must hold numbers; {case.cue.W.name} holds {W.dtype}")
        return Cue(W.astype(float), case.cue.W_ref)
    return Cue(case.cue.W, case.cue.W_ref)


def inradius_um(lattice: Lattice) -> float:
    """Largest radius of a disc or ball about the middle that the block of sites holds [um]."""
    heights = 1.0 / np.linalg.norm(np.linalg.inv(lattice.basis_mm), axis=0)
    return float(1e3 * np.min((np.array(lattice.shape) - 1) * heights) / 2)


def _open_sites(case: AutomatonCase, lattice: Lattice) -> np.ndarray:
    if case.wound.mask is not None:
        return _read_mask(case.wound.mask, "wound.mask", lattice)
    radius, largest = case.wound.radius_um or 0.0, inradius_um(lattice)
    if largest <= 0.0:
        raise InputError(f"lattice.size must hold a wound and cells around it; {list(lattice.shape)} is a single row")
    if radius > largest:
        raise InputError(
            f"wound.radius_um must be at most {largest:.0f}, or the wound is larger than the lattice; got {radius:g}"
        )
    return lattice.near_middle(mm_from_um(radius))


def _read_array(path: Path, key: str) -> np.ndarray:
    try:
        return np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        raise InputError(f"{key}: {path.name} is not a NumPy file (.npy) that can be read") from None


def _read_mask(path: Path, key: str, lattice: Lattice) -> np.ndarray:
    mask = _read_array(path, key)
    if mask.shape != lattice.shape or mask.dtype.kind not in "bui":
        raise InputError(
            f"{key} must be a mask (true or false, or 0 and 1) of the lattice's shape {list(lattice.shape)}; "
            f"{path.name} holds {mask.dtype} {list(mask.shape)}"
        )
    return mask != 0
