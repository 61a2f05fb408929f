"""What a case of kind "tissue-cell" says: plain data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import jax
from pydantic import Field, model_validator

from ..biology.turnover import Turnover
from .adhesion_case import AnySubstrate, BondTable, CellTable
from .laws import AnyLaw, checked_law, one_of, table_of
from .limits import Integer, NotNegative, Number, Positive, Probability, Times, fault, limits
from .table import Table

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


class TractionTable(Table):
    """The traction at the adhesions, which saturates: :class:`..biology.signals.TractionSignal`."""

    type: Literal["traction"]
    K_kPa: Positive = 1.0
    threshold_kPa: NotNegative = 0.0  # below the traction at rest, tissue that is not stretched grows into compression


class MoreoTable(Table):
    """The stress of a cell at the strain about it: :class:`..biology.signals.StrainSignal`."""

    type: Literal["moreo"]
    K_pass_kPa: NotNegative
    K_act_kPa: Positive
    p_max_kPa: NotNegative
    theta_1: Number
    theta_2: Number
    K_kPa: Positive = 1.0


class NetworkSignalTable(Table):
    """A network that the traction drives: :class:`..biology.signals.NetworkSignal`."""

    type: Literal["network"]
    species: Path
    reactions: Path
    inhibition: Literal["complement", "weighted"] = "complement"
    input: str  # driven by the traction, saturated as above
    output: str  # whose activity is the signal
    K_kPa: Positive = 1.0
    threshold_kPa: NotNegative = 0.0


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


TurnoverTable = table_of(Turnover)
AnySignal = one_of({"traction": TractionTable, "moreo": MoreoTable, "network": NetworkSignalTable})


class TissueCellCase(Table):
    """Tissue that grows because its cells pull: from the bond to the stretch."""

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

    @property
    def seed(self) -> int:
        """Nothing is drawn."""
        return 0

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
