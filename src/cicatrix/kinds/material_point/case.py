"""Tables of a case of kind "material-point": plain data."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, model_validator
from pydantic_core import PydanticCustomError

from ...cases.bounds import OUT_OF_RANGE, Integer, Number, Times, bounds, fault
from ...cases.laws import AnyGrowth, AnyLaw, checked_law
from ...cases.table import Case, Table
from ...materials.material import has_bulk_modulus

Quantity = Literal["stretch", "stress"]
QUANTITIES = ("stretch", "stress")
Corners = tuple[Number, ...]


def _control(value: Any) -> Any:
    """Turn one word into a tuple, and check the words, one for all axes or one for each."""
    words = value if isinstance(value, (list, tuple)) else [value]
    if words and all(word in QUANTITIES for word in words):
        return tuple(words)
    raise PydanticCustomError(
        OUT_OF_RANGE, "{words}", {"words": 'must be "stretch" or "stress", or a list of one of them for each axis'}
    )


class LoadingTable(Table):
    """Prescribed stretches [1] or Cauchy stresses [kPa] at some times, linear between.

    Without ``y``, the stress along y is zero. With ``z`` the loading is fully three-dimensional, and ``plane`` is left out.
    """

    control: Annotated[tuple[Quantity, ...], BeforeValidator(_control)] = ("stretch",)  # one for all axes, or for each
    plane: Literal["incompressible", "stress", "strain"] | None = None  # condition along z; default: incompressible
    time_h: Times  # times at which values are given
    x: Corners  # stretch or stress along x
    y: Corners | None = None  # stretch or stress along y
    z: Corners | None = None  # stretch or stress along z
    shear: Corners | None = None  # component F_xy of the deformation gradient; default 0
    steps_per_segment: Annotated[Integer, bounds(least=1, most=1_000_000)] = 50  # time steps between two given times
    repeat: Annotated[Integer, bounds(least=1, most=100_000)] = 1  # number of times that the loading is applied

    @property
    def thickness(self) -> str:
        """Condition along z: a value of ``plane``, or "given" if z is prescribed."""
        return self.plane or ("incompressible" if self.z is None else "given")

    def axes(self) -> dict[str, tuple[Quantity, Corners]]:
        """Return the prescribed axes: axis -> (stretch or stress, its values)."""
        given = {"x": self.x, "y": self.y, "z": self.z}
        words = self.control * 3 if len(self.control) == 1 else self.control
        return {axis: (words["xyz".index(axis)], values) for axis, values in given.items() if values is not None}

    @model_validator(mode="after")
    def _fits_together(self) -> LoadingTable:
        given = {"x": self.x, "y": self.y, "z": self.z, "shear": self.shear}
        n = len(self.time_h)
        for key, values in given.items():
            if values is not None and len(values) != n:
                raise fault(key, f"must have as many values as time_h ({n}); got {len(values)}")
            if values is not None and self.repeat > 1 and values[0] != values[-1]:
                raise fault(
                    key, f"must end where it starts for repeat = {self.repeat}; got {values[0]:g} and {values[-1]:g}"
                )
        if self.z is not None and self.plane is not None:
            raise fault("plane", "is a condition along z, and z is given: leave one of the two out")
        return self

    @model_validator(mode="after")
    def _axes_are_controlled(self) -> LoadingTable:
        last = "z" if self.z is not None else "y"
        if len(self.control) not in (1, "xyz".index(last) + 1):
            words = {"y": "one word, or two: for x and y", "z": "one word, or three: for x, y and z"}[last]
            raise fault("control", f"must be {words}; got {len(self.control)}")
        if self.y is None and len(self.control) > 1 and self.control[1] == "stretch":
            raise fault("y", 'is missing, as control makes y a stretch; with "stress" along y it may be left out')
        for axis, (quantity, values) in self.axes().items():
            if quantity == "stretch" and min(values) <= 0.0:
                raise fault(axis, f'must be above 0 for control = "stretch"; got {min(values):g}')
        return self


class PointSolverTable(Table):
    """Accuracy of the time integration."""

    relative_tolerance: Annotated[Number, bounds(least=1e-7, most=0.1)] = (
        1e-4  # error of the curves; time steps are refined until it is met
    )


class PointCase(Case):
    """A material law without a mesh: one homogeneous point under a loading.

    The stresses of all tables ``[[law]]`` add up; ``[growth]`` makes the whole tissue grow.
    """

    kind: Literal["material-point"] = "material-point"  # kind of the case
    # material: the sum of all tables
    law: tuple[AnyLaw, ...]  # pyright: ignore[reportInvalidTypeForm]
    # growth of the whole tissue
    growth: AnyGrowth | None = None  # pyright: ignore[reportInvalidTypeForm]
    loading: LoadingTable
    solver: PointSolverTable = PointSolverTable()

    @model_validator(mode="after")
    def _makes_a_law(self) -> PointCase:
        if not self.law:
            raise fault("law", "must be at least one table [[law]]")
        law = checked_law(self)
        thickness = self.loading.thickness
        if thickness == "incompressible" and _depends_on_mean_stress(self.growth):
            words = "needs the mean stress, which a law leaves undetermined in incompressible tissue: give"
            raise fault("growth.homeostatic_kPa", f'{words} loading.plane = "stress" or "strain"')
        if thickness == "incompressible" and _depends_on_volume(self.growth):
            words = 'depends on the elastic change of volume, which loading.plane = "incompressible" excludes: give'
            raise fault(
                "growth", f'by volume {words} loading.plane = "stress" or "strain", and kappa_kPa of a part of the law'
            )
        if thickness != "incompressible" and not has_bulk_modulus(law):
            word = "loading.z" if thickness == "given" else f'loading.plane = "{thickness}"'
            raise fault("law", f"must have a bulk modulus for {word}: set kappa_kPa of at least one [[law]] above 0")
        return self


def _depends_on_mean_stress(growth: Any) -> bool:
    return getattr(growth, "type", None) == "volume" and growth.homeostatic_kPa is not None


def _depends_on_volume(growth: Any) -> bool:
    return getattr(growth, "type", None) == "volume" and growth.homeostatic_kPa is None
