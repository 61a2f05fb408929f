"""Table that names the files of a signalling network."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import model_validator

from .bounds import fault
from .table import Table


class NetworkTable(Table):
    """Files of the network: two CSV files, or one SBML file."""

    species: Path | None = None  # CSV file of species: id, y_init, y_max, tau_h; or a sheet of Netflux
    reactions: Path | None = None  # CSV file of reactions: id, rule, weight, n, ec50; or a sheet of Netflux
    inhibition: Literal["complement", "weighted"] | None = (
        None  # NOT is 1 - activity (default), or w - activity (Netflux's)
    )
    sbml: Path | None = None  # SBML file, instead of the two CSV files
    time_unit: Literal["s", "min", "h", "d"] | None = (
        None  # unit of time in the SBML file (default: what it states, else s), or of a column tau (default: h)
    )

    @model_validator(mode="after")
    def _one_of_two(self) -> NetworkTable:
        if self.sbml is not None and (self.species is not None or self.reactions is not None):
            raise fault("sbml", "must be given without species and reactions, or those two without it")
        if self.sbml is None and self.species is None:
            raise fault("species", "is missing: name CSV files by species and reactions, or an SBML file by sbml")
        if self.sbml is None and self.reactions is None:
            raise fault("reactions", "is missing: a network in CSV files needs both species and reactions")
        return self
