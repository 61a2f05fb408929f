"""Plane section through patient space, with its own coordinate axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.errors import InputError
from .volume import Volume

# plane -> LPS axes (x left, y posterior, z superior) of its first axis, second axis and normal; right-handed
PLANES = {"axial": (0, 1, 2), "sagittal": (1, 2, 0)}
AXIS_NAMES = ("left", "posterior", "superior")


@dataclass(frozen=True)
class Section:
    """Axial or sagittal plane; its section coordinates are LPS coordinates in another order [mm].

    Parameters
    ----------
    plane : "axial" or "sagittal"
        Orientation of the plane.
    position_mm : float
        LPS coordinate along the normal [mm].
    """

    plane: str
    position_mm: float

    def __post_init__(self) -> None:
        if self.plane not in PLANES:
            raise InputError(f"image.plane must be one of {', '.join(PLANES)}; got {self.plane}.")

    @property
    def axes(self) -> tuple[int, int, int]:
        """Indices of the LPS axes along which the section's first axis, second axis and normal lie."""
        return PLANES[self.plane]

    @property
    def axis_labels(self) -> tuple[str, str]:
        """Labels of the two axes of a figure."""
        a, b, _ = self.axes
        return f"{AXIS_NAMES[a]} [mm]", f"{AXIS_NAMES[b]} [mm]"

    def from_patient(self, vectors: np.ndarray) -> np.ndarray:
        """Reorder LPS components into section axes (first, second, normal): (..., 3) -> (..., 3)."""
        return np.asarray(vectors, float)[..., list(self.axes)]

    def to_patient(self, points: np.ndarray) -> np.ndarray:
        """Convert points of the plane from section coordinates (..., 2) [mm] to LPS (..., 3) [mm]."""
        out = np.full((*np.shape(points)[:-1], 3), self.position_mm, float)
        out[..., list(self.axes[:2])] = points
        return out

    def raster(self, volume: Volume, pixel_mm: float) -> Raster:
        """Return a pixel grid that covers the volume's extent in this plane.

        Raises
        ------
        InputError
            If the plane lies outside the volume.
        """
        low = np.asarray(volume.origin_mm, float)
        high = low + (np.array(volume.shape[::-1]) - 1) * volume.spacing_mm
        half = 0.5 * np.asarray(volume.spacing_mm)
        n = self.axes[2]
        if not low[n] - half[n] <= self.position_mm <= high[n] + half[n]:
            raise InputError(
                f"image.slice_mm must lie inside the image, {low[n]:.1f} to {high[n]:.1f} mm along {AXIS_NAMES[n]}; "
                f"got {self.position_mm:.1f}."
            )
        a, b = self.axes[:2]
        shape = tuple(int(np.floor((high[i] - low[i]) / pixel_mm)) + 1 for i in (b, a))
        return Raster((low[a], low[b]), pixel_mm, shape)


@dataclass(frozen=True)
class Raster:
    """Grid of square pixels in section coordinates.

    Parameters
    ----------
    origin_mm : (2,) tuple [mm]
        Centre of the first pixel along the section's first and second axis.
    pixel_mm : float
        Pixel edge [mm].
    shape : (2,) tuple of int
        Number of pixels along the second and the first axis.
    """

    origin_mm: tuple[float, float]
    pixel_mm: float
    shape: tuple[int, int]

    @property
    def points(self) -> np.ndarray:
        """Pixel centres (n_second, n_first, 2) [mm]."""
        first = self.origin_mm[0] + self.pixel_mm * np.arange(self.shape[1])
        second = self.origin_mm[1] + self.pixel_mm * np.arange(self.shape[0])
        return np.stack(np.meshgrid(first, second), axis=-1)

    def widened(self) -> Raster:
        """Return the raster with one more pixel on every side."""
        x, y = self.origin_mm
        ny, nx = self.shape
        return Raster((x - self.pixel_mm, y - self.pixel_mm), self.pixel_mm, (ny + 2, nx + 2))

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Coordinates of the raster's left, right, bottom and top border in a figure whose second axis points down [mm]."""
        h = 0.5 * self.pixel_mm
        (x0, y0), (ny, nx) = self.origin_mm, self.shape
        return x0 - h, x0 + (nx - 0.5) * self.pixel_mm, y0 + (ny - 0.5) * self.pixel_mm, y0 - h

    def index(self, points: np.ndarray) -> np.ndarray:
        """Return the fractional pixel row and column at points: (..., 2) [mm] -> (2, ...) [1]."""
        p = (np.asarray(points, float) - self.origin_mm) / self.pixel_mm
        return np.stack([p[..., 1], p[..., 0]])
