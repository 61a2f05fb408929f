"""Keys of a case that name groups of a mesh: physical groups of Gmsh, sets of Abaqus and others."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from .bounds import PoissonRatio, Positive
from .table import Table


def _listed(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


GroupNames = Annotated[tuple[str, ...], BeforeValidator(_listed)]


class GroupTissueTable(Table):
    """Tissue of a group of tetrahedra of the mesh; what is left out is taken from the cell data of the mesh."""

    E_kPa: Positive | None = None  # Young's modulus at small strain; not used with [[law]]
    nu: PoissonRatio | None = None  # Poisson's ratio at small strain; not used with [[law]]
    density_kg_m3: Positive | None = None  # mass density
