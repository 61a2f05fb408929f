"""Tables of a case of kind "equilibrium": plain data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import jax
from pydantic import Field, model_validator

from ...cases.bounds import Integer, Number, Times, Vector, bounds, fault
from ...cases.groups import GroupNames, GroupTissueTable
from ...cases.laws import AnyGrowth, AnyLaw, checked_law
from ...cases.table import Case, Table
from ...materials.material import has_bulk_modulus


class BodyTable(Table):
    """A mesh of tetrahedra with its tissue and its supports.

    Cell data of the mesh are ``density_kg_m3`` and, without ``[[law]]``, ``youngs_modulus_kPa`` and ``poisson_ratio``.
    Point data are ``fixed`` (0 or 1) and, as needed, ``prescribed_displacement`` (three components [mm], of fixed nodes),
    ``sliding`` (0 or 1: corners of boundary faces that slide without friction along their initial planes) and ``pressurised``
    (0 or 1: corners of boundary faces that carry ``loads.pressure_kPa``). Instead of these data the keys below may name groups
    of the mesh: physical groups of Gmsh, sets and surfaces of Abaqus, references of Medit, or pieces of a VTU file.
    """

    mesh: Path  # mesh file: VTU, PVTU, legacy VTK, Gmsh, Abaqus or Medit
    mesh_unit: Literal["mm", "cm", "m"] = "mm"  # unit of the coordinates in the file
    fixed: GroupNames = ()  # groups of nodes that are fixed
    sliding: GroupNames = ()  # groups of boundary faces that slide without friction along their initial planes
    pressurised: GroupNames = ()  # groups of boundary faces that carry loads.pressure_kPa
    displacement_mm: dict[str, Vector] = Field(
        default_factory=dict
    )  # groups whose nodes are fixed after a displacement
    materials: dict[str, GroupTissueTable] = Field(default_factory=dict)  # tissue of groups of tetrahedra


class LoadsTable(Table):
    """Loads on the body."""

    gravity_m_s2: Vector = (0.0, -9.81, 0.0)  # gravitational acceleration along x, y and z
    pressure_kPa: Number = 0.0  # external pressure on the pressurised faces, along their deformed normals


class HistoryTable(Table):
    """Load history: a factor on the loads and on the prescribed displacements, piecewise linear in time."""

    time_h: Times  # times at which the factor is given
    share: tuple[Number, ...]  # the factor at these times; 1 is the full load
    steps_per_segment: Annotated[Integer, bounds(least=1, most=100_000)] = 10  # time steps between two given times

    @model_validator(mode="after")
    def _fits_together(self) -> HistoryTable:
        if len(self.share) != len(self.time_h):
            raise fault("share", f"must have as many values as time_h ({len(self.time_h)}); got {len(self.share)}")
        return self


class EquilibriumSolverTable(Table):
    """Forward or inverse problem, and its numerical solution.

    The linear solver "direct" factorises the matrix, on several MPI ranks by MUMPS. "mumps" and "gamg" (algebraic multigrid)
    need PETSc.
    """

    inverse: bool = False  # true: the mesh is the loaded shape, and the unloaded shape is computed
    relative_tolerance: Annotated[Number, bounds(above=0.0, most=1e-2)] = (
        1e-8  # residual over load where iterations end
    )
    linear: Literal["direct", "mumps", "gamg"] = "direct"  # solver of the linear systems


class EquilibriumCase(Case):
    """Mechanics alone: equilibrium of a body on the user's own mesh, under gravity and pressure.

    ``[[law]]`` gives the whole body one tissue, with the keys of ``kind = "material-point"``; ``[history]`` makes the loads vary
    in time.
    """

    files: ClassVar[tuple[str, ...]] = ("body.mesh",)
    kind: Literal["equilibrium"] = "equilibrium"  # kind of the case
    body: BodyTable
    # material of the whole body, the sum of all tables; without it the mesh has E and nu of each tetrahedron
    law: tuple[AnyLaw, ...] = ()  # pyright: ignore[reportInvalidTypeForm]
    # growth of the whole tissue
    growth: AnyGrowth | None = None  # pyright: ignore[reportInvalidTypeForm]
    loads: LoadsTable = LoadsTable()
    history: HistoryTable | None = None
    solver: EquilibriumSolverTable = EquilibriumSolverTable()

    @model_validator(mode="after")
    def _goes_together(self) -> EquilibriumCase:
        if not self.law and self.growth:
            raise fault("growth", "needs a tissue: give [[law]]")
        law = checked_law(self) if self.law else None
        if law is not None and not has_bulk_modulus(law):
            raise fault("law", "must have a bulk modulus in a body: set kappa_kPa of at least one [[law]] above 0")
        if law is not None and self.history is None and jax.tree.leaves(law.initial_state((1,))):
            raise fault("history", "is missing: the response of the law depends on time")
        if self.history is not None and self.solver.inverse:
            raise fault("history", "is for the forward problem: leave solver.inverse out")
        return self
