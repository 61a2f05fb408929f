"""The chest behind the breast: its wall, found or given, the midline, and the columns of breast and trunk."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage as ndi
from scipy.interpolate import RBFInterpolator

from ..core.errors import InputError
from ..geometry.volume import Volume
from . import wall
from .trunk import NO_TRUNK, Trunk, around, moved_back, usable

COARSE_MM = 2.0  # voxel edge of the grid on which the chest wall is searched
INNER = 4  # coarse voxels from the edge of the breast's base, from which on the wall is not moved for a trunk
BEFORE_EDGE_MM = 1.0  # the wall lies at least this far in front of the image's last row

ChestWall = Mapping[str, object] | np.ndarray | Sequence


@dataclass(frozen=True, eq=False)
class Chest:
    """Where the chest is, and what tells whether that can be true.

    Parameters
    ----------
    found_mm, wall_mm : (nz, nx) array
        y of the wall as found, and moved back where a trunk would be too thin [mm].
    columns : (nz, nx) bool array
        Columns of the breast.
    beside : (nz, nx) bool array
        Columns of the trunk around it; none without a trunk.
    midline_mm : float
        x of the midline [mm].
    shows_both : bool
        Whether the image shows both breasts.
    skin_mm : (2, n) array
        x, and the median y of the skin there [mm].
    depth_mm : float
        Distance from the skin to the wall that half a per cent of all columns exceeds [mm].
    rear_share : float
        Share of the breast's columns in which the image ends before the wall [1].
    notes : tuple of str
        How the wall was found, and where it was moved.
    """

    found_mm: np.ndarray
    wall_mm: np.ndarray
    columns: np.ndarray
    beside: np.ndarray
    midline_mm: float
    shows_both: bool
    skin_mm: np.ndarray
    depth_mm: float
    rear_share: float
    notes: tuple[str, ...]


def find_chest(
    flat: Volume, body: np.ndarray, fat_bright: bool, side: str, given: ChestWall | None, trunk: Trunk = NO_TRUNK
) -> Chest:
    """Find the chest behind the breast of one side and the trunk around it; the wall is searched, or taken as given.

    Parameters
    ----------
    flat : Volume
        (nz, ny, nx) intensities without bias field.
    body : (nz, ny, nx) bool array
        Voxels of the body.
    fat_bright : bool
        True for T1 without fat saturation.
    side : str
        "left" or "right".
    given : mapping or (n, 3) array, optional
        A plane, or points of the wall, as in `segment`.
    trunk : Trunk
        Margins of trunk. It ends at the midline if the image shows both breasts, and where the image ends before the wall.

    Raises
    ------
    InputError
        If no breast protrudes on that side, the given wall is unusable, or the skin crosses the wall in the trunk.
    """
    coarse, solid = _coarse(flat, body)
    x_mm, skin = coarse.axis(2), coarse.origin_mm[1] + wall.front(solid) * coarse.spacing_mm[1]
    sign = 1.0 if side == "left" else -1.0
    rows = wall.breast_rows(skin)
    midline, shows_both = wall.find_midline(rows, x_mm, sign)
    on_side = sign * (x_mm - midline) > 0
    if given is None:
        surface, note = _searched_wall(coarse, solid, skin, midline, on_side, fat_bright)
    else:
        surface, note = _given_wall(given, coarse)
    last = flat.axis(1)[-1] - BEFORE_EDGE_MM
    beyond = surface > last
    surface = np.minimum(surface, last)  # the wall must lie within the image
    voxel = coarse.spacing_mm[2], coarse.spacing_mm[0]
    columns = wall.foot(surface - skin, on_side, voxel)
    found_mm = _refine(surface, coarse, flat)
    fine_columns = _refine(ndi.gaussian_filter(columns.astype(float), 1.0), coarse, flat) > 0.2  # slightly too wide
    wall_mm, beside, notes = found_mm, np.zeros_like(fine_columns), ()
    if not trunk.is_empty:
        wide = around(columns, trunk, side, voxel) & ~beyond & (on_side | (not shows_both))
        wide = _refine(usable(wide, columns, surface, voxel).astype(float), coarse, flat) > 0.5
        beside = wide & ~fine_columns & body.any(axis=1)
        inner = _refine(ndi.binary_erosion(columns, iterations=INNER).astype(float), coarse, flat) > 0.5
        wall_mm, notes = moved_back(found_mm, body, (wide | fine_columns) & ~inner, flat, is_given=given is not None)
    return Chest(
        found_mm=found_mm,
        wall_mm=wall_mm,
        columns=fine_columns,
        beside=beside,
        midline_mm=midline,
        shows_both=shows_both,
        skin_mm=np.stack([x_mm, np.median(rows, axis=0)]),
        depth_mm=float(np.percentile(np.where(on_side, surface - skin, 0.0), 99.5)),
        rear_share=float(beyond[columns].mean()),
        notes=(note, *notes),
    )


def _searched_wall(
    coarse: Volume, solid: np.ndarray, skin: np.ndarray, midline: float, on_side: np.ndarray, fat_bright: bool
) -> tuple[np.ndarray, str]:
    """Return the y of the wall (nz, nx) [mm], found in the image, and a note."""
    surface = wall.wall_surface(coarse, wall.prior(skin, coarse.axis(2), midline), fat_bright)
    surface, settled = wall.follow_contour(coarse, solid, surface, skin, on_side)
    contour = "refined by a localized contour" if settled else "the localized contour did not converge"
    how = f"by search, {contour}" if settled else f"by search; {contour}"
    return surface, f"chest wall automatic ({how}), midline at x = {midline:.0f} mm"


def _given_wall(given: ChestWall, grid: Volume) -> tuple[np.ndarray, str]:
    """Return the y of the wall (nz, nx) [mm] from a given plane or points, and a note."""
    x, z = grid.axis(2)[None, :], grid.axis(0)[:, None]
    if isinstance(given, Mapping):
        point, normal = (np.asarray(given[k], float) for k in ("point_mm", "normal"))
        if point.shape != (3,) or normal.shape != (3,) or abs(normal[1]) < 0.2 * np.linalg.norm(normal):
            raise InputError("chest_wall: the plane's normal must point to the front or back (|y| at least 0.2 of it).")
        return point[1] - ((x - point[0]) * normal[0] + (z - point[2]) * normal[2]) / normal[
            1
        ], "chest wall: given plane"
    points = np.asarray(given, float)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise InputError("chest_wall: give at least 4 points of x, y, z in mm, not all on one line.")
    try:
        spline = RBFInterpolator(points[:, [2, 0]], points[:, 1])
    except (np.linalg.LinAlgError, ValueError):
        raise InputError("chest_wall: the points lie on one line seen from the front; spread them out.") from None
    where = np.stack(np.broadcast_arrays(z, x), axis=-1).reshape(-1, 2)
    return spline(where).reshape(z.size, x.size), f"chest wall: spline through {len(points)} given points"


def _coarse(flat: Volume, body: np.ndarray) -> tuple[Volume, np.ndarray]:
    """Return image and body mask resampled to a grid of about 2 mm."""
    size = np.asarray(flat.spacing_mm[::-1])
    factor = np.maximum(COARSE_MM / size, 1e-9)
    shape = np.maximum(np.round(np.asarray(flat.shape) / factor).astype(int), 2)
    true = (np.asarray(flat.shape) - 1) / (shape - 1)
    sigma = np.where(true > 1, 0.4 * true, 0)
    index = np.meshgrid(*[np.arange(n) * t for n, t in zip(shape, true)], indexing="ij")
    values = ndi.map_coordinates(ndi.gaussian_filter(flat.values, sigma), index, order=1)
    solid = ndi.map_coordinates(ndi.gaussian_filter(body.astype(np.float32), sigma), index, order=1) > 0.5
    sz, sy, sx = (true * size).tolist()
    return Volume(values, (sx, sy, sz), flat.origin_mm), solid


def _refine(field: np.ndarray, coarse: Volume, fine: Volume) -> np.ndarray:
    """Interpolate a height map (nz, nx) from the coarse to the fine grid."""
    z = (fine.axis(0) - coarse.origin_mm[2]) / coarse.spacing_mm[2]
    x = (fine.axis(2) - coarse.origin_mm[0]) / coarse.spacing_mm[0]
    return ndi.map_coordinates(field, np.meshgrid(z, x, indexing="ij"), order=1, mode="nearest")
