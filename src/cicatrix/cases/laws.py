"""Which laws a case file may name, and the keys of each: derived from the parameters that the law declares.

A parameter gives the key ``name_unit`` with the law's own range; a part that is a law gives a table, a part of several types
one with ``type``, a tuple of laws a list of tables. A law's file says all that, and nothing of it is said here again.
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
from ..core.units import inner_per_typed, seconds_from_hours
from ..materials.active import ActiveFibres, Contraction
from ..materials.compose import Sum
from ..materials.fibres import FibreDistribution
from ..materials.growing import AreaGrowth, FibreGrowth, Growing, Growth, VolumeGrowth
from ..materials.holzapfel import HolzapfelGasserOgden
from ..materials.material import EnergyMaterial
from ..materials.may_newman import MayNewman
from ..materials.mixture import ConstrainedMixture
from ..materials.mooney_rivlin import MooneyRivlin
from ..materials.neo_hookean import NeoHookean
from ..materials.ogden import Ogden
from ..materials.viscoelastic import Viscoelastic
from .bounds import Integer, Number, fault, limits
from .table import Table, one_of

ANY = "_any_law"  # what stands for any law of a union inside one of its tables; no name of this module
LAWS: dict[str, type[EnergyMaterial]] = {
    "neo-hookean": NeoHookean,
    "mooney-rivlin": MooneyRivlin,
    "ogden": Ogden,
    "holzapfel-gasser-ogden": HolzapfelGasserOgden,
    "may-newman": MayNewman,
    "fibre-distribution": FibreDistribution,
    "active-fibres": ActiveFibres,
    "contraction": Contraction,
    "constrained-mixture": ConstrainedMixture,
}
GROWTHS: dict[str, type[Growth]] = {"fibre": FibreGrowth, "area": AreaGrowth, "volume": VolumeGrowth}
ISOTROPIC = (NeoHookean, MooneyRivlin, Ogden)  # laws that may have viscous branches, each a share of them


_LISTED = BeforeValidator(lambda value: value if isinstance(value, list | tuple) else [value])


class SeriesTable(Table):
    """Maxwell branches beside an isotropic law, one number for each or a list: :class:`..materials.viscoelastic.Viscoelastic`."""

    beta: Annotated[tuple[Annotated[Number, limits(least=0.0)], ...], _LISTED]
    relaxation_s: Annotated[tuple[Annotated[Number, limits(above=0.0)], ...], _LISTED]

    @model_validator(mode="after")
    def _is_one_of_each(self) -> SeriesTable:
        if not self.beta:
            raise fault("beta", "must be a number or a list of one at least")
        if len(self.beta) != len(self.relaxation_s):
            raise fault("relaxation_s", f"must be as many as beta ({len(self.beta)}); got {len(self.relaxation_s)}")
        return self


class FibresGrowTable(Table):
    """Growth into the directions of a law's own fibres: :class:`..materials.growing.FibreGrowth`."""

    tau_h: Annotated[Number, limits(above=0.0)]
    homeostatic_kPa: Annotated[Number, limits(above=0.0)] | None = None


class LawTable(Table):
    """A table of a case file that becomes a law, or a part of one."""

    made: ClassVar[type[Law]]

    def build(self) -> Law:
        """Make the law.

        Raises
        ------
        InputError
            If values that are each in range do not go together.
        """
        values = {}
        for field in dataclasses.fields(self.made):
            value = getattr(self, key_of(field), None)
            if value is not None:
                values[field.name] = _inner(value, field)
        law, series = self.made(**values), getattr(self, "viscous", None)
        return Viscoelastic(law, series.beta, series.relaxation_s) if isinstance(series, SeriesTable) else law

    def growth_of_fibres(self) -> FibreGrowth | None:
        """How the law's own fibres grow, if they do."""
        asked = getattr(self, "growth", None)
        if not isinstance(asked, FibresGrowTable):
            return None
        orientation = self.orientation.build()  # pyright: ignore[reportAttributeAccessIssue]
        return FibreGrowth(seconds_from_hours(asked.tau_h), asked.homeostatic_kPa, orientation)


