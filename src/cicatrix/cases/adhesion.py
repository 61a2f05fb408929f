"""Tables of a bond, what it pulls at, and the cell that pulls: plain data, in pN, um and s."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import create_model, model_validator

from .bounds import Integer, NotNegative, Number, Positive, fault, limits
from .laws import ANY, LAWS, AnyLaw, LawTable, one_of
from .table import Table

Rate = Annotated[Number, limits(least=1e-12)]


Count = Annotated[Integer, limits(least=1)]


class CatchTable(Table):
    """Two ways to open instead of one: :class:`..biology.bond.CatchBond`."""

    k_catch_per_s: NotNegative
    k_slip_per_s: Rate
    f_catch_pN: Positive
    f_slip_pN: Positive


class BondTable(Table):
    """Rates of a bond, and what counts as the energy at it."""

    k_on_per_s: Rate
    k_off_per_s: Rate | None = None
    kT_pN_um: Annotated[Number, limits(least=1e-12)] = 4.28317e-3  # 310 K
    energy: Literal["work", "stored"] = "work"
    catch: CatchTable | None = None

    @model_validator(mode="after")
    def _opens_in_one_manner(self) -> BondTable:
        if (self.catch is None) == (self.k_off_per_s is None):
            words = "is missing" if self.catch is None else "and catch exclude each other: catch has rates of its own"
            raise fault("k_off_per_s", words)
        for key in ("energy", "kT_pN_um"):
            if self.catch is not None and key in self.model_fields_set:
                raise fault(key, "and catch exclude each other: such a bond heeds the force alone")
        return self


class SubstrateTable(Table):
    """What a bond pulls at, and how far it is stretched beforehand."""

    stretch: tuple[Annotated[Number, limits(above=0.0)], ...] = (1.0,)

    @model_validator(mode="after")
    def _has_stretches(self) -> SubstrateTable:
        if not self.stretch:
            raise fault("stretch", "must be a list of one number at least")
        return self


class LinearTable(SubstrateTable):
    """A spring."""

    type: Literal["linear"]
    stiffness_pN_um: Annotated[Number, limits(least=1e-12)]


class ColumnTable(SubstrateTable):
    """A column of a material under one bond."""

    area_um2: Annotated[Number, limits(least=1e-12)]
    length_um: Annotated[Number, limits(least=1e-12)]


class FibreTable(ColumnTable):
    """A column that stiffens exponentially."""

    type: Literal["exponential-fibre"]
    k1_MPa: Annotated[Number, limits(least=1e-12)]
    k2: Annotated[Number, limits(least=1e-12)]


class TissueTable(ColumnTable):
    """A column of the sum of all tables [[law]]."""

    type: Literal["law"]


class MaxwellTable(SubstrateTable):
    """A spring and a dashpot in series."""

    type: Literal["maxwell"]
    stiffness_pN_um: Annotated[Number, limits(least=1e-12)]
    viscosity_pN_s_um: Annotated[Number, limits(least=1e-12)]


class SolidTable(SubstrateTable):
    """A spring beside a spring and a dashpot in series."""

    type: Literal["standard-linear-solid"]
    long_pN_um: NotNegative
    added_pN_um: Annotated[Number, limits(least=1e-12)]
    viscosity_pN_s_um: Annotated[Number, limits(least=1e-12)]


def _any_substrate() -> Any:
    """Annotation of the table: one of the above, or a column of any one law of a material point."""
    tables: dict[str, type[Table]] = {
        "linear": LinearTable,
        "exponential-fibre": FibreTable,
        "maxwell": MaxwellTable,
        "standard-linear-solid": SolidTable,
        "law": TissueTable,
    }
    for member in get_args(get_args(AnyLaw)[0]):
        law = get_args(member)[0]
        if isinstance(law, type) and issubclass(law, LawTable):
            (name,) = get_args(law.model_fields["type"].annotation)
            column = create_model(f"{law.__name__}Column", __base__=(law, ColumnTable), __doc__=law.__doc__)
            column.model_rebuild(_types_namespace={ANY: AnyLaw})
            tables[name] = column

    return one_of(tables)


AnySubstrate = _any_substrate()


class FeedbackTable(Table):
    """A cell that pulls harder at what is stiffer: :class:`..biology.contraction.Feedback`."""

    f0_pN: NotNegative
    beta: NotNegative
    k_a_pN_um: Annotated[Number, limits(least=1e-12)]
    k_N_pN_um: Annotated[Number, limits(least=1e-12)]


class ClutchTable(Table):
    """Motors that draw actin over the bonds: :class:`..biology.clutch.MotorClutch`; defaults of Chan & Odde (2008)."""

    motors: Positive = 50.0
    motor_force_pN: Positive = 2.0
    velocity_um_per_s: NotNegative = 0.12
    stiffness_pN_um: Annotated[Number, limits(least=1e-12)] = 5000.0
    bond_force_pN: Positive = 2.0  # that makes a bond open e times as fast


class CellTable(Table):
    """How hard the cell pulls at a bond, and how many bonds it has."""

    force_pN: NotNegative | None = None
    feedback: FeedbackTable | None = None
    clutch: ClutchTable | None = None
    integrins_per_um2: Annotated[Number, limits(above=0.0)] = 400.0

    @model_validator(mode="after")
    def _pulls_in_one_manner(self) -> CellTable:
        given = [key for key in ("force_pN", "feedback", "clutch") if getattr(self, key) is not None]
        if len(given) != 1:
            raise fault(
                "force_pN", f"or feedback or clutch must be given, one of them; got {', '.join(given) or 'none'}"
            )
        return self


LAW_SUBSTRATES = (*LAWS, "law")  # types of substrates that are made of laws of a material point
