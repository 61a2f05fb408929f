"""Where the breast ends at the back: the chest wall as a height map y(x, z), and the foot of the breast on it.

A search over all levels finds the wall, a localized contour settles on it.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage as ndi

from ..core.errors import InputError
from ..geometry.volume import Volume
from .contour import evolve, heaviside

THORAX_RADIUS_MM = 180.0  # curvature of the prior across the body
BEHIND_SKIN_MM = 12.0  # prior depth of the wall behind the midline skin
WINDOW_MM = (-22.0, 42.0)  # search range about the prior
REACH_MM = 7.0  # tissue compared on either side of the wall
BROAD_MM, JUMP_MM = 60.0, 10.0  # the wall does not leave its median over so wide a window by more than this
CONTOUR_MM = 6.0  # how far the contour may leave the wall that was searched for
BALL_MM = 8.0  # tissue the contour compares
BEFORE_WALL_MM = 8.0  # where the breast is thinner, the contour is left alone by the skin
MIN_BREAST_MM = 15.0  # least height of something called a breast
FOOT_SHARE = 0.25  # the foot ends where the tissue is thinner than this share of the breast's height ...
FOOT_MM = (14.0, 22.0)  # ... within these limits


def front(body: np.ndarray) -> np.ndarray:
    """First body voxel from the front: (nz, ny, nx) bool -> (nz, nx) index, ny where there is none."""
    return np.where(body.any(axis=1), body.argmax(axis=1), body.shape[1]).astype(float)


def find_midline(skin_mm: np.ndarray, x_mm: np.ndarray, sign: float) -> float:
    """Midline: where the skin is farthest back between the breasts, (nz, nx) skin [mm] -> x [mm].

    With one breast in the image it is the place on its medial side where the skin stops receding.
    """
    profile = ndi.gaussian_filter1d(np.nanmedian(skin_mm, axis=0), 3)
    here = sign * (x_mm - 0.5 * (x_mm[0] + x_mm[-1]))
    third = np.abs(here) < 0.17 * np.ptp(x_mm)
    middle = np.flatnonzero(third)
    apex = [profile[: middle[0]].min(), profile[middle[-1] + 1 :].min()]
    deepest = middle[np.argmax(profile[middle])]
    if min(profile[deepest] - apex[0], profile[deepest] - apex[1]) > 0.4 * (profile.max() - profile.min()) * 0.5:
        return float(x_mm[deepest])  # two breasts
    peak = int(np.argmin(profile))
    medial = np.arange(peak, -1, -1) if sign > 0 else np.arange(peak, len(x_mm))
    flat = x_mm[medial[np.argmax(profile[medial] > profile[medial].max() - 3.0)]]
    return float(np.clip(flat - sign * 20.0, x_mm[0], x_mm[-1]))


def prior(skin_mm: np.ndarray, x_mm: np.ndarray, midline_mm: float) -> np.ndarray:
    """Where a plain thorax would be: (nz, nx) skin [mm] -> (nz, nx) y [mm]."""
    near = np.abs(x_mm - midline_mm) < 8
    base = ndi.gaussian_filter1d(np.nanmedian(skin_mm[:, near], axis=1), 6, mode="nearest")
    return base[:, None] + BEHIND_SKIN_MM + (x_mm - midline_mm) ** 2 / (2 * THORAX_RADIUS_MM)


def wall_surface(image: Volume, guess_mm: np.ndarray, fat_bright: bool) -> np.ndarray:
    """Most likely fat-to-muscle transition near a guess, smooth in both directions.

    The cost of a level is minus the normalised contrast between the tissue in front and behind; costs are aggregated
    along four directions with a penalty on slope (semi-global matching, Hirschmueller, IEEE TPAMI 30 (2008)), and the
    cheapest level wins, to sub-voxel by a parabola.

    Parameters
    ----------
    image : Volume
        (nz, ny, nx), bias removed.
    guess_mm : (nz, nx) array
        Prior y of the wall [mm].
    fat_bright : bool
        True for T1 without fat saturation.

    Returns
    -------
    (nz, nx) array
        y of the wall [mm].
    """
    step = image.spacing_mm[1]
    levels = np.arange(WINDOW_MM[0], WINDOW_MM[1], step)
    y = guess_mm[..., None] + levels
    rows = (y - image.origin_mm[1]) / step
    contrast = _contrast(image, fat_bright)
    zz, xx = np.indices(guess_mm.shape)
    where = np.stack(np.broadcast_arrays(zz[..., None], rows, xx[..., None]))  # pyright: ignore[reportIndexIssue]
    cost = -ndi.map_coordinates(contrast, where, order=1, mode="nearest")
    cost += 0.25 * (levels / WINDOW_MM[1]) ** 2
    total = _aggregate(cost)
    best = np.clip(total.argmin(axis=-1), 1, len(levels) - 2)
    below, at, above = (np.take_along_axis(total, (best + k)[..., None], -1)[..., 0] for k in (-1, 0, 1))
    shift = np.clip(0.5 * (below - above) / np.maximum(below - 2 * at + above, 1e-6), -0.5, 0.5)
    surface = guess_mm + levels[0] + (best + shift) * step
    wide = [2 * round(0.5 * BROAD_MM / s) + 1 for s in (image.spacing_mm[2], image.spacing_mm[0])]
    broad = ndi.median_filter(surface, wide, mode="nearest")
    surface = np.clip(surface, broad - JUMP_MM, broad + JUMP_MM)
    return ndi.gaussian_filter(ndi.median_filter(surface, 5, mode="nearest"), 1.0, mode="nearest")


def follow_contour(
    image: Volume, body: np.ndarray, surface_mm: np.ndarray, skin_mm: np.ndarray, on_side: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Let a localized contour settle on the wall, starting from the surface that was searched for.

    Image and body on an isotropic grid (nz, ny, nx), surface and skin (nz, nx) [mm], ``on_side`` (nx,) bool: columns to
    work on. Returns the wall (nz, nx) [mm], and whether the contour settled; if it did not, the surface is as it was.
    """
    step = image.spacing_mm[1]
    y = image.axis(1)[None, :, None]
    off = np.abs(y - surface_mm[:, None, :])
    where = (off < CONTOUR_MM) & (y - skin_mm[:, None, :] > BEFORE_WALL_MM) & on_side
    if not where.any():
        return surface_mm, False
    inside = body & (y < surface_mm[:, None, :])
    contour = evolve(image.values, inside, radius=BALL_MM / step, where=where, n_iterations=150)
    if not contour.converged:
        return surface_mm, False
    window = off < CONTOUR_MM + 1.5 * step
    first = y.ravel()[window.argmax(axis=1)] - 0.5 * step
    found = first + (heaviside(-contour.phi, 1.0) * window).sum(axis=1) * step
    return np.where(where.any(axis=1), found, surface_mm), True


