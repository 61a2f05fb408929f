"""Tables of a bond, of the substrate that it pulls on, and of the cell: plain data, in pN, um and s."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import create_model, model_validator

from .bounds import Integer, NotNegative, Number, Positive, bounds, fault
from .laws import ANY, LAWS, AnyLaw, LawTable, one_of
from .table import Table

Rate = Annotated[Number, bounds(least=1e-12)]


Count = Annotated[Integer, bounds(least=1)]


class CatchTable(Table):
    """Catch bond: force slows opening on one pathway and speeds it up on another (:class:`..biology.bond.CatchBond`)."""

    k_catch_per_s: NotNegative  # rate of opening along the catch pathway without load
    k_slip_per_s: Rate  # rate of opening along the slip pathway without load
    f_catch_pN: Positive  # force that divides the rate of the catch pathway by e
    f_slip_pN: Positive  # force that multiplies the rate of the slip pathway by e


class BondTable(Table):
    """Rates at which a bond closes and opens, and the energy on which its opening rate depends."""

    k_on_per_s: Rate  # rate of closing
    k_off_per_s: Rate | None = None  # rate of opening without load; required unless catch is given
    kT_pN_um: Annotated[Number, bounds(least=1e-12)] = 4.28317e-3  # thermal energy; the default is that at 310 K
    energy: Literal["work", "stored"] = "work"  # force times displacement, or energy stored in the substrate
    catch: CatchTable | None = None  # rates of a catch bond, which replace k_off_per_s

    @model_validator(mode="after")
    def _opens_in_one_manner(self) -> BondTable:
        if (self.catch is None) == (self.k_off_per_s is None):
            words = "is missing" if self.catch is None else "and catch exclude each other: catch has rates of its own"
            raise fault("k_off_per_s", words)
        for key in ("energy", "kT_pN_um"):
            if self.catch is not None and key in self.model_fields_set:
                raise fault(key, "and catch exclude each other: the rates of a catch bond depend on the force alone")
        return self


class SubstrateTable(Table):
    """Substrate that the bonds pull on, and the stretches that are imposed on it before the cell pulls."""

    stretch: tuple[Annotated[Number, bounds(above=0.0)], ...] = (1.0,)  # stretches; only for kind = "adhesion"

    @model_validator(mode="after")
    def _has_stretches(self) -> SubstrateTable:
        if not self.stretch:
            raise fault("stretch", "must be a list of at least one number")
        return self


class LinearTable(SubstrateTable):
    """A linear spring."""

    type: Literal["linear"]
    stiffness_pN_um: Annotated[Number, bounds(least=1e-12)]  # stiffness, the same at every stretch


class ColumnTable(SubstrateTable):
    """A column of a material under one bond."""

    area_um2: Annotated[Number, bounds(least=1e-12)]  # cross-section of the column, not stretched
    length_um: Annotated[Number, bounds(least=1e-12)]  # length of the column, not stretched


class FibreTable(ColumnTable):
    """Column of a fibre material that stiffens exponentially, with nominal stress P = k1 lambda (exp(k2 (lambda^2 - 1)) - 1)."""

    type: Literal["exponential-fibre"]
    k1_MPa: Annotated[Number, bounds(least=1e-12)]  # stiffness k1
    k2: Annotated[Number, bounds(least=1e-12)]  # exponent k2


class LawColumnTable(ColumnTable):
    """Column of a material whose stress is the sum of those of all tables [[law]]."""

    type: Literal["law"]


class MaxwellTable(SubstrateTable):
    """A spring and a dashpot in series."""

    type: Literal["maxwell"]
    stiffness_pN_um: Annotated[Number, bounds(least=1e-12)]  # stiffness of the spring
    viscosity_pN_s_um: Annotated[Number, bounds(least=1e-12)]  # viscosity of the dashpot


class SolidTable(SubstrateTable):
    """A spring in parallel with a spring and a dashpot in series."""

    type: Literal["standard-linear-solid"]
    long_pN_um: NotNegative  # stiffness of the single spring, which remains in the long term
    added_pN_um: Annotated[Number, bounds(least=1e-12)]  # stiffness of the spring in series, which relaxes
    viscosity_pN_s_um: Annotated[Number, bounds(least=1e-12)]  # viscosity of the dashpot


def _any_substrate() -> Any:
    """Make the type annotation of [substrate]: one of the tables above, or a column of any single material law."""
    tables: dict[str, type[Table]] = {
        "linear": LinearTable,
        "exponential-fibre": FibreTable,
        "maxwell": MaxwellTable,
        "standard-linear-solid": SolidTable,
        "law": LawColumnTable,
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
    """A force that grows with the stiffness of the substrate: :class:`..biology.contraction.Feedback`."""

    f0_pN: NotNegative  # force without feedback
    beta: NotNegative  # strength of the feedback
    k_a_pN_um: Annotated[Number, bounds(least=1e-12)]  # stiffness of actin
    k_N_pN_um: Annotated[Number, bounds(least=1e-12)]  # stiffness of the nucleus


class ClutchTable(Table):
    """Motors that pull actin filaments past the bonds: :class:`..biology.clutch.MotorClutch`.

    The defaults are those of Chan & Odde (2008).
    """

    motors: Positive = 50.0  # number of motors
    motor_force_pN: Positive = 2.0  # force at which one motor stalls
    velocity_um_per_s: NotNegative = 0.12  # velocity of actin without load
    stiffness_pN_um: Annotated[Number, bounds(least=1e-12)] = 5000.0  # stiffness of one clutch
    bond_force_pN: Positive = 2.0  # force at which a bond opens e times as fast


class CellTable(Table):
    """Force of the cell on a bond, and number of bonds per area; exactly one of force_pN, feedback and clutch is given."""

    force_pN: NotNegative | None = None  # constant force at every bond
    feedback: FeedbackTable | None = None  # force that depends on the stiffness of the substrate
    clutch: ClutchTable | None = None  # force of molecular motors; only for kind = "adhesion"
    integrins_per_um2: Annotated[Number, bounds(above=0.0)] = 400.0  # bonds per area, closed or open

    @model_validator(mode="after")
    def _pulls_in_one_manner(self) -> CellTable:
        given = [key for key in ("force_pN", "feedback", "clutch") if getattr(self, key) is not None]
        if len(given) != 1:
            raise fault(
                "force_pN", f"or feedback or clutch must be given, one of them; got {', '.join(given) or 'none'}"
            )
        return self


LAW_SUBSTRATES = (*LAWS, "law")  # types of substrates that are made of material laws