def key_of(field: dataclasses.Field) -> str:
    """Name a field in a case file: its own name and the unit that is typed, such as ``mu_kPa`` or ``rate_per_h``."""
    unit, name = field.metadata.get("typed", "1"), field.metadata.get("key", field.name)
    return name if unit == "1" else f"{name}_{_unit_words(unit)}"


def union_of(laws: Mapping[str, type[Law]]) -> Any:
    """Annotation of a table that names one of several laws by ``type``; laws may hold others of the same ones."""
    made: list[type[LawTable]] = []
    whole = _either(laws, made)
    for table in made:
        table.model_rebuild(_types_namespace={ANY: whole})
    return whole


def table_of(law: type[Law]) -> Any:
    """Table of a case file with a law's parameters."""
    made: list[type[LawTable]] = []
    return _table(law, None, made)


def _either(laws: Mapping[str, type[Law]], made: list[type[LawTable]]) -> Any:
    """One of the laws' tables; what is made goes to the end of a list."""
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
    """Optional keys are left to the law's own default, so that a manifest says what was typed."""
    has_one = field.default is not dataclasses.MISSING or field.default_factory is not dataclasses.MISSING
    return None if has_one else ...


def _kind(field: dataclasses.Field, hint: Any, made: list[type[LawTable]]) -> Any:
    """The type of a key by what the law says of its field."""
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
    per = inner_per_typed(field.metadata["typed"], field.metadata["unit"])
    low, high = field.metadata["low"] / per, field.metadata["high"] / per
    least = {"above" if field.metadata["is_open"] else "least": low} if np.isfinite(low) else {}
    most = {"most": high} if np.isfinite(high) else {}
    return Annotated[Number if is_real else Integer, limits(**least, **most)]


def _inner(value: Any, field: dataclasses.Field) -> Any:
    """From what is typed to what the law counts in."""
    if isinstance(value, LawTable):
        if value.growth_of_fibres() is not None:
            raise InputError("a law inside another one must not grow: say growth beside type, or as table [growth]")
        return value.build()
    if isinstance(value, tuple):
        return tuple(_inner(item, field) for item in value)
    per = inner_per_typed(field.metadata["typed"], field.metadata["unit"]) if "symbol" in field.metadata else 1.0
    return value if per == 1.0 else value * per


def _unit_words(unit: str) -> str:
    words = unit.replace(" ", "_").replace("^", "")
    return "per_" + words[2:] if words.startswith("1/") else words.replace("/", "_per_")


AnyLaw = union_of(LAWS)
AnyGrowth = union_of(GROWTHS)


class NamesALaw(Protocol):
    """A case with tables of laws."""

    @property
    def law(self) -> tuple[LawTable, ...]: ...  # noqa: D102
    @property
    def growth(self) -> LawTable | None: ...  # noqa: D102


def law_of(case: NamesALaw) -> EnergyMaterial:
    """Make the law of a case: parts add up, and what grows is the whole tissue. The one place of composition.

    Raises
    ------
    InputError
        If values do not go together, or growth is said more than once.
    """
    return _composed(case, [table.build() for table in case.law], case.growth.build() if case.growth else None)


def checked_law(case: NamesALaw) -> EnergyMaterial:
    """``law_of`` while the case is checked: what is at fault is told with its table."""
    parts = [_told(f"law[{number}]", table.build) for number, table in enumerate(case.law)]
    growth = _told("growth", case.growth.build) if case.growth else None
    try:
        return _composed(case, parts, growth)
    except InputError as error:
        raise fault("growth", str(error).removeprefix("growth ")) from None


def _composed(case: NamesALaw, parts: list[Any], growth: Any) -> EnergyMaterial:
    said = {f"law[{number}].growth": table.growth_of_fibres() for number, table in enumerate(case.law)}
    growths = {place: grown for place, grown in (said | {"[growth]": growth}).items() if grown is not None}
    if len(growths) > 1:
        raise InputError(f"growth must be said once, for the whole tissue; found {', '.join(growths)}")
    law = parts[0] if len(parts) == 1 else Sum(tuple(parts))
    return Growing(law, *growths.values()) if growths else law


def _told(key: str, build: Callable[[], Law]) -> Law:
    try:
        return build()
    except InputError as error:
        raise fault(key, f"is at fault: {error}") from None
