"""What ``cicatrix check`` opens in a case of kind "tissue-cell": the network of its signal."""

from __future__ import annotations

from .case import TissueCellCase


def network(case: TissueCellCase) -> None:
    """Read the network, and build the model with it; InputError as :func:`.build.model_of`."""
    from .build import model_of  # with it comes the solver, which a case without a network does not need
    from .run import network_of

    model_of(case, network_of(case))


PARTS = {"signal.species": network}
