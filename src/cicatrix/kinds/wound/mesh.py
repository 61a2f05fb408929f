"""Read and check the mesh of a case of kind "wound", without building the body."""

from __future__ import annotations

import numpy as np

from ...files.meshes import ByGroup, TetrahedralMesh, read_wound
from .case import WoundBodyTable


def given_wound(body: WoundBodyTable) -> tuple[TetrahedralMesh, np.ndarray]:
    """Read the mesh that a case names; return it, and whether each tetrahedron belongs to the wound (m,) bool.

    Raises
    ------
    InputError
        If the mesh cannot be read, or is not valid for a body with a wound.
    """
    return read_wound(body.mesh, body.mesh_unit, ByGroup(fixed=body.fixed, wound=body.wound))
