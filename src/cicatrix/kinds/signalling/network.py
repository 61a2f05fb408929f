"""The network of a signalling case, read from the files that the case names."""

from __future__ import annotations

from ...biology.network_model import NetworkModel
from ...core.errors import InputError
from ...core.units import seconds_from_hours
from ...files.networks import read_network
from ...files.sbml import Changes, read_sbml
from .case import SignallingCase

COLUMNS = ("step", "time_h")  # columns of history.csv before those of the species


def read_model(case: SignallingCase) -> NetworkModel:
    """Read the network that a case names, with the inputs that the case sets as independent constants.

    Raises
    ------
    InputError
        If a file is not valid; the message names the file, the row and the error.
    """
    table = case.network
    if table.sbml is not None:
        path, model = table.sbml, read_sbml(table.sbml, table.time_unit, _changes(case))
    else:
        assert table.species is not None
        assert table.reactions is not None
        path, model = (
            table.species,
            read_network(table.species, table.reactions, table.inhibition, table.time_unit, may_assume=True),
        )
    for name in (*model.law.species, *model.law.shown):
        if name in COLUMNS or name.startswith("input_"):
            raise InputError(f'{path}: species "{name}" must have another name: history.csv has a column of this name')
    return model


def _changes(case: SignallingCase) -> Changes:
    """Return the constants that the case sets or varies: time [s] and value from then on."""
    varied = {case.steady.over: ()} if case.steady.over else {}
    return varied | {
        name: tuple(zip(map(seconds_from_hours, schedule.time_h), schedule.value))
        for name, schedule in case.set.items()
    }
