"""Tables of a case of kind "adhesion": plain data, in pN, um and s."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import model_validator

from ...cases.adhesion import (
    AnySubstrate,
    BondTable,
    CellTable,
    Count,
)
from ...cases.bounds import Integer, Positive, Probability, bounds, fault
from ...cases.laws import AnyLaw, checked_law
from ...cases.table import Case, Table

MAX_BONDS = 10**9  # largest number of bonds in one run
WHOLE = 1e-6  # fraction of a step by which a whole number of steps may miss the end of the run


class MethodTable(Table):
    """Method that computes the bonds, and the duration of the run.

    "ode" computes the mean bound fraction, "monte-carlo" samples single bonds in fixed time steps, "ssa" samples them at exact
    event times (stochastic simulation algorithm).
    """

    type: Literal["ode", "monte-carlo", "ssa"] = "ode"  # mean bound fraction, or sampled bonds
    duration_s: Positive  # simulated time
    n_rows: Annotated[Integer, bounds(least=1, most=1_000_000)] = 100  # rows of the history, equally spaced in time
    start_bound_fraction: Probability = 0.0  # fraction of bonds that are closed at first
    n_integrins: Count | None = None  # bonds of one cell; not for "ode"
    n_cells: Annotated[Integer, bounds(least=2)] | None = None  # cells on each stretch, 16 by default; not for "ode"
    dt_s: Positive | None = None  # fixed time step; for "monte-carlo" alone

    @model_validator(mode="after")
    def _knows_what_it_needs(self) -> MethodTable:
        needed = {"ode": (), "monte-carlo": ("n_integrins", "dt_s"), "ssa": ("n_integrins",)}[self.type]
        for key in needed:
            if getattr(self, key) is None:
                raise fault(key, f'is missing; type = "{self.type}" needs it')
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
    """Cluster of bonds that share a load: when one opens, the others carry its share."""

    bonds: Annotated[Integer, bounds(least=1, most=100_000)]  # number of bonds in the cluster
    rebinding: bool = True  # whether an open bond can close again


class SeedTable(Table):
    """Seed of the random numbers."""

    seed: Annotated[Integer, bounds(least=0, below=2**63)] = 1  # equal seeds give equal random numbers


class AdhesionCase(Case):
    """A cell on a substrate: bonds that close and open, and the traction they pass on."""

    kind: Literal["adhesion"] = "adhesion"  # kind of the case
    bond: BondTable
    # substrate that a bond pulls at; one of the tables below
    substrate: AnySubstrate  # pyright: ignore[reportInvalidTypeForm]
    # material of a substrate of type "law": the sum of all tables
    law: tuple[AnyLaw, ...] = ()  # pyright: ignore[reportInvalidTypeForm]
    cell: CellTable
    cluster: ClusterTable | None = None  # if given, lifetime and critical force of a cluster are computed
    method: MethodTable
    run: SeedTable = SeedTable()

    @property
    def seed(self) -> int:
        """Seed of the random numbers."""
        return self.run.seed

    @property
    def growth(self) -> None:
        """None: a substrate does not grow while bonds close and open."""
        return

    @property
    def n_cells(self) -> int:
        """Number of cells on each stretch; 16 by default."""
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
        if n > MAX_BONDS:
            raise fault(
                "method.n_integrins", f"times n_cells times stretches must be at most {MAX_BONDS:g} bonds; got {n:g}"
            )
        return self
