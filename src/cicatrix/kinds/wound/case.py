"""What a case of kind "wound" says: plain data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from ...cases.bounds import Integer, Number, Positive, fault, limits
from ...cases.continuum import (
    VALUES,
    AnySensing,
    LogisticTable,
    ParametersTable,
    TimeTolerance,
    check_fields,
)
from ...cases.table import Case, Table


class WoundSolverTable(Table):
    """How exactly a wound is followed."""

    time_tolerance: TimeTolerance = 1e-4
    iteration_tolerance: Annotated[Number, limits(least=1e-12, most=1e-2)] | None = (
        None  # left out: a tenth of it, 1e-5 at most
    )
    first_step_h: Positive = 0.01


class WoundBodyTable(Table):
    """A mesh of tetrahedra, with point data ``fixed`` and cell data ``wound``, both 0 or 1."""

    mesh: Path
    mesh_unit: Literal["mm", "cm", "m"] = "mm"


class WoundCase(Case):
    """A wound that heals by fields: cells, cytokine and collagen on a body that they pull at."""

    files: ClassVar[tuple[str, ...]] = ("body.mesh", "mechanosensing.species", "mechanosensing.reactions")
    kind: Literal["wound"] = "wound"
    benchmark: Literal["circular-wound", "breast-cavity"] | None = None
    body: WoundBodyTable | None = None  # instead of a benchmark's; values are those of the breast's cavity
    elements: Annotated[Integer, limits(least=4, most=400)] | None = (
        None  # per side of the sheet; along the breast's diameter
    )
    duration_h: Positive | None = None
    coupling: Literal["two-way", "one-way"] = "two-way"  # "one-way": the body stays as it is at first
    fields_every_h: Positive | None = None
    mechanosensing: AnySensing = LogisticTable(type="logistic")  # pyright: ignore[reportInvalidTypeForm]
    parameters: ParametersTable = ParametersTable()
    solver: WoundSolverTable = WoundSolverTable()

    @property
    def is_sheet(self) -> bool:
        """Two dimensions instead of three."""
        return self.benchmark == "circular-wound"

    @property
    def values(self) -> dict[str, float]:
        """Parameters, those of the benchmark where nothing is said; without those that switch on what it does not have."""
        return VALUES[self.benchmark or "breast-cavity"] | self.parameters.model_dump(exclude_none=True)

    @property
    def hours(self) -> float:
        """How long it is followed."""
        return self.duration_h or (336.0 if self.is_sheet else 26.0 * 7.0 * 24.0)

    @property
    def picture_hours(self) -> float:
        """Time between two pictures of the fields."""
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
        check_fields(self.values, self.mechanosensing, self.is_sheet)
        return self
