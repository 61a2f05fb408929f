"""The network of a signalling case, read from the files that the case names."""

from __future__ import annotations

from ...biology.network_model import Model
from ...cases.networks import NetworkTable
from ...core.errors import InputError
from ...files.networks import read_network
from ...files.sbml import read_sbml
from .build import refuse_unknown
from .case import SignallingCase

COLUMNS = ("step", "time_h")  # of history.csv, beside the species


def read_model(table: NetworkTable) -> Model:
    """Read the network that a case names.

    Raises
    ------
    InputError
        With the file, the row and what is wrong there.
    """
    if table.sbml is not None:
        path, model = table.sbml, read_sbml(table.sbml, table.time_unit)
    else:
        assert table.species is not None
        assert table.reactions is not None
        path, model = table.species, read_network(table.species, table.reactions, table.inhibition)
    for name in model.law.species:
        if name in COLUMNS or name.startswith("input_"):
            raise InputError(f'{path}: species "{name}" must have another name: history.csv has a column of that one')
    return model


def faults_of(case: SignallingCase) -> list[str]:
    """What of a sound case does not fit its network, or of the network itself: one sentence, or none."""
    try:
        refuse_unknown(case, read_model(case.network))
    except InputError as error:
        return [str(error)]
    return []
