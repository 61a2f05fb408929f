"""What a case of kind "tissue-cell" says: plain data."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import jax
from pydantic import Field, model_validator

from ...cases.adhesion import AnySubstrate, BondTable, CellTable
from ...cases.bounds import Integer, NotNegative, Number, Positive, Probability, Times, fault, limits
from ...cases.laws import AnyLaw, checked_law
from ...cases.signals import AnySignal, TractionTable, TurnoverTable
from ...cases.table import Case, Table

YIELDING = ("maxwell", "standard-linear-solid")
Stretch = Annotated[Number, limits(least=0.1, most=10.0)]


class LoadingTable(Table):
    """Equal stretches in the plane, held or led along."""

    time_h: Times
    stretch: tuple[Stretch, ...]  # at those times, linear between
    n_rows: Annotated[Integer, limits(least=2, most=100_000)] = 200  # of the history, at equal times

    @model_validator(mode="after")
    def _as_many(self) -> LoadingTable:
        if len(self.stretch) != len(self.time_h):
            raise fault("stretch", f"must have as many values as time_h ({len(self.time_h)}); got {len(self.stretch)}")
        return self


class StartTable(Table):
    """What the tissue holds at first."""

    rho_per_mm3: NotNegative | None = None  # left out: that of healthy tissue
    c_g_per_mm3: NotNegative = 0.0
    m_f: NotNegative = 1.0
    bound_fraction: Probability = 0.0


class ScaleTable(Table):
    """What cells and cytokine are counted in."""

    rho_phys_per_mm3: Positive = 1e4
    c_max_g_per_mm3: Positive = 1e-4


class SolverTable(Table):
    """How exactly the course is followed."""

    relative_tolerance: Annotated[Number, limits(least=1e-12, most=1e-2)] = 1e-7
    absolute_tolerance: Annotated[Number, limits(least=1e-16, most=1e-2)] = 1e-10
    max_steps: Annotated[Integer, limits(least=10, most=10_000_000)] = 10_000  # between two checkpoints


class TissueCellCase(Case):
    """Tissue that grows because its cells pull: from the bond to the stretch."""

    files: ClassVar[tuple[str, ...]] = ("signal.species", "signal.reactions")
    kind: Literal["tissue-cell"] = "tissue-cell"
    loading: LoadingTable
    law: tuple[AnyLaw, ...]  # pyright: ignore[reportInvalidTypeForm]
    bond: BondTable
    substrate: AnySubstrate  # pyright: ignore[reportInvalidTypeForm]
    cell: CellTable
    signal: AnySignal = TractionTable(type="traction")  # pyright: ignore[reportInvalidTypeForm]
    turnover: TurnoverTable = Field(default_factory=TurnoverTable)  # pyright: ignore[reportInvalidTypeForm]
    growth_density: Annotated[Number, limits(above=0.0)] = 1.0  # varrho_f of Eq. (27)
    scale: ScaleTable = ScaleTable()
    start: StartTable = StartTable()
    solver: SolverTable = SolverTable()

    @property
    def growth(self) -> None:
        """The cells grow it."""
        return

    @model_validator(mode="after")
    def _law_is_elastic(self) -> TissueCellCase:
        if not self.law:
            raise fault("law", "must be at least one table [[law]]: the tissue's own")
        law = checked_law(self)
        if not law.has_potential() or jax.tree.leaves(law.initial_state((1,))):
            raise fault(
                "law", "must be elastic: hours later its viscous parts have flown, and growth is that of the cells"
            )
        return self

    @model_validator(mode="after")
    def _substrate_stays(self) -> TissueCellCase:
        if self.substrate.type in YIELDING:
            raise fault("substrate.type", f'must not be "{self.substrate.type}": hours later it has yielded')
        if "stretch" in self.substrate.model_fields_set:
            raise fault("substrate.stretch", "must be left out: it is the elastic stretch of the tissue")
        return self

    @model_validator(mode="after")
    def _cells_do_not_crawl_by_clutches(self) -> TissueCellCase:
        if self.cell.clutch is not None:
            raise fault("cell.clutch", "must be left out: give force_pN or feedback")
        return self
