"""Laws that a case file can name, and their keys, which are derived from the parameters that each law declares.

A parameter becomes the key ``name_unit`` with the range that the law declares. A part that is itself a law becomes a table, a
part that is one of several laws becomes a table with ``type``, and a tuple of laws becomes a list of tables. Nothing that the
file of a law declares is repeated here.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, ForwardRef, Literal, Optional, Protocol, Union

import numpy as np
from jax import Array
from pydantic import BeforeValidator, StrictBool, create_model, model_validator

from ..core.errors import InputError
from ..core.law import Law
from ..core.units import seconds_from_hours, unit_factor
from ..materials.active import ActiveFibres, Contraction
from ..materials.compose import Sum
from ..materials.exponential import Exponential
from ..materials.fibres import FibreDistribution
from ..materials.growing import AreaGrowth, FibreGrowth, Growing, Growth, VolumeGrowth
from ..materials.holzapfel import HolzapfelGasserOgden
from ..materials.ligaments import Ligaments
from ..materials.locking_skin import LockingSkin
from ..materials.material import EnergyMaterial
from ..materials.may_newman import MayNewman
from ..materials.mixture import ConstrainedMixture
from ..materials.mooney_rivlin import MooneyRivlin
from ..materials.neo_hookean import NeoHookean
from ..materials.ogden import Ogden
from ..materials.viscoelastic import Viscoelastic
from .bounds import Integer, Number, bounds, fault
from .table import Table, one_of

ANY = "_any_law"  # forward reference to a whole union of laws inside one of its tables; not a name of this module
LAWS: dict[str, type[EnergyMaterial]] = {
    "neo-hookean": NeoHookean,
    "exponential": Exponential,
    "mooney-rivlin": MooneyRivlin,
    "ogden": Ogden,
    "locking-skin": LockingSkin,
    "holzapfel-gasser-ogden": HolzapfelGasserOgden,
    "may-newman": MayNewman,
    "fibre-distribution": FibreDistribution,
    "ligaments": Ligaments,
    "active-fibres": ActiveFibres,
    "contraction": Contraction,
    "constrained-mixture": ConstrainedMixture,
}
GROWTHS: dict[str, type[Growth]] = {"fibre": FibreGrowth, "area": AreaGrowth, "volume": VolumeGrowth}
ISOTROPIC = (
    NeoHookean,
    Exponential,
    MooneyRivlin,
    Ogden,
    LockingSkin,
)  # laws that can have Maxwell branches in parallel


_LISTED = BeforeValidator(lambda value: value if isinstance(value, list | tuple) else [value])


class SeriesTable(Table):
    """Maxwell branches in parallel with an isotropic law, :class:`..materials.viscoelastic.Viscoelastic`; numbers or lists."""

    beta: Annotated[tuple[Annotated[Number, bounds(least=0.0)], ...], _LISTED]  # stiffness of each over the law's
    relaxation_s: Annotated[tuple[Annotated[Number, bounds(above=0.0)], ...], _LISTED]  # relaxation time of each

    @model_validator(mode="after")
    def _is_one_of_each(self) -> SeriesTable:
        if not self.beta:
            raise fault("beta", "must be a number or a list of at least one number")
        if len(self.beta) != len(self.relaxation_s):
            raise fault("relaxation_s", f"must be as many as beta ({len(self.beta)}); got {len(self.relaxation_s)}")
        return self


class FibresGrowTable(Table):
    """Growth along the directions of a law's own fibres: :class:`..materials.growing.FibreGrowth`.

    With ``homeostatic_kPa``, the stress at which nothing grows, the stress drives growth; without it the elastic stretch does.
    """

    tau_h: Annotated[Number, bounds(above=0.0)]  # time constant of growth
    homeostatic_kPa: Annotated[Number, bounds(above=0.0)] | None = None  # homeostatic stress; default: stretch-driven


class LawTable(Table):
    """Table of a case file from which a constitutive law, or a part of one, is built."""

    made: ClassVar[type[Law]]

    def build(self) -> Law:
        """Build the law.

        Raises
        ------
        InputError
            If values that are each in range contradict each other.
        """
        values = {}
        for field in dataclasses.fields(self.made):
            value = getattr(self, key_of(field), None)
            if value is not None:
                values[field.name] = _inner(value, field)
        law, series = self.made(**values), getattr(self, "viscous", None)
        return Viscoelastic(law, series.beta, series.relaxation_s) if isinstance(series, SeriesTable) else law

    def growth_of_fibres(self) -> FibreGrowth | None:
        """Build the growth law of the law's own fibres; None if they do not grow."""
        asked = getattr(self, "growth", None)
        if not isinstance(asked, FibresGrowTable):
            return None
        orientation = self.orientation.build()  # pyright: ignore[reportAttributeAccessIssue]
        return FibreGrowth(seconds_from_hours(asked.tau_h), asked.homeostatic_kPa, orientation)


def key_of(field: dataclasses.Field) -> str:
    """Return the key of a field in a case file: its name and the unit of the case file, such as ``mu_kPa`` or ``rate_per_h``."""
    unit, name = field.metadata.get("typed", "1"), field.metadata.get("key", field.name)
    return name if unit == "1" else f"{name}_{_unit_words(unit)}"


def union_of(laws: Mapping[str, type[Law]]) -> Any:
    """Make the type annotation of a table that names one of several laws by ``type``; laws of the union may be nested."""
    made: list[type[LawTable]] = []
    whole = _either(laws, made)
    for table in made:
        table.model_rebuild(_types_namespace={ANY: whole})
    return whole


