"""Reduce an image for display in a web page: 256 greys, and a limited number of voxels."""

from __future__ import annotations

import numpy as np

from ..geometry.volume import Volume

MAX_VOXELS = 6_000_000  # largest number of voxels, about 5 MB in a page
DARKEST, BRIGHTEST = 0.5, 99.5  # percentiles of the values that become black and white


def picture(image: Volume, max_voxels: int = MAX_VOXELS) -> tuple[Volume, str]:
    """Subsample an image to at most ``max_voxels`` voxels, and convert its values to 256 greys.

    Parameters
    ----------
    image : Volume
        Values (nz, ny, nx) in any unit.
    max_voxels : int
        Largest number of voxels; a larger image keeps every second, third, ... voxel along its finest axes.

    Returns
    -------
    Volume, str
        Values (nz, ny, nx) uint8, and a sentence on the subsampling; empty if there was none.
    """
    thin = image.every(steps_to(image.shape, image.spacing_mm, max_voxels))
    low, high = np.percentile(thin.values, (DARKEST, BRIGHTEST))
    greys = np.clip((thin.values.astype(np.float32) - low) / max(high - low, 1e-9), 0.0, 1.0) * 255.0
    return thin.with_values(np.rint(greys).astype(np.uint8)), _sentence(image, thin)


def steps_to(
    shape: tuple[int, int, int], spacing_mm: tuple[float, float, float], max_voxels: int
) -> tuple[int, int, int]:
    """Choose the subsampling steps along z, y, x, the finest axis first; shape is along z, y, x, spacing along x, y, z."""
    steps = [1, 1, 1]
    while np.prod([-(-n // k) for n, k in zip(shape, steps)]) > max_voxels:
        steps[int(np.argmin(np.array(spacing_mm[::-1]) * steps))] += 1
    return steps[0], steps[1], steps[2]


def _sentence(image: Volume, thin: Volume) -> str:
    if thin.shape == image.shape:
        return ""
    before, after = ("x".join(str(n) for n in volume.shape[::-1]) for volume in (image, thin))
    return f"The picture in the report is reduced from {before} to {after} voxels; the run used them all."
