"""What ``cicatrix check`` opens in a case of kind "wound": its mesh, and the network of its mechanosensing."""

from __future__ import annotations

from collections.abc import Sequence

from ...cases.continuum_laws import network_of, scarring_of
from .case import WoundCase


def body(case: WoundCase) -> Sequence[str]:
    """Read the mesh with its supports and its wound; return notes on it. InputError as :func:`.run.body_of`."""
    from .run import body_of  # with it comes the solver, which a case without a mesh does not need

    return body_of(case)[1]


def network(case: WoundCase) -> None:
    """Read the network, and find in it the input and the output that the case names; InputError as :func:`scarring_of`."""
    scarring_of(case, network_of(case.mechanosensing))


PARTS = {"body.mesh": body, "mechanosensing.species": network}
