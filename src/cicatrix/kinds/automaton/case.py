"""What a case of kind "automaton" says: plain data; sizes in sites where no unit is named."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, model_validator
from pydantic_core import PydanticCustomError

from ...cases.bounds import OUT_OF_RANGE, Integer, NotNegative, Number, Positive, Probability, fault, limits
from ...cases.table import Case, Table

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


class AutomatonCase(Case):
    """Healing alone: a wound on a lattice, closed by cells."""

    files: ClassVar[tuple[str, ...]] = ("lattice.fillable", "wound.mask", "cue.W")
    kind: Literal["automaton"] = "automaton"
    lattice: LatticeTable = LatticeTable()
    wound: Wound
    rules: Rules = Rules()
    cue: CueTable = CueTable()
    run: Run = Run()

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return self.run.seed

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
