"""Doubts about a mesh whose numbers are unlikely for a body in surgery: wrong units are told before they are solved with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ..core.units import density_kg_m3
from .meshes import MeshedBody

UNIT_QUESTION = "is body.mesh_unit right?"
LIKELY_MM = (2.0, 1000.0)  # largest extent of a body in surgery
LIKELY_KG_M3 = (500.0, 2000.0)  # density of tissue, from fat and lung to cortical bone
LIKELY_KPA = (0.05, 1e5)  # Young's modulus of tissue, from fat to tendon
STIFF_KPA = 1e3  # a body without any softer tissue is no soft tissue
ALMOST_INCOMPRESSIBLE = 0.499  # Poisson's ratio above which equilibrium is hard to find
DENSITY_UNITS = {"g/cm^3": 1e3, "g/mm^3": 1e6, "kg/mm^3": 1e9, "t/mm^3": 1e12}  # unit: its value in kg/m^3
STIFFNESS_UNITS = {"MPa": 1e3, "Pa": 1e-3}  # unit: its value in kPa


def doubts_of(given: MeshedBody) -> list[str]:
    """Return a sentence on each number of a mesh that is unlikely; an empty list if all are likely."""
    extent = filter(None, [doubt_of_extent(given.points)])
    return [*extent, *_of_density(density_kg_m3(given.density)), *_of_stiffness(given.E, given.nu)]


def doubt_of_extent(points: np.ndarray) -> str:
    """Return a question for the unit if the extent of a mesh, points (n, 3) [mm], is unlikely; otherwise an empty text."""
    largest = extent_of(points)
    likely = LIKELY_MM[0] <= largest <= LIKELY_MM[1]
    return "" if likely else f"The mesh is {largest:g} mm across: {UNIT_QUESTION}"


def extent_of(points: np.ndarray) -> float:
    """Return the largest extent of a body along an axis: points (n, 3) [mm] -> [mm]."""
    return float(np.ptp(points, axis=0).max())


def _of_density(density: np.ndarray) -> Iterator[str]:
    low, high = LIKELY_KG_M3
    odd = density[_is_outside(density, LIKELY_KG_M3)]
    if odd.size:
        hint = _likely_unit(odd, DENSITY_UNITS, LIKELY_KG_M3) or "is it in kg/m^3?"
        yield f"The density is {_span(odd)} kg/m^3 in {odd.size} tetrahedra; tissue has {low:g} to {high:g}: {hint}"


def _of_stiffness(E: np.ndarray, nu: np.ndarray) -> Iterator[str]:
    odd = E if E.min() >= STIFF_KPA else E[_is_outside(E, LIKELY_KPA)]
    if odd.size:
        soft = LIKELY_KPA[0], STIFF_KPA
        hint = _likely_unit(odd, STIFFNESS_UNITS, soft) or "is it in kPa?"
        yield f"Young's modulus is {_span(odd)} kPa in {odd.size} tetrahedra; soft tissue has {soft[0]:g} to {soft[1]:g}: {hint}"
    stiff = nu[nu > ALMOST_INCOMPRESSIBLE]
    if stiff.size:
        yield (
            f"Poisson's ratio is {_span(stiff, 9)} in {stiff.size} tetrahedra: above {ALMOST_INCOMPRESSIBLE} the solver may find "
            "no equilibrium, and 0.495 gives nearly the same shape."
        )


def _is_outside(values: np.ndarray, likely: tuple[float, float]) -> np.ndarray:
    return (values < likely[0]) | (values > likely[1])


def _likely_unit(values: np.ndarray, units: Mapping[str, float], likely: tuple[float, float]) -> str:
    """Return a question for the unit in which the values would be likely; an empty text if there is none."""
    fitting = [
        unit for unit, size in units.items() if likely[0] <= values.min() * size and values.max() * size <= likely[1]
    ]
    return f"is it in {fitting[0]}?" if fitting else ""


def _span(values: np.ndarray, digits: int = 5) -> str:
    low, high = values.min(), values.max()
    return f"{low:.{digits}g}" if low == high else f"{low:.{digits}g} to {high:.{digits}g}"
