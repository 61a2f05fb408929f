"""Posterior boundary of the breast: the chest wall as a height map y(x, z), and the base of the breast on it.

A search over depth levels finds the wall, and a localized contour refines it.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage as ndi

from ..core.errors import InputError
from ..geometry.volume import Volume
from .contour import evolve, heaviside

THORAX_RADIUS_MM = 180.0  # radius of curvature of the prior across the body
LEVEL_MM, ALONG_MM = 3.0, 20.0  # the skin stops receding where it recedes by less than this over that distance
BEHIND_SKIN_MM = 12.0  # prior depth of the wall behind the skin at the midline
WINDOW_MM = (-22.0, 42.0)  # search range relative to the prior
REACH_MM = 7.0  # depth of the tissue that is compared on either side of the wall
BROAD_MM, JUMP_MM = 60.0, 10.0  # width of a median filter, and largest deviation of the wall from that median
CONTOUR_MM = 6.0  # largest distance of the contour from the searched wall
BALL_MM = 8.0  # radius of the ball of the localized contour
BEFORE_WALL_MM = 8.0  # the contour only moves where the breast is thicker than this
MIN_BREAST_MM = 15.0  # smallest height of a breast
FOOT_SHARE = 0.25  # the base ends where the tissue is thinner than this fraction of the breast's height ...
FOOT_MM = (14.0, 22.0)  # ... within these limits


def front(body: np.ndarray) -> np.ndarray:
    """Return the y index of the foremost body voxel of each column: (nz, ny, nx) bool -> (nz, nx); ny if a column has none."""
    return np.where(body.any(axis=1), body.argmax(axis=1), body.shape[1]).astype(float)


def breast_rows(skin_mm: np.ndarray) -> np.ndarray:
    """Return the rows of the skin that tell of the breast: y of the skin (nz, nx) [mm] -> (n, nx) [mm].

    They are all rows, or, if more than half of them pass above and below the breasts, those that pass through one.
    """
    foremost = skin_mm.min(axis=1)
    through = foremost < 0.5 * (foremost.min() + foremost.max())
    return skin_mm if through.mean() >= 0.5 else skin_mm[through]


def find_midline(skin_mm: np.ndarray, x_mm: np.ndarray, sign: float) -> tuple[float, bool]:
    """Return x of the midline, and whether the image shows both breasts: y of the skin (nz, nx) [mm] -> x [mm], bool.

    The skin between two breasts is most posterior at the midline. With only one breast in the image, the midline is where the
    trunk beside it is foremost, or, if the image ends before that can be told, 20 mm medial of the point at which the skin stops
    receding.
    """
    profile = ndi.gaussian_filter1d(np.nanmedian(skin_mm, axis=0), 3)
    here = sign * (x_mm - 0.5 * (x_mm[0] + x_mm[-1]))
    third = np.abs(here) < 0.17 * np.ptp(x_mm)
    middle = np.flatnonzero(third)
    apex = [profile[: middle[0]].min(), profile[middle[-1] + 1 :].min()]
    deepest = middle[np.argmax(profile[middle])]
    if min(profile[deepest] - apex[0], profile[deepest] - apex[1]) > 0.4 * (profile.max() - profile.min()) * 0.5:
        return float(x_mm[deepest]), True
    peak = int(np.argmin(profile))
    medial = np.arange(peak, -1, -1) if sign > 0 else np.arange(peak, len(x_mm))
    medial, beyond = np.split(medial, [_until_level(profile[medial], abs(x_mm[1] - x_mm[0]))])
    if (
        len(beyond) and profile[beyond[-1]] > profile[medial[-1]] + LEVEL_MM
    ):  # the trunk recedes on both sides of the midline
        return float(x_mm[_foremost(profile, medial, beyond)]), False
    flat = x_mm[medial[np.argmax(profile[medial] > profile[medial].max() - 3.0)]]
    return float(np.clip(flat - sign * 20.0, x_mm[0], x_mm[-1])), False


def _foremost(profile: np.ndarray, medial: np.ndarray, beyond: np.ndarray) -> int:
    """Return the index where the trunk beside a breast is foremost.

    Parameters
    ----------
    profile : (n,) array
        y of the skin [mm].
    medial, beyond : (m,), (k,) int array
        Indices from the breast's apex to where the skin stops receding, and on to the image's edge.
    """
    trunk = np.concatenate([medial[np.argmax(profile[medial]) :], beyond])
    if (apex := int(np.argmin(profile[trunk]))) > 0:
        return int(trunk[apex])
    foot = medial[profile[medial] > profile[medial[-1]] - LEVEL_MM]  # the breast ends at the midline
    return int(foot[0])


def _until_level(profile: np.ndarray, step_mm: float) -> int:
    """Return the number of points after which the skin has stopped receding: y of the skin from the apex on (n,) [mm] -> int.

    The trunk beyond the breast, which may recede again, is left out that way.
    """
    n = max(round(ALONG_MM / step_mm), 1)
    ahead = np.lib.stride_tricks.sliding_window_view(np.pad(profile, (0, n), mode="edge"), n + 1).max(axis=1)
    is_low = profile - profile[0] > 0.5 * (profile.max() - profile[0])
    level = np.flatnonzero(is_low & (ahead - profile < LEVEL_MM))
    return int(level[0]) + n + 1 if len(level) else len(profile)


def prior(skin_mm: np.ndarray, x_mm: np.ndarray, midline_mm: float) -> np.ndarray:
    """Return the prior position of the chest wall, a cylindrical thorax: (nz, nx) skin [mm] -> (nz, nx) y [mm]."""
    near = np.abs(x_mm - midline_mm) < 8
    base = ndi.gaussian_filter1d(np.nanmedian(skin_mm[:, near], axis=1), 6, mode="nearest")
    return base[:, None] + BEHIND_SKIN_MM + (x_mm - midline_mm) ** 2 / (2 * THORAX_RADIUS_MM)


def wall_surface(image: Volume, guess_mm: np.ndarray, fat_bright: bool) -> np.ndarray:
    """Find the most likely transition from fat to muscle near a guess, as a smooth surface.

    The cost of a level is minus the normalised contrast between the tissue in front and behind. Costs are aggregated
    along four directions with a penalty on slope (semi-global matching, Hirschmueller, IEEE TPAMI 30 (2008)); the level
    of least cost is refined to sub-voxel accuracy by a parabola.

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
    """Refine a chest wall found by ``wall_surface`` with a localized active contour that starts from it.

    Image and body on an isotropic grid (nz, ny, nx), surface and skin (nz, nx) [mm], ``on_side`` (nx,) bool: columns to
    refine. Returns the wall (nz, nx) [mm], and whether the contour converged; if not, the surface is unchanged.
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
    """Return the signed normalised contrast between the tissue in front and behind, (nz, ny, nx)."""
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
    )  # normalised by the intensity of fat; otherwise muscle to lung would have more contrast than fat to muscle


def _aggregate(cost: np.ndarray) -> np.ndarray:
    """Return the sum of the minimum path costs over four directions: (nz, nx, n_levels) -> same."""
    total = np.zeros_like(cost)
    for axis in (0, 1):
        along = np.moveaxis(cost, axis, 0)
        out = np.moveaxis(total, axis, 0)
        for order in (slice(None), slice(None, None, -1)):
            out[order] += _scanline(along[order])
    return total


def _scanline(cost: np.ndarray, slope: float = 0.06, reach: int = 3) -> np.ndarray:
    """Return the minimum path cost along the first axis with a penalty on changes of level: (n, m, n_levels) -> same."""
    out = cost.copy()
    for i in range(1, len(cost)):
        last = np.pad(out[i - 1], ((0, 0), (reach, reach)), constant_values=np.inf)
        n = cost.shape[-1]
        moves = [last[:, reach + k : reach + k + n] + slope * abs(k) ** 1.5 for k in range(-reach, reach + 1)]
        out[i] += np.min(moves, axis=0) - out[i - 1].min(axis=-1, keepdims=True)
    return out


def foot(height_mm: np.ndarray, on_side: np.ndarray, voxel_mm: tuple[float, float]) -> np.ndarray:
    """Find the columns of the breast: those thicker than a fraction of its height, in one connected component.

    Parameters
    ----------
    height_mm : (nz, nx) array
        Wall minus skin along y [mm].
    on_side : (nx,) bool array
        Columns on the chosen side of the midline.
    voxel_mm : (2,) tuple
        Spacing along z and x [mm].

    Returns
    -------
    (nz, nx) bool array

    Raises
    ------
    InputError
        If no breast protrudes from the chest on that side.
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