def table_of(law: type[Law]) -> Any:
    """Make the table of a case file that has a law's parameters as keys."""
    made: list[type[LawTable]] = []
    return _table(law, None, made)


def _either(laws: Mapping[str, type[Law]], made: list[type[LawTable]]) -> Any:
    """Return the type annotation of a table for any one of the laws; append the tables newly made to the list ``made``."""
    return one_of({name: _table(law, name, made) for name, law in laws.items()})


def _table(law: type[Law], name: str | None, made: list[type[LawTable]]) -> type[LawTable]:
    hints = typing.get_type_hints(law)
    keys: dict[str, Any] = {} if name is None else {"type": (Literal[name], ...)}
    for field in dataclasses.fields(law):
        if field.init:
            kind, default = _kind(field, hints[field.name], made), _default(field)
            keys[key_of(field)] = (kind if default is ... else Optional[kind], default)  # noqa: UP045
    if law in ISOTROPIC:
        keys["viscous"] = (SeriesTable | None, None)
    if law is FibreDistribution:
        keys["growth"] = (FibresGrowTable | None, None)
    table = create_model(f"{law.__name__}Table", __base__=LawTable, __doc__=law.__doc__, **keys)
    table.made = law
    made.append(table)
    return table


def _default(field: dataclasses.Field) -> Any:
    """Return None for a field with a default, so that the law sets it and a manifest shows only what the user gave."""
    has_one = field.default is not dataclasses.MISSING or field.default_factory is not dataclasses.MISSING
    return None if has_one else ...


def _kind(field: dataclasses.Field, hint: Any, made: list[type[LawTable]]) -> Any:
    """Return the type of a case-file key from the ``hint`` of the law's field; append the tables newly made to ``made``."""
    options = [option for option in _members(hint) if option not in (type(None), Array, np.ndarray)]
    if "types" in field.metadata:
        return _either(field.metadata["types"], made)
    for option in options:
        if typing.get_origin(option) is tuple:
            return tuple[_kind(field, typing.get_args(option)[0], made), ...]
        if isinstance(option, type) and issubclass(option, Law):
            return ForwardRef(ANY) if option is EnergyMaterial else _table(option, None, made)
    if "symbol" in field.metadata:
        return _number(field, int not in options or float in options)
    return {bool: StrictBool, int: Integer}.get(options[0], options[0])


def _members(hint: Any) -> tuple[Any, ...]:
    return typing.get_args(hint) if typing.get_origin(hint) in (Union, types.UnionType) else (hint,)


def _number(field: dataclasses.Field, is_real: bool) -> Any:
    per = unit_factor(field.metadata["typed"], field.metadata["unit"])
    low, high = field.metadata["low"] / per, field.metadata["high"] / per
    least = {"above" if field.metadata["is_open"] else "least": low} if np.isfinite(low) else {}
    most = {"most": high} if np.isfinite(high) else {}
    return Annotated[Number if is_real else Integer, bounds(**least, **most)]


def _inner(value: Any, field: dataclasses.Field) -> Any:
    """Convert a value from the unit of the case file to that of the law, and build laws inside it."""
    if isinstance(value, LawTable):
        if value.growth_of_fibres() is not None:
            raise InputError("a law inside another one must not grow: give the outer law growth, or a table [growth]")
        return value.build()
    if isinstance(value, tuple):
        return tuple(_inner(item, field) for item in value)
    per = unit_factor(field.metadata["typed"], field.metadata["unit"]) if "symbol" in field.metadata else 1.0
    return value if per == 1.0 else value * per


def _unit_words(unit: str) -> str:
    words = unit.replace(" ", "_").replace("^", "")
    return "per_" + words[2:] if words.startswith("1/") else words.replace("/", "_per_")


AnyLaw = union_of(LAWS)
AnyGrowth = union_of(GROWTHS)


class NamesALaw(Protocol):
    """Interface of a case that has the tables ``[[law]]`` and ``[growth]``."""

    @property
    def law(self) -> tuple[LawTable, ...]: ...  # noqa: D102
    @property
    def growth(self) -> LawTable | None: ...  # noqa: D102


def law_of(case: NamesALaw) -> EnergyMaterial:
    """Build the law of a case: stresses of the tables [[law]] add up, and growth applies to the whole tissue.

    Raises
    ------
    InputError
        If values contradict each other, or growth is given more than once.
    """
    return _composed(case, [table.build() for table in case.law], case.growth.build() if case.growth else None)


def checked_law(case: NamesALaw) -> EnergyMaterial:
    """Build the law while the case is checked, as ``law_of``, with errors that name the table at fault."""
    parts = [_with_key(f"law[{number}]", table.build) for number, table in enumerate(case.law)]
    growth = _with_key("growth", case.growth.build) if case.growth else None
    try:
        return _composed(case, parts, growth)
    except InputError as error:
        raise fault("growth", str(error).removeprefix("growth ")) from None


def _composed(case: NamesALaw, parts: list[Any], growth: Any) -> EnergyMaterial:
    said = {f"law[{number}].growth": table.growth_of_fibres() for number, table in enumerate(case.law)}
    growths = {place: grown for place, grown in (said | {"[growth]": growth}).items() if grown is not None}
    if len(growths) > 1:
        raise InputError(f"growth must be given once, for the whole tissue; found {', '.join(growths)}")
    law = parts[0] if len(parts) == 1 else Sum(tuple(parts))
    return Growing(law, *growths.values()) if growths else law


def _with_key(key: str, build: Callable[[], Law]) -> Law:
    try:
        return build()
    except InputError as error:
        raise fault(key, f"is at fault: {error}") from None
