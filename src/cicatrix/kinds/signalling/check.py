"""What ``cicatrix check`` opens in a case of kind "signalling": its network."""

from __future__ import annotations

from collections.abc import Sequence

from ...biology.roadrunner import DelegatedNetwork
from .build import begun, refuse_undefined, refuse_unknown
from .case import SignallingCase
from .network import read_model


def network(case: SignallingCase) -> Sequence[str]:
    """Read the network, find in it the names that the case gives, and evaluate its rates at the start; return its notes."""
    model = read_model(case)
    refuse_unknown(case, model)
    if not isinstance(model.law, DelegatedNetwork):
        refuse_undefined(case, begun(case, model))
    return model.notes


PARTS = {"network": network}
