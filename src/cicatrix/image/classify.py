"""Classification of breast voxels: probabilities of gland and skin, and detection of a bright tumour."""

from __future__ import annotations

import numpy as np
from scipy import ndimage as ndi

from ..geometry.volume import Volume
from .anatomy import SKIN_MM

FIELD_MM = 22.0  # standard deviation of the smoothing that estimates the residual bias field
ROUNDS = 3


def gland_probability(image: Volume, inside: np.ndarray, fat_bright: bool) -> np.ndarray:
    """Return the probability of gland against fat: (nz, ny, nx) image, bool mask -> (nz, ny, nx) float32, 0 outside the mask.

    Soft two-means clustering of the intensity alternates with the estimate of a smooth log bias field from the fat (after
    Wells et al., IEEE TMI 15 (1996)); one final mean-field step towards the mean of the neighbourhood acts as a spatial prior.
    A Gaussian mixture is not used: the peak of fat is so narrow that every partial-volume voxel would become gland.
    """
    floor = 0.02 * float(np.median(image.values[inside])) + 1e-6
    log = np.log(np.maximum(image.values, floor)).astype(np.float32)
    field = np.zeros_like(log)
    sigma = [FIELD_MM / s for s in image.spacing_mm[::-1]]
    p = np.zeros_like(log)
    for _ in range(ROUNDS):
        p[inside] = _soft_two_means(np.exp(log - field)[inside], fat_bright)
        weight = np.where(inside, (1 - p) ** 4, 0).astype(np.float32)
        mean = float(np.sum(weight * log) / np.sum(weight))
        residual = ndi.gaussian_filter(weight * (log - mean), sigma, truncate=2.5)
        field = residual / np.maximum(ndi.gaussian_filter(weight, sigma, truncate=2.5), 1e-3)
    return _spatial(p, inside, image.spacing_mm)


def _soft_two_means(v: np.ndarray, fat_bright: bool, n_iterations: int = 25) -> np.ndarray:
    """Return the membership in gland by soft two-means clustering: intensities (n,) -> (n,).

    The membership is a logistic function, centred at 1/2, of the mixing fraction between the means of fat and gland. The
    mean of gland is limited to at most 0.6 (T1) or at least 1.6 times (fat-saturated) that of fat, so that a breast
    without gland is not split in two.
    """
    sample = v[:: max(len(v) // 60000, 1)]
    fat, gland = np.quantile(sample, [0.7, 0.05] if fat_bright else [0.3, 0.97])
    for _ in range(n_iterations):
        gland = min(gland, 0.6 * fat) if fat_bright else max(gland, 1.6 * fat)
        p = _logistic(sample, fat, gland)
        fat = np.sum((1 - p) ** 2 * sample) / np.sum((1 - p) ** 2 + 1e-9)
        gland = np.sum(p**2 * sample) / max(np.sum(p**2), 1e-9)
    gland = min(gland, 0.6 * fat) if fat_bright else max(gland, 1.6 * fat)
    return _logistic(v, fat, gland)


def _logistic(v: np.ndarray, fat: float, gland: float) -> np.ndarray:
    """Return the membership in gland, a logistic function of the mixing fraction between both mean intensities: (n,) -> (n,)."""
    fraction = (v - fat) / (gland - fat)
    return 1 / (1 + np.exp(-np.clip(12 * (fraction - 0.5), -30, 30)))


def _spatial(p: np.ndarray, inside: np.ndarray, spacing_mm: tuple[float, float, float]) -> np.ndarray:
    """Return probabilities after a mean-field step: the odds of a voxel times those of its neighbourhood (Gaussian, 0.7 mm)."""
    sigma = [0.7 / s for s in spacing_mm[::-1]]
    weight = ndi.gaussian_filter(inside.astype(np.float32), sigma)
    near = ndi.gaussian_filter(np.where(inside, p, 0), sigma) / np.maximum(weight, 1e-3)
    a, b = p * (0.1 + near), (1 - p) * (1.1 - near)
    return np.where(inside, a / np.maximum(a + b, 1e-9), 0).astype(np.float32)


def skin_probability(body: np.ndarray, spacing_mm: tuple[float, float, float]) -> np.ndarray:
    """Return the fraction of each body voxel within 1.45 mm of the air: (nz, ny, nx) bool -> (nz, ny, nx) float32."""
    size = np.asarray(spacing_mm)[::-1]
    distance, nearest = ndi.distance_transform_edt(body, sampling=size, return_indices=True)  # pyright: ignore[reportGeneralTypeIssues]
    step = np.abs(np.indices(body.shape) - nearest) * size[:, None, None, None]
    length = np.maximum(distance, 1e-6)
    edge = np.sqrt(
        ((step / length * size[:, None, None, None]) ** 2).sum(axis=0)
    )  # extent of the voxel in the direction to the air
    depth = distance - 0.5 * edge  # depth of the voxel's centre below the surface
    p = np.clip((SKIN_MM - depth) / np.maximum(edge, 1e-6) + 0.5, 0, 1)
    return np.where(body, p, 0).astype(np.float32)


def bright_mass(image: Volume, inside: np.ndarray, centre_mm: tuple[float, float, float]) -> np.ndarray:
    """Mark a bright compact mass near a point of a fat-saturated image: (nz, ny, nx) bool, empty if there is none.

    The threshold is halfway between the upper quartile of the breast (gland) and the 95th percentile within 8 mm of the
    point. The mass is a connected component of the brighter voxels within 20 mm that reaches these 8 mm. It is rejected
    unless compact: its volume must exceed a third of that of a ball whose radius is sqrt(5/3) times the root mean square
    distance of its voxels from the point.
    """
    size = image.spacing_mm[::-1]
    smooth = ndi.gaussian_filter(image.values, [0.8 / s for s in size])
    z, y, x = np.ogrid[tuple(slice(0, n) for n in image.shape)]
    index = image.voxel(np.asarray(centre_mm, float))
    r = np.sqrt(((z - index[0]) * size[0]) ** 2 + ((y - index[1]) * size[1]) ** 2 + ((x - index[2]) * size[2]) ** 2)
    near = inside & (r < 8)
    if not near.any():
        return np.zeros_like(inside)
    level = 0.5 * (np.percentile(smooth[inside], 75) + np.percentile(smooth[near], 95))
    pieces, _ = ndi.label(ndi.binary_opening(inside & (r < 20) & (smooth > level)))  # pyright: ignore[reportGeneralTypeIssues]
    found = np.unique(pieces[near])
    found = found[found > 0]
    if not len(found):
        return np.zeros_like(inside)
    mass = pieces == found[np.argmax(ndi.sum_labels(near, pieces, found))]
    spread = np.sqrt(5 / 3 * ((r[mass] - 0) ** 2).mean()) if mass.any() else 0.0
    compact = mass.sum() * float(np.prod(size)) > 4.19 * spread**3 / 3
    return mass if compact else np.zeros_like(inside)
