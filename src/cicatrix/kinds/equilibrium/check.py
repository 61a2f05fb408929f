"""What ``cicatrix check`` opens in a case of kind "equilibrium": its mesh."""

from __future__ import annotations

from collections.abc import Sequence

from ...files.mesh_doubts import doubts_of
from .case import EquilibriumCase
from .mesh import given_body

ANY_TISSUE = 1.0, 0.3  # E [kPa] and nu that stand in for those of a law while only the mesh is checked


def body(case: EquilibriumCase) -> Sequence[str]:
    """Read the mesh with its tissue and supports; return what is doubted. InputError as :func:`.mesh.given_body`."""
    given = given_body(case, ANY_TISSUE if case.law else None)
    return [*given.notes, *doubts_of(given)]


PARTS = {"body.mesh": body}
