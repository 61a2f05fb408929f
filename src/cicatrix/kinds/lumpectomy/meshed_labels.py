"""Mesh of the breast in a label map with its tissue, for mechanics alone."""

from __future__ import annotations

import numpy as np

from ...geometry.meshing3d import BodyMesh, mesh_body
from ...geometry.tetrahedra import with_middles
from ...materials.neo_hookean import young_from_moduli
from ...mechanics.space import SolidSpace
from .body import Anatomy, quadrature_points, shares_at, tissue_of
from .case import TissueTable


def meshed_labels(
    anatomy: Anatomy, edge_mm: float, tissue: TissueTable
) -> tuple[BodyMesh, np.ndarray, np.ndarray, np.ndarray]:
    """Mesh the breast, and give each tetrahedron the mean elastic constants and density of its tissue.

    Returns
    -------
    BodyMesh, E (m,) [kPa], nu (m,) [1], density (m,) [kg/mm^3]

    Raises
    ------
    InputError
        If there is no breast, it touches no chest wall, or meshing fails.
    """
    mesh = mesh_body(anatomy.domain, edge_mm, tissue=anatomy.body, wall_mm=anatomy.wall_mm)
    space = SolidSpace(*with_middles(mesh.nodes, mesh.tetrahedra))
    found = tissue_of(tissue, shares_at(anatomy, quadrature_points(space)))
    E, nu = young_from_moduli(found.mu.mean(axis=1), found.kappa.mean(axis=1))
    return mesh, E, nu, found.density.mean(axis=1)
