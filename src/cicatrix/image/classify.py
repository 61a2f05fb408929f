"""Tissue classes of the breast with probabilities."""

from __future__ import annotations

import numpy as np
from scipy import ndimage as ndi

from ..geometry.volume import Volume
from .anatomy import SKIN_MM

FIELD_MM = 22.0  # residual bias is smoother than this
ROUNDS = 3


def gland_probability(image: Volume, inside: np.ndarray, fat_bright: bool) -> np.ndarray:
    """Probability of gland against fat: (nz, ny, nx) image, bool mask -> (nz, ny, nx) float32, 0 outside the mask.

    Two Gaussians on the logarithm of the intensity, fitted by expectation-maximisation that alternates with a smooth
    log-bias estimated from the fat (Wells et al., IEEE TMI 15 (1996)); then one mean-field sweep towards the
    neighbourhood's mean, which is the spatial prior.
    """
    floor = 0.02 * float(np.median(image.values[inside])) + 1e-6
    log = np.log(np.maximum(image.values, floor)).astype(np.float32)
    sign = -1.0 if fat_bright else 1.0  # gland is darker or brighter than fat
    field = np.zeros_like(log)
    sigma = [FIELD_MM / s for s in image.spacing_mm[::-1]]
    p = np.zeros_like(log)
    for _ in range(ROUNDS):
        p[inside] = _two_gaussians(sign * (log - field)[inside])
        weight = np.where(inside, (1 - p) ** 2, 0).astype(np.float32)
        mean = float(np.sum(weight * log) / np.sum(weight))
        residual = ndi.gaussian_filter(weight * (log - mean), sigma, truncate=2.5)
        field = residual / np.maximum(ndi.gaussian_filter(weight, sigma, truncate=2.5), 1e-3)
    return _spatial(p, inside, image.spacing_mm)


def _two_gaussians(v: np.ndarray, n_iterations: int = 40) -> np.ndarray:
    """Posterior of the upper of two Gaussians in log-intensity: (n,) -> (n,).

    The upper mean is kept at least log 1.6 above the lower, so that a breast without gland is not split in two.
    """
    sample = v[:: max(len(v) // 60000, 1)]
    low, high = np.quantile(sample, [0.4, 0.95])
    mean = np.array([low, max(high, low + np.log(1.8))])
    sd, share = np.array([0.15, 0.3]), np.array([0.8, 0.2])
    for _ in range(n_iterations):
        r = _posterior(sample, mean, sd, share)
        weight = np.array([(1 - r).sum(), r.sum()]) + 1e-6
        mean = np.array([((1 - r) * sample).sum(), (r * sample).sum()]) / weight
        mean[1] = max(mean[1], mean[0] + np.log(1.6))
        var = np.array([((1 - r) * (sample - mean[0]) ** 2).sum(), (r * (sample - mean[1]) ** 2).sum()]) / weight
        sd = np.clip(np.sqrt(var), 0.05, 0.45)
        share = np.clip(weight / weight.sum(), 0.02, 0.98)
    return _posterior(v, mean, sd, share)


def _posterior(v: np.ndarray, mean: np.ndarray, sd: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Posterior of the upper Gaussian, monotone in ``v`` beyond the two means."""
    v = np.clip(v, mean[0], mean[1])
    log_odds = np.log(share[1] / share[0] * sd[0] / sd[1])
    log_odds = log_odds + 0.5 * ((v - mean[0]) / sd[0]) ** 2 - 0.5 * ((v - mean[1]) / sd[1]) ** 2
    return 1 / (1 + np.exp(-np.clip(log_odds, -30, 30)))


def _spatial(p: np.ndarray, inside: np.ndarray, spacing_mm: tuple[float, float, float]) -> np.ndarray:
    """One mean-field step: odds times the neighbourhood's, 1 mm wide."""
    sigma = [0.7 / s for s in spacing_mm[::-1]]
    weight = ndi.gaussian_filter(inside.astype(np.float32), sigma)
    near = ndi.gaussian_filter(np.where(inside, p, 0), sigma) / np.maximum(weight, 1e-3)
    a, b = p * (0.1 + near), (1 - p) * (1.1 - near)
    return np.where(inside, a / np.maximum(a + b, 1e-9), 0).astype(np.float32)


def skin_probability(body: np.ndarray, spacing_mm: tuple[float, float, float]) -> np.ndarray:
    """Part of each body voxel within 1.45 mm of the air: (nz, ny, nx) bool -> (nz, ny, nx) float32."""
    size = np.asarray(spacing_mm)[::-1]
    distance, nearest = ndi.distance_transform_edt(body, sampling=size, return_indices=True)
    step = np.abs(np.indices(body.shape) - nearest) * size[:, None, None, None]
    length = np.maximum(distance, 1e-6)
    edge = np.sqrt(
        ((step / length * size[:, None, None, None]) ** 2).sum(axis=0)
    )  # voxel edge along the way to the air
    depth = distance - 0.5 * edge  # of the voxel's centre below the surface
    p = np.clip((SKIN_MM - depth) / np.maximum(edge, 1e-6) + 0.5, 0, 1)
    return np.where(body, p, 0).astype(np.float32)


def bright_mass(image: Volume, inside: np.ndarray, centre_mm: tuple[float, float, float]) -> np.ndarray:
    """A bright compact mass near a point: (nz, ny, nx) bool, empty if there is none.

    Fat-saturated images only. Voxels brighter than halfway between the gland-like upper quartile and the brightest
    within 8 mm of the point, connected to it, within 20 mm; refused if not compact (less than a third of the ball with
    its greatest radius).
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
    pieces, _ = ndi.label(ndi.binary_opening(inside & (r < 20) & (smooth > level)))
    found = np.unique(pieces[near])
    found = found[found > 0]
    if not len(found):
        return np.zeros_like(inside)
    mass = pieces == found[np.argmax(ndi.sum_labels(near, pieces, found))]
    spread = np.sqrt(5 / 3 * ((r[mass] - 0) ** 2).mean()) if mass.any() else 0.0
    compact = mass.sum() * float(np.prod(size)) > 4.19 * spread**3 / 3
    return mass if compact else np.zeros_like(inside)
