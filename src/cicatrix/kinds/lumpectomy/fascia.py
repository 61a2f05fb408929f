"""Fascia of a case: its springs on the chest wall that the image shows, stiffer along the inframammary fold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...geometry.distance import GridDistance
from ...geometry.section import Section
from ...geometry.volume import Volume
from ...mechanics.fascia import Fascia
from .case import FasciaTable

FOLD_MM = 6.0  # facets whose centre lies this close to the fold, along the body, belong to it
GRID_MM = 3.0  # spacing of the distance field in a section


@dataclass(frozen=True, eq=False)
class Wall:
    """Chest wall behind a meshed body.

    Parameters
    ----------
    distance : GridDistance
        Signed distance to the wall, in the body's axes.
    in_fold : (n_facets,) bool array
        Whether each facet on the wall belongs to the inframammary fold.
    """

    distance: GridDistance
    in_fold: np.ndarray

    def fascia(self, table: FasciaTable) -> Fascia:
        """Return the springs on the wall."""
        return Fascia(self.distance, table.stiffness_kPa_per_mm * np.where(self.in_fold, table.fold_factor, 1.0))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays from which ``from_arrays`` builds the same wall again."""
        field = self.distance
        coefficients = np.asarray(field.coefficients)
        return {
            "wall_coefficients": coefficients,
            "wall_origin_mm": field.origin,
            "wall_spacing_mm": field.spacing,
            "in_fold": self.in_fold,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Wall | None:
        """Rebuild a wall, to the bit; None if there is none among the arrays."""
        if "in_fold" not in arrays:
            return None
        names = ("wall_coefficients", "wall_origin_mm", "wall_spacing_mm")
        return cls(GridDistance(*(arrays[name] for name in names)), arrays["in_fold"])


def distance_in_solid(distance_mm: Volume) -> GridDistance:
    """Return the signed distance to the chest wall in a solid's axes, from its values on a grid."""
    return GridDistance.through(distance_mm.values, np.array(distance_mm.origin_mm), np.array(distance_mm.spacing_mm))


def distance_in_section(distance_mm: Volume, section: Section) -> GridDistance:
    """Return the signed distance to the chest wall in a section's axes.

    It is the distance in space: where the wall is oblique to the section, the springs normal to it are softer in the plane.
    """
    corners = distance_mm.position(np.array([[0.0] * 3, np.array(distance_mm.shape) - 1.0]))
    low, high = np.sort(section.from_patient(corners)[:, :2], axis=0)
    x, y = (np.arange(a, b, GRID_MM) for a, b in zip(low, high, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    return GridDistance.through(distance_mm.sample(section.to_patient(points)), low, np.full(2, GRID_MM))


def in_fold(fold: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Check which facets on the wall belong to the inframammary fold.

    Parameters
    ----------
    fold : (2, nx) array [mm]
        x and z of the fold; z is NaN where there is none.
    centres : (n, 3) array [mm]
        Centres of the facets, LPS.
    """
    x, z = fold[:, np.isfinite(fold[1])]
    if not len(x):
        return np.zeros(len(centres), bool)
    return np.abs(centres[:, 2] - np.interp(centres[:, 0], x, z, np.nan, np.nan)) < FOLD_MM
