"""Trunk around the breast: skin and subcutaneous fat in front of the chest wall, within margins around the breast's base."""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from scipy import ndimage as ndi

from ..core.errors import InputError
from ..geometry.volume import Volume

LEAST_MM = 6.0  # least thickness of the trunk; where the wall lies nearer to the skin, it is moved back
STEEPEST = 1.5  # slope of the wall, dy over dx and dz, at which the trunk ends: there the side of the body begins
EVEN_MM = 4.0  # standard deviation of the smoothing of skin and wall whose slopes and places are compared
JOINT_MM = 12.0  # reach of the smoothing of steps of the wall
SPUR_MM = 5.0  # parts of the body thinner than this are left out where there is a trunk
RIM_VOXELS = 2.0  # standard deviation of the smoothing of the trunk's outline [voxels]
NARROW_MM = 8.0  # parts of the trunk narrower than this are left out
CROSSED_MM = 3.0  # distance of a wall in front of the skin from which it crosses the skin
CROSSED_SHARE = 0.1  # largest share of the trunk in which a given wall may cross the skin
SAID_SHARE = 0.01  # share of the trunk from which a wall that is moved is noted
SAID_MM = 3.0  # a margin that the image falls short of by more than this is noted
SIDES = ("medially", "laterally", "above", "below")


@dataclass(frozen=True)
class Trunk:
    """Margins of trunk around the base of the breast [mm]; all 0 is the breast alone."""

    medial_mm: float = 0.0
    lateral_mm: float = 0.0
    above_mm: float = 0.0
    below_mm: float = 0.0

    @property
    def is_empty(self) -> bool:
        """Whether there is no trunk."""
        return not any(astuple(self))


NO_TRUNK = Trunk()


def around(columns: np.ndarray, trunk: Trunk, side: str, voxel_mm: tuple[float, float]) -> np.ndarray:
    """Return the columns within the margins around the base, base included: (nz, nx) bool -> (nz, nx) bool.

    The base is widened by four quarter ellipses, whose half axes are the margins.

    Parameters
    ----------
    columns : (nz, nx) bool array
        Columns of the breast.
    trunk : Trunk
        Margins.
    side : str
        "left" (lateral is +x) or "right".
    voxel_mm : (2,) tuple
        Spacing along z and x [mm].
    """
    low_x, high_x = (trunk.medial_mm, trunk.lateral_mm) if side == "left" else (trunk.lateral_mm, trunk.medial_mm)
    reach = [
        int(max(ends) / step)
        for ends, step in zip(((trunk.below_mm, trunk.above_mm), (low_x, high_x)), voxel_mm, strict=True)
    ]
    dz, dx = (step * np.arange(-n, n + 1) for step, n in zip(voxel_mm, reach, strict=True))
    square_z, square_x = _share(dz, trunk.below_mm, trunk.above_mm) ** 2, _share(dx, low_x, high_x) ** 2
    ellipse = square_z[:, None] + square_x <= 1.0
    return np.asarray(ndi.binary_dilation(columns, ellipse))


