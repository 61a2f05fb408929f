"""What a case of kind "equilibrium" says: plain data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import jax
from pydantic import model_validator

from ...cases.bounds import Integer, Number, Times, Vector, fault, limits
from ...cases.laws import AnyGrowth, AnyLaw, checked_law
from ...cases.table import Case, Table
from ...materials.material import has_bulk_modulus


class BodyTable(Table):
    """A mesh of tetrahedra with its tissue and its supports.

    Cell data ``density_kg_m3``, and without ``[[law]]`` also ``youngs_modulus_kPa`` and ``poisson_ratio``. Point data ``fixed``
    (0 or 1), and where there is need of them: ``prescribed_displacement`` (three components [mm], of fixed nodes), ``sliding``
    (0 or 1: corners of boundary faces that slide without friction along the planes that they lie in at first),
    ``pressurised`` (0 or 1: corners of boundary faces that bear ``loads.pressure_kPa``).
    """

    mesh: Path
    mesh_unit: Literal["mm", "cm", "m"] = "mm"


class Loads(Table):
    """What pulls at the body."""

    gravity_m_s2: Vector = (0.0, -9.81, 0.0)
    pressure_kPa: Number = 0.0  # from outside, along the normal that the faces have once they are deformed


class HistoryTable(Table):
    """Shares of the loads and of prescribed displacements at some times, linear between; the body is led through them."""

    time_h: Times
    share: tuple[Number, ...]
    steps_per_segment: Annotated[Integer, limits(least=1, most=100_000)] = 10

    @model_validator(mode="after")
    def _fits_together(self) -> HistoryTable:
        if len(self.share) != len(self.time_h):
            raise fault("share", f"must have as many values as time_h ({len(self.time_h)}); got {len(self.share)}")
        return self


class Solver(Table):
    """What is looked for, and how exactly."""

    inverse: bool = False  # the mesh is the loaded shape, and the unloaded one is looked for
    relative_tolerance: Annotated[Number, limits(above=0.0, most=1e-2)] = 1e-8
    linear: Literal["direct", "mumps", "gamg"] = "direct"  # of several ranks "direct" is MUMPS; both others need PETSc


class EquilibriumCase(Case):
    """Mechanics alone: a body on a mesh of the user's, under gravity.

    ``[[law]]`` gives all of it one tissue, that of ``kind = "material-point"``; ``[history]`` leads it through time.
    """

    files: ClassVar[tuple[str, ...]] = ("body.mesh",)
    kind: Literal["equilibrium"] = "equilibrium"
    body: BodyTable
    law: tuple[AnyLaw, ...] = ()  # pyright: ignore[reportInvalidTypeForm]
    growth: AnyGrowth | None = None  # pyright: ignore[reportInvalidTypeForm]
    loads: Loads = Loads()
    history: HistoryTable | None = None
    solver: Solver = Solver()

    @model_validator(mode="after")
    def _goes_together(self) -> EquilibriumCase:
        if not self.law and self.growth:
            raise fault("growth", "needs a tissue: give [[law]]")
        law = checked_law(self) if self.law else None
        if law is not None and not has_bulk_modulus(law):
            raise fault("law", "must bear change of volume in a body: give kappa_kPa of a part a value above 0")
        if law is not None and self.history is None and jax.tree.leaves(law.initial_state((1,))):
            raise fault("history", "is missing: the law's answer depends on time")
        if self.history is not None and self.solver.inverse:
            raise fault("history", "leads a body forward: leave solver.inverse out")
        return self
