"""What a case of kind "adhesion" says: plain data, in pN, um and s."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import model_validator

from ...cases.adhesion import (
    AnySubstrate,
    BondTable,
    CellTable,
    Count,
)
from ...cases.bounds import Integer, Positive, Probability, fault, limits
from ...cases.laws import AnyLaw, checked_law
from ...cases.table import Case, Table

MOST_BONDS = 10**9  # in one run
WHOLE = 1e-6  # of a step that fixed steps may miss the end by


class MethodTable(Table):
    """How the bonds are followed, and for how long."""

    type: Literal["ode", "monte-carlo", "ssa"] = "ode"
    duration_s: Positive
    n_rows: Annotated[Integer, limits(least=1, most=1_000_000)] = 100  # of the history, at equal times
    start_bound_fraction: Probability = 0.0
    n_integrins: Count | None = None  # of one cell
    n_cells: Annotated[Integer, limits(least=2)] | None = None  # on each stretch; 16 unless said
    dt_s: Positive | None = None

    @model_validator(mode="after")
    def _knows_what_it_needs(self) -> MethodTable:
        needed = {"ode": (), "monte-carlo": ("n_integrins", "dt_s"), "ssa": ("n_integrins",)}[self.type]
        for key in needed:
            if getattr(self, key) is None:
                raise fault(key, f'is missing, which type = "{self.type}" needs')
        for key in {"n_integrins", "n_cells", "dt_s"} - {*needed, *(("n_cells",) if needed else ())}:
            if getattr(self, key) is not None:
                raise fault(key, f'must be left out for type = "{self.type}"')
        return self

    @model_validator(mode="after")
    def _steps_are_whole(self) -> MethodTable:
        steps = self.duration_s / (self.dt_s or self.duration_s)
        if not (1 <= round(steps) < 2**32 and abs(steps - round(steps)) <= WHOLE):
            raise fault(
                "dt_s",
                f"must give a whole number of steps, 1 to 2^32 - 1, in duration_s = {self.duration_s:g}; got {self.dt_s:g}, "
                f"{steps:.6g} steps",
            )
        return self


class ClusterTable(Table):
    """Bonds that share a load: when one opens the others bear its part."""

    bonds: Annotated[Integer, limits(least=1, most=100_000)]
    rebinding: bool = True


class SeedTable(Table):
    """Seed of the random numbers."""

    seed: Annotated[Integer, limits(least=0, below=2**63)] = 1


class AdhesionCase(Case):
    """A cell on a substrate: bonds that close and open, and the traction they pass on."""

    kind: Literal["adhesion"] = "adhesion"
    bond: BondTable
    substrate: AnySubstrate  # pyright: ignore[reportInvalidTypeForm]
    law: tuple[AnyLaw, ...] = ()  # pyright: ignore[reportInvalidTypeForm]
    cell: CellTable
    cluster: ClusterTable | None = None
    method: MethodTable
    run: SeedTable = SeedTable()

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return self.run.seed

    @property
    def growth(self) -> None:
        """Substrates are pulled at before they grow."""
        return

    @property
    def n_cells(self) -> int:
        """Cells on each stretch."""
        return self.method.n_cells or 16

    @model_validator(mode="after")
    def _law_and_substrate(self) -> AdhesionCase:
        if (self.substrate.type == "law") != bool(self.law):
            raise fault("law", 'must be at least one table [[law]] for substrate.type = "law", and none otherwise')
        if self.law:
            checked_law(self)
        return self

    @model_validator(mode="after")
    def _clutches_are_stepped(self) -> AdhesionCase:
        if self.cell.clutch is not None and self.method.type != "monte-carlo":
            raise fault("method.type", f'must be "monte-carlo" for cell.clutch; got "{self.method.type}"')
        if self.cell.clutch is not None and self.cluster is not None:
            raise fault("cluster", "must be left out for cell.clutch, whose bonds share their load already")
        return self

    @model_validator(mode="after")
    def _fits_into_memory(self) -> AdhesionCase:
        n = (self.method.n_integrins or 0) * self.n_cells * len(self.substrate.stretch)
        if n > MOST_BONDS:
            raise fault(
                "method.n_integrins", f"times n_cells times stretches must be at most {MOST_BONDS:g} bonds; got {n:g}"
            )
        return self
