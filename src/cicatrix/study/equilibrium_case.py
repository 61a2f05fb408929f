"""What a case of kind "equilibrium" says: plain data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from .case import Table
from .limits import Number, Vector, limits


class BodyTable(Table):
    """A mesh of tetrahedra with its tissue and its supports.

    Cell data ``youngs_modulus_kPa``, ``poisson_ratio``, ``density_kg_m3``. Point data ``fixed`` (0 or 1), and where there is
    need of them: ``prescribed_displacement`` (three components [mm], of fixed nodes), ``sliding`` (0 or 1: corners of
    boundary faces that slide without friction along the planes that they lie in at first), ``pressurised`` (0 or 1: corners
    of boundary faces that bear ``loads.pressure_kPa``).
    """

    mesh: Path
    mesh_unit: Literal["mm", "cm", "m"] = "mm"


class Loads(Table):
    """What pulls at the body."""

    gravity_m_s2: Vector = (0.0, -9.81, 0.0)
    pressure_kPa: Number = 0.0  # from outside, along the normal that the faces have once they are deformed


class Solver(Table):
    """What is looked for, and how exactly."""

    inverse: bool = False  # the mesh is the loaded shape, and the unloaded one is looked for
    relative_tolerance: Annotated[Number, limits(above=0.0, most=1e-2)] = 1e-8
    linear: Literal["direct", "mumps", "gamg"] = "direct"  # of several ranks "direct" is MUMPS; both others need PETSc


class EquilibriumCase(Table):
    """Mechanics alone: a body on a mesh of the user's, under gravity."""

    kind: Literal["equilibrium"] = "equilibrium"
    body: BodyTable
    loads: Loads = Loads()
    solver: Solver = Solver()

    @property
    def seed(self) -> int:
        """Nothing is drawn."""
        return 0
