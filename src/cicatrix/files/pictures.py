"""An image as pages show it: 256 greys, and no more voxels than a page bears."""

from __future__ import annotations

import numpy as np

from ..geometry.volume import Volume

MOST_VOXELS = 6_000_000  # of a picture: some 5 MB in a page
DARKEST, BRIGHTEST = 0.5, 99.5  # percentiles that become black and white


def picture(image: Volume, most_voxels: int = MOST_VOXELS) -> tuple[Volume, str]:
    """Thin an image and turn it into greys.

    Parameters
    ----------
    image : Volume
        Values (nz, ny, nx) in any unit.
    most_voxels : int
        Every second, third, ... voxel is kept along its finest axes until no more are left.

    Returns
    -------
    Volume, str
        Values (nz, ny, nx) uint8, and a sentence on what was thinned; empty if nothing was.
    """
    thin = image.every(steps_to(image.shape, image.spacing_mm, most_voxels))
    low, high = np.percentile(thin.values, (DARKEST, BRIGHTEST))
    greys = np.clip((thin.values.astype(np.float32) - low) / max(high - low, 1e-9), 0.0, 1.0) * 255.0
    return thin.with_values(np.rint(greys).astype(np.uint8)), _sentence(image, thin)


def steps_to(
    shape: tuple[int, int, int], spacing_mm: tuple[float, float, float], most_voxels: int
) -> tuple[int, int, int]:
    """Every how many voxels to keep along z, y, x; shape along z, y, x, spacing along x, y, z; the finest axis goes first."""
    steps = [1, 1, 1]
    while np.prod([-(-n // k) for n, k in zip(shape, steps)]) > most_voxels:
        steps[int(np.argmin(np.array(spacing_mm[::-1]) * steps))] += 1
    return steps[0], steps[1], steps[2]


def _sentence(image: Volume, thin: Volume) -> str:
    if thin.shape == image.shape:
        return ""
    before, after = ("x".join(str(n) for n in volume.shape[::-1]) for volume in (image, thin))
    return f"The picture in the report is thinned from {before} to {after} voxels; the run used them all."