def _contrast(image: Volume, fat_bright: bool) -> np.ndarray:
    """Signed normalised difference between the tissue in front and behind, (nz, ny, nx) in -1..1."""
    sz, sy, sx = image.spacing_mm[::-1]
    smooth = ndi.gaussian_filter(image.values.astype(np.float32), (2.0 / sz, 0.5 / sy, 2.0 / sx))
    n = max(round(REACH_MM / sy), 1)
    mean = ndi.uniform_filter1d(smooth, n, axis=1, mode="nearest")
    ahead = ndi.shift(mean, (0, n / 2, 0), order=1, mode="nearest")
    behind = ndi.shift(mean, (0, -n / 2, 0), order=1, mode="nearest")
    floor = 0.1 * np.percentile(smooth, 90)
    if not fat_bright:
        return (behind - ahead) / (ahead + behind + floor)
    size = [round(20.0 / sz), round(60.0 / sy), round(20.0 / sx)]
    fat = ndi.maximum_filter(mean, [min(s, n) for s, n in zip(size, mean.shape)])
    return (
        1.5 * (ahead - behind) / (fat + floor)
    )  # against fat, else muscle to lung would count more than fat to muscle


def _aggregate(cost: np.ndarray) -> np.ndarray:
    """Sum of directional minimum path costs: (nz, nx, n_levels) -> same."""
    total = np.zeros_like(cost)
    for axis in (0, 1):
        along = np.moveaxis(cost, axis, 0)
        out = np.moveaxis(total, axis, 0)
        for order in (slice(None), slice(None, None, -1)):
            out[order] += _scanline(along[order])
    return total


def _scanline(cost: np.ndarray, slope: float = 0.06, reach: int = 3) -> np.ndarray:
    """Minimum path cost along the first axis with a penalty per level of change: (n, m, n_levels) -> same."""
    out = cost.copy()
    for i in range(1, len(cost)):
        last = np.pad(out[i - 1], ((0, 0), (reach, reach)), constant_values=np.inf)
        n = cost.shape[-1]
        moves = [last[:, reach + k : reach + k + n] + slope * abs(k) ** 1.5 for k in range(-reach, reach + 1)]
        out[i] += np.min(moves, axis=0) - out[i - 1].min(axis=-1, keepdims=True)
    return out


def foot(height_mm: np.ndarray, on_side: np.ndarray, voxel_mm: tuple[float, float]) -> np.ndarray:
    """Columns that belong to the breast: those thicker than a share of its height, in one piece with its apex.

    Parameters
    ----------
    height_mm : (nz, nx) array
        Wall minus skin along y [mm].
    on_side : (nx,) bool array
        Columns on the wanted side of the midline.
    voxel_mm : (2,) tuple
        Spacing along z and x [mm].

    Returns
    -------
    (nz, nx) bool array

    Raises
    ------
    InputError
        Nothing on that side stands out from the chest.
    """
    height = np.where(on_side, height_mm, 0.0)
    top = float(np.percentile(height, 99.5))
    if top < MIN_BREAST_MM:
        raise InputError(
            f"image: no breast found on that side (highest point {max(top, 0):.0f} mm in front of the chest); "
            "check side, position and image, or give the chest wall or a label map."
        )
    least = float(np.clip(FOOT_SHARE * top, *FOOT_MM))
    radius = [max(round(4 / v), 1) for v in voxel_mm]
    tall = ndi.binary_opening(height > least, np.ones((2 * radius[0] + 1, 2 * radius[1] + 1)))
    pieces, n = ndi.label(tall)  # pyright: ignore[reportGeneralTypeIssues]
    if n == 0:
        raise InputError("image: no breast found on that side; check side, position and image, or give a label map.")
    volumes = ndi.sum_labels(height, pieces, np.arange(1, n + 1))
    return ndi.binary_fill_holes(pieces == 1 + int(np.argmax(volumes)))  # pyright: ignore[reportReturnType]
