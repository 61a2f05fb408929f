"""What ``cicatrix check`` opens in a case of kind "automaton": its masks and its cue."""

from __future__ import annotations

from pathlib import Path

from .case import AutomatonCase


def lattice(case: AutomatonCase) -> None:
    """Read the masks and the cue, and lay them on the lattice; InputError as :func:`.run.model_of`."""
    if case.lattice.fillable or case.wound.mask or isinstance(case.cue.W, Path):
        from .run import model_of  # with it comes NumPy, which a case without files does not need

        model_of(case)


PARTS = {"lattice": lattice}
