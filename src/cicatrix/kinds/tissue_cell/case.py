"""Tables of a case of kind "tissue-cell": plain data."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import jax
from pydantic import Field, model_validator

from ...cases.adhesion import AnySubstrate, BondTable, CellTable
from ...cases.bounds import Integer, NotNegative, Number, Positive, Probability, Times, bounds, fault
from ...cases.laws import AnyLaw, checked_law
from ...cases.signals import AnySignal, TractionTable, TurnoverTable
from ...cases.table import Case, Table

YIELDING = ("maxwell", "standard-linear-solid")
Stretch = Annotated[Number, bounds(least=0.1, most=10.0)]


class StretchLoadingTable(Table):
    """Equibiaxial in-plane stretch, constant or piecewise linear in time."""

    time_h: Times  # times at which the stretch is given
    stretch: tuple[Stretch, ...]  # stretch at these times, linear between
    n_rows: Annotated[Integer, bounds(least=2, most=100_000)] = 200  # rows of the history, equally spaced in time

    @model_validator(mode="after")
    def _as_many(self) -> StretchLoadingTable:
        if len(self.stretch) != len(self.time_h):
            raise fault("stretch", f"must have as many values as time_h ({len(self.time_h)}); got {len(self.stretch)}")
        return self


class StartTable(Table):
    """Initial state of the tissue."""

    rho_per_mm3: NotNegative | None = None  # cell density; default: that of healthy tissue
    c_g_per_mm3: NotNegative = 0.0  # cytokine concentration
    m_f: NotNegative = 1.0  # collagen relative to healthy tissue
    bound_fraction: Probability = 0.0  # fraction of bonds that are closed


class ScaleTable(Table):
    """Reference values that make cells and cytokine dimensionless."""

    rho_phys_per_mm3: Positive = 1e4  # cell density of healthy tissue
    c_max_g_per_mm3: Positive = 1e-4  # largest cytokine concentration


class TissueCellSolverTable(Table):
    """Accuracy of the time integration."""

    relative_tolerance: Annotated[Number, bounds(least=1e-12, most=1e-2)] = 1e-7  # relative error of a time step
    absolute_tolerance: Annotated[Number, bounds(least=1e-16, most=1e-2)] = 1e-10  # absolute error of a time step
    max_steps: Annotated[Integer, bounds(least=10, most=10_000_000)] = 10_000  # time steps in ten rows of the history


class TissueCellCase(Case):
    """Tissue that grows because its cells pull at it: a model from the single bond to the growth stretch.

    The tables ``[[law]]`` give the elastic law of the tissue, ``[substrate]`` that of the material under one bond.
    """

    files: ClassVar[tuple[str, ...]] = ("signal.species", "signal.reactions")
    kind: Literal["tissue-cell"] = "tissue-cell"  # kind of the case
    loading: StretchLoadingTable
    # elastic material of the tissue: the sum of all tables
    law: tuple[AnyLaw, ...]  # pyright: ignore[reportInvalidTypeForm]
    bond: BondTable
    # substrate that a bond pulls at, at the elastic stretch of the tissue; one of the tables below
    substrate: AnySubstrate  # pyright: ignore[reportInvalidTypeForm]
    cell: CellTable
    # signal that the cells derive from their traction or strain; one of the tables below
    signal: AnySignal = TractionTable(type="traction")  # pyright: ignore[reportInvalidTypeForm]
    # rates of cells, cytokine and collagen
    turnover: TurnoverTable = Field(default_factory=TurnoverTable)  # pyright: ignore[reportInvalidTypeForm]
    growth_density: Annotated[Number, bounds(above=0.0)] = 1.0  # collagen gained per unit of growth stretch
    scale: ScaleTable = ScaleTable()
    start: StartTable = StartTable()
    solver: TissueCellSolverTable = TissueCellSolverTable()

    @property
    def growth(self) -> None:
        """None: growth of the tissue follows from its cells, not from a growth law."""
        return

    @model_validator(mode="after")
    def _law_is_elastic(self) -> TissueCellCase:
        if not self.law:
            raise fault("law", "must be at least one table [[law]]: the tissue's own")
        law = checked_law(self)
        if not law.has_potential() or jax.tree.leaves(law.initial_state((1,))):
            raise fault(
                "law", "must be elastic: viscous stress relaxes long before tissue grows, and growth is by the cells"
            )
        return self

    @model_validator(mode="after")
    def _substrate_stays(self) -> TissueCellCase:
        if self.substrate.type in YIELDING:
            raise fault("substrate.type", f'must not be "{self.substrate.type}": it relaxes long before tissue grows')
        if "stretch" in self.substrate.model_fields_set:
            raise fault("substrate.stretch", "must be left out: it is the elastic stretch of the tissue")
        return self

    @model_validator(mode="after")
    def _cells_do_not_crawl_by_clutches(self) -> TissueCellCase:
        if self.cell.clutch is not None:
            raise fault("cell.clutch", "must be left out: give force_pN or feedback")
        return self
