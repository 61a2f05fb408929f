"""Table that names the files of a signalling network."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import model_validator

from .bounds import fault
from .table import Table


class NetworkTable(Table):
    """Where the network is: two CSV files, or one of SBML."""

    species: Path | None = None
    reactions: Path | None = None
    inhibition: Literal["complement", "weighted"] = "complement"
    sbml: Path | None = None
    time_unit: Literal["s", "min", "h", "d"] = "s"  # of an SBML file

    @model_validator(mode="after")
    def _one_of_two(self) -> NetworkTable:
        if self.sbml is not None and (self.species is not None or self.reactions is not None):
            raise fault("sbml", "must be given without species and reactions, or those two without it")
        if self.sbml is None and self.species is None:
            raise fault("species", "is missing: species and reactions name CSV files, or sbml one of SBML")
        if self.sbml is None and self.reactions is None:
            raise fault("reactions", "is missing, which belongs to species")
        return self