def _share(offset: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return offsets (n,) [mm] as a share of the margin on their side [1]; 0 at 0, infinite beyond a margin of 0."""
    margin = np.where(offset < 0, low, high)
    return np.divide(offset, margin, out=np.where(offset == 0, 0.0, np.inf), where=margin > 0)


def usable(wide: np.ndarray, columns: np.ndarray, wall_mm: np.ndarray, voxel_mm: tuple[float, float]) -> np.ndarray:
    """Return the columns (nz, nx) bool of a trunk ``wide`` without those where the wall is too steep, narrow parts, and holes."""
    gentle = wide & (_slope(_even(wall_mm, voxel_mm), voxel_mm) < STEEPEST)
    radius = [max(round(0.5 * NARROW_MM / step), 1) for step in voxel_mm]
    opened = ndi.binary_opening(gentle | columns, np.ones((2 * radius[0] + 1, 2 * radius[1] + 1)))
    return np.asarray(ndi.binary_fill_holes(opened | columns))


def _even(height_mm: np.ndarray, voxel_mm: tuple[float, float], where: np.ndarray | None = None) -> np.ndarray:
    """Return a smoothed height map (nz, nx) [mm]; with ``where`` (nz, nx) bool, the mean of columns there alone."""
    weight = np.ones_like(height_mm) if where is None else where.astype(float)
    sigma = [EVEN_MM / step for step in voxel_mm]
    total = ndi.gaussian_filter(height_mm * weight, sigma, mode="nearest")
    return total / np.maximum(ndi.gaussian_filter(weight, sigma, mode="nearest"), 1e-6)


def _slope(height_mm: np.ndarray, voxel_mm: tuple[float, float]) -> np.ndarray:
    return np.hypot(*np.gradient(height_mm, *voxel_mm))


def moved_back(
    wall_mm: np.ndarray, body: np.ndarray, domain: np.ndarray, grid: Volume, *, is_given: bool
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the wall (nz, nx) [mm], moved back where skin and fat in front of it would be too thin, and notes that say where.

    Parameters
    ----------
    wall_mm : (nz, nx) array
        y of the wall [mm].
    body : (nz, ny, nx) bool array
        Voxels of the body.
    domain : (nz, nx) bool array
        Columns of the trunk and of the edge of the breast's base.
    grid : Volume
        Grid of the image.
    is_given : bool
        Whether the wall was given by hand.

    Raises
    ------
    InputError
        If a given wall crosses the skin in a large part of breast and trunk.
    """
    voxel = grid.spacing_mm[2], grid.spacing_mm[0]
    skin_mm, known = _skin_before(wall_mm, body, grid)
    ahead = np.where(domain & known, skin_mm - wall_mm, -np.inf)
    crossed = float((ahead > CROSSED_MM)[domain].mean()) if domain.any() else 0.0
    at = _place(ahead, skin_mm, grid)
    if is_given and crossed > CROSSED_SHARE:
        raise InputError(
            f"image.chest_wall: the skin crosses this wall in {100 * crossed:.0f} % of the trunk, most at {at}; give points "
            "of the wall there too, or smaller margins in [trunk]."
        )
    thickness = LEAST_MM * np.sqrt(1.0 + np.minimum(_slope(_even(wall_mm, voxel), voxel), STEEPEST) ** 2)
    near = domain & known & (skin_mm + 2.0 * thickness > wall_mm)  # other skin says nothing of how thin the trunk is
    least = np.where(near, _even(skin_mm, voxel, near) + thickness, -np.inf)
    moved = least > wall_mm + 0.5 * grid.spacing_mm[1]
    notes = []
    if (share := float(moved[domain].mean())) > SAID_SHARE:
        notes.append(f"in {100 * share:.0f} % of the trunk the wall is moved back to {LEAST_MM:g} mm below the skin")
    if crossed > SAID_SHARE:
        notes.append(
            f"there the wall that was found crosses the skin, most at {at}: if that matters, give image.chest_wall"
        )
    return _joined(np.maximum(wall_mm, least), domain, voxel), tuple(notes)


def _joined(wall_mm: np.ndarray, domain: np.ndarray, voxel_mm: tuple[float, float]) -> np.ndarray:
    """Return the wall (nz, nx) [mm] without steps steeper than `STEEPEST`, at which breast and trunk would part."""
    n = [max(round(JOINT_MM / step), 1) for step in voxel_mm]
    dz, dx = (step * np.arange(-k, k + 1) for k, step in zip(n, voxel_mm, strict=True))
    cone = -STEEPEST * np.hypot(dz[:, None], dx)
    foremost = np.where(domain, wall_mm, wall_mm.min())
    return np.where(domain, np.maximum(wall_mm, ndi.grey_dilation(foremost, structure=cone)), wall_mm)


def _skin_before(wall_mm: np.ndarray, body: np.ndarray, grid: Volume) -> tuple[np.ndarray, np.ndarray]:
    """Return the y of the skin next to the wall (nz, nx) [mm], behind all air in front of it, and whether there is any (nz, nx).

    Where a breast hangs over the trunk, this is the skin of the trunk.
    """
    y, first = grid.axis(1), body.argmax(axis=1)
    limit = np.maximum(wall_mm, y[first]) + LEAST_MM
    air = ~body & (y[None, :, None] <= limit[:, None, :])
    last = body.shape[1] - 1 - air[:, ::-1].argmax(axis=1)
    skin = np.where(air.any(axis=1), last + 0.5, -0.5) * grid.spacing_mm[1] + grid.origin_mm[1]
    return skin, np.asarray(body.any(axis=1))


def _place(ahead_mm: np.ndarray, skin_mm: np.ndarray, grid: Volume) -> str:
    z, x = np.unravel_index(int(ahead_mm.argmax()), ahead_mm.shape)
    return f"({grid.axis(2)[x]:.0f}, {skin_mm[z, x]:.0f}, {grid.axis(0)[z]:.0f}) mm (LPS), by {ahead_mm[z, x]:.0f} mm"


def cut_share(domain: np.ndarray, body_share: np.ndarray, wall_mm: np.ndarray, grid: Volume) -> np.ndarray:
    """Return the share of breast and trunk in each voxel (nz, ny, nx) float32, between 0 and 1 where their border cuts it.

    Parameters
    ----------
    domain : (nz, ny, nx) bool array
        Voxels of breast and trunk.
    body_share : (nz, ny, nx) array
        Share of the body, against air [1].
    wall_mm : (nz, nx) array
        y of the chest wall [mm].
    grid : Volume
        Grid of the image.
    """
    before_wall = np.clip((wall_mm[:, None, :] - grid.axis(1)[None, :, None]) / grid.spacing_mm[1] + 0.5, 0, 1)
    within_rim = _rounded(domain.any(axis=1))[:, None, :]
    near = np.asarray(ndi.binary_dilation(_without_spurs(domain, grid)))
    return (near * body_share * before_wall * within_rim).astype(np.float32)


def _without_spurs(domain: np.ndarray, grid: Volume) -> np.ndarray:
    """Return a mask without parts that a ball a little smaller than the trunk's least thickness cannot enter."""
    reach = np.maximum((SPUR_MM / np.asarray(grid.spacing_mm[::-1]) - 1) / 2, 0)
    n = reach.astype(int)
    offsets = np.stack(np.meshgrid(*[np.arange(-k, k + 1) for k in n], indexing="ij"), axis=-1)
    ball = np.sum((offsets / np.maximum(n, 1)) ** 2, axis=-1) <= 1.0
    padded = np.pad(domain, [(k, k) for k in n], mode="edge")
    inner = tuple(slice(k, size - k) for k, size in zip(n, padded.shape, strict=True))
    return np.asarray(ndi.binary_opening(padded, ball))[inner]


def _rounded(columns: np.ndarray) -> np.ndarray:
    """Return the share of columns (nz, nx) bool in a smooth outline around them: -> (nz, nx) [1]."""
    smooth = ndi.gaussian_filter(columns.astype(float), RIM_VOXELS, mode="nearest")
    return np.clip(0.5 + (smooth - 0.5) * RIM_VOXELS * np.sqrt(2 * np.pi), 0, 1)


def shortfall(trunk: Trunk, found: Trunk, at_midline: bool) -> tuple[str, ...]:
    """Return notes on the margins of trunk that were found smaller than asked for, and why."""
    asked, have = astuple(trunk), astuple(found)
    out = []
    for name, wish, got in zip(SIDES, asked, have, strict=True):
        if got < wish - SAID_MM:
            why = (
                "to the midline, where the skin is held by the sternum"
                if name == "medially" and at_midline
                else "the image shows no more"
            )
            out.append(f"trunk {name}: {got:.0f} of {wish:g} mm, {why}")
    return tuple(out)


def extent(columns: np.ndarray, domain: np.ndarray, side: str, voxel_mm: tuple[float, float]) -> Trunk:
    """Return the margins that a domain has around the base of the breast: two (nz, nx) bool -> `Trunk`."""
    below, above = _beyond(columns.any(axis=1), domain.any(axis=1), voxel_mm[0])
    low, high = _beyond(columns.any(axis=0), domain.any(axis=0), voxel_mm[1])
    medial, lateral = (low, high) if side == "left" else (high, low)
    return Trunk(medial, lateral, above, below)


def _beyond(inner: np.ndarray, outer: np.ndarray, step: float) -> tuple[float, float]:
    """Return the distances by which one range of bins exceeds another one at both ends [mm]."""
    a, b = np.flatnonzero(inner)[[0, -1]], np.flatnonzero(outer)[[0, -1]]
    return float((a[0] - b[0]) * step), float((b[1] - a[1]) * step)
