"""Tables of a case of kind "wound": plain data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from ...cases.bounds import Integer, Number, Positive, bounds, fault
from ...cases.continuum import (
    VALUES,
    AnySensing,
    LogisticTable,
    ParametersTable,
    TimeTolerance,
    check_continuum,
)
from ...cases.groups import GroupNames
from ...cases.table import Case, Table


class WoundSolverTable(Table):
    """Accuracy of the time integration."""

    time_tolerance: TimeTolerance = 1e-4  # largest error of densities and permanent stretches in a time step
    iteration_tolerance: Annotated[Number, bounds(least=1e-12, most=1e-2)] | None = (
        None  # largest change in the last iteration of a step; default: a tenth of time_tolerance, at most 1e-5
    )
    first_step_h: Positive = 0.01  # first time step


class WoundBodyTable(Table):
    """A mesh of tetrahedra, with point data ``fixed`` and cell data ``wound``, both 0 or 1, or with groups that the keys name."""

    mesh: Path  # mesh file: VTU, PVTU, legacy VTK, Gmsh, Abaqus or Medit
    mesh_unit: Literal["mm", "cm", "m"] = "mm"  # unit of the coordinates in the file
    fixed: GroupNames = ()  # groups of nodes that are fixed, instead of the point data
    wound: GroupNames = ()  # groups of tetrahedra that form the wound, instead of the cell data


class WoundCase(Case):
    """A wound that heals by the continuum model: cells, cytokine and collagen on a body that the cells deform.

    ``mechanosensing`` is the mechanical signal that cells sense.
    """

    files: ClassVar[tuple[str, ...]] = ("body.mesh", "mechanosensing.species", "mechanosensing.reactions")
    kind: Literal["wound"] = "wound"  # kind of the case
    benchmark: Literal["circular-wound", "breast-cavity"] | None = None  # body and values of a reference wound
    body: WoundBodyTable | None = None  # a mesh instead of a benchmark, with the values of "breast-cavity"
    elements: Annotated[Integer, bounds(least=4, most=400)] | None = (
        None  # number of elements of a benchmark, per side of the sheet (default 40) or along the breast's diameter (16)
    )
    duration_h: Positive | None = None  # simulated time; default 336 for the circular wound, else 26 weeks
    coupling: Literal["two-way", "one-way"] = "two-way"  # "one-way": the body keeps its initial shape
    fields_every_h: Positive | None = None  # time between two written states; default: duration_h / 14
    # mechanical signal that the cells sense; one of the tables below
    mechanosensing: AnySensing = LogisticTable(type="logistic")  # pyright: ignore[reportInvalidTypeForm]
    parameters: ParametersTable = ParametersTable()
    solver: WoundSolverTable = WoundSolverTable()

    @property
    def is_sheet(self) -> bool:
        """Whether the body is a sheet in two dimensions."""
        return self.benchmark == "circular-wound"

    @property
    def values(self) -> dict[str, float]:
        """Parameters by key, from the case or else the benchmark; optional effects that are off have no key."""
        return VALUES[self.benchmark or "breast-cavity"] | self.parameters.model_dump(exclude_none=True)

    @property
    def hours(self) -> float:
        """Simulated time [h]."""
        return self.duration_h or (336.0 if self.is_sheet else 26.0 * 7.0 * 24.0)

    @property
    def output_interval_h(self) -> float:
        """Time between two written states of the fields [h]."""
        return self.fields_every_h or self.hours / 14.0

    @model_validator(mode="after")
    def _has_one_body(self) -> WoundCase:
        if (self.benchmark is None) == (self.body is None):
            raise fault(
                "benchmark", 'must be "circular-wound" or "breast-cavity", or left out where body.mesh names a mesh'
            )
        if self.body is not None and self.elements is not None:
            raise fault("elements", "belongs to the benchmarks; body.mesh has its own")
        return self

    @model_validator(mode="after")
    def _is_possible(self) -> WoundCase:
        check_continuum(self.values, self.mechanosensing, self.is_sheet)
        return self
