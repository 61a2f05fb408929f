"""Tables of a case of kind "automaton": plain data; sizes are in sites where no unit is named."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, model_validator
from pydantic_core import PydanticCustomError

from ...cases.bounds import OUT_OF_RANGE, Integer, NotNegative, Number, Positive, Probability, bounds, fault
from ...cases.table import Case, Table

DIMENSIONS = {"hex": 2, "fcc": 3}
NEIGHBOURS = {"hex": 6, "fcc": 12}
HEIGHTS = {
    "hex": math.sqrt(3.0) / 2.0,
    "fcc": math.sqrt(2.0 / 3.0),
}  # distance of the rows or layers of sites over the pitch
Whole = Annotated[Integer, bounds(least=0)]
Size = Annotated[Integer, bounds(least=1)]


class LatticeTable(Table):
    """A block of sites: hexagonal (2-D) or face-centred cubic (3-D)."""

    type: Literal["hex", "fcc"] = "hex"  # hexagonal in 2-D, or face-centred cubic in 3-D
    size: tuple[Size, ...] = (512, 512)  # number of sites along each axis
    pitch_um: Annotated[Number, bounds(least=1e-3, most=1e6)] = 10.0  # distance between neighbouring sites
    fillable: Path | None = None  # .npy mask: sites that can ever contain a cell; all by default

    @property
    def inradius_um(self) -> float:
        """Largest radius of a disc or ball at the centre that fits into the block of sites [um]."""
        return 0.5 * (min(self.size) - 1) * HEIGHTS[self.type] * self.pitch_um

    @model_validator(mode="after")
    def _has_its_axes(self) -> LatticeTable:
        if len(self.size) != DIMENSIONS[self.type]:
            raise fault(
                "size", f'must be {DIMENSIONS[self.type]} numbers for type = "{self.type}"; got {list(self.size)}'
            )
        return self


class WoundTable(Table):
    """The open sites: a disc or ball at the centre of the lattice, or a mask."""

    shape: Literal["disc", "ball"] | None = None  # by default that of the lattice: a disc in 2-D, a ball in 3-D
    radius_um: Positive | None = None  # radius of the disc or ball; give this or mask
    mask: Path | None = None  # .npy mask: true where the wound is open

    @model_validator(mode="after")
    def _one_wound(self) -> WoundTable:
        if (self.mask is None) == (self.radius_um is None):
            raise fault("radius_um", "or mask must be given, one of the two")
        return self


class RulesTable(Table):
    """Rules for division and motion of a cell in one step: :class:`...healing.rules.AutomatonRules`."""

    p_edge: Probability = 0.2  # probability that a cell with a free neighbouring site divides into it
    p_layer: Probability = 0.02  # probability that a cell of the active layer divides, without feedback
    layer_sites: Annotated[Integer, bounds(least=0, most=4096)] = 8  # thickness of the active layer; 0: no layer
    motility_substeps: Annotated[Integer, bounds(least=0, most=4096)] = 8  # diffusion substeps per step; 0: no motion
    redistribution: Literal["route", "level-set"] = "route"  # daughters follow shortest paths, or a level set
    feedback: Number = 0.0  # effect of strain energy: p_layer is multiplied by 1 + feedback W / W_ref
    contact_inhibition: Annotated[Integer, bounds(least=1, most=12)] = 1  # free neighbours a dividing edge cell needs
    path_noise: Annotated[NotNegative, bounds(most=16.0)] = 0.5  # largest random cost of a site over the cost of a hop

    @model_validator(mode="after")
    def _level_set_moves(self) -> RulesTable:
        if self.redistribution == "level-set" and self.motility_substeps == 0:
            raise fault("motility_substeps", 'must be at least 1 for redistribution = "level-set"; got 0')
        return self


def _number_or_file(value: object) -> object:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    if isinstance(value, Path) or is_number:
        return value
    raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": "must be a finite number or the name of a .npy file"})


class CueTable(Table):
    """Strain energy density that the cells sense [kPa]: one number, or an array on the lattice."""

    W_ref: Positive = 1.0  # reference value that W is divided by
    W: Annotated[float | Path, BeforeValidator(_number_or_file)] = 0.0  # a number, or a .npy file with one per site


class AutomatonRunTable(Table):
    """Seed of the random numbers and the largest number of steps."""

    seed: Annotated[Integer, bounds(least=0, below=2**63)] = 1  # equal seeds give equal random numbers
    max_steps: Annotated[Integer, bounds(least=1)] = 100_000  # the run ends here if the wound is still open


class AutomatonCase(Case):
    """The cellular automaton alone: a wound on a lattice, closed by cells."""

    files: ClassVar[tuple[str, ...]] = ("lattice.fillable", "wound.mask", "cue.W")
    kind: Literal["automaton"] = "automaton"  # kind of the case
    lattice: LatticeTable = LatticeTable()
    wound: WoundTable
    rules: RulesTable = RulesTable()
    cue: CueTable = CueTable()
    run: AutomatonRunTable = AutomatonRunTable()

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return self.run.seed

    @model_validator(mode="after")
    def _wound_fits_lattice(self) -> AutomatonCase:
        radius, largest = self.wound.radius_um, self.lattice.inradius_um
        if radius is not None and largest <= 0.0:
            raise fault(
                "lattice.size", f"must hold a wound and cells around it; {list(self.lattice.size)} is a single row"
            )
        if radius is not None and radius > largest:
            words = f"must be at most {largest:.0f}, or the wound is larger than the lattice; got {radius:g}"
            raise fault("wound.radius_um", words)
        return self

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
