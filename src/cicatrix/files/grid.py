"""Where the voxels of an image lie in the patient, as its header says, and whether that can be true."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ..core.errors import InputError

Note = Callable[[str], None]

MOST_VOXELS = 500_000_000
SMALLEST_MM, LARGEST_MM = 20.0, 800.0  # largest edge of an image of a body part
FARTHEST_MM = 10_000.0  # of a voxel from 0, which lies in the scanner or in the body
FINEST_MM, COARSEST_MM = 0.01, 50.0  # edge of a voxel
SHEAR = 1e-3  # direction cosines this close to orthonormal: 0.3 mm over 300 mm
UNITS = ((0.5e-4, 0.8e-3, "kilometres"), (0.5e-2, 0.8, "metres"), (0.8, SMALLEST_MM, "centimetres or inches"))
AXIS_WORDS = 'give the directions of the file\'s x, y and z by image.axes or --axes, such as "LPS"'


@dataclass(frozen=True)
class Grid:
    """Voxels (nz, ny, nx) in the patient, LPS.

    Parameters
    ----------
    spacing_mm : (3,) tuple of float
        Voxel edges along the file's x, y, z [mm].
    origin_mm : (3,) tuple of float or None
        Centre of the first voxel, LPS [mm]; None if the header does not say.
    directions : (3, 3) array or None
        Columns: directions of the file's x, y, z in LPS [1]; None if the header does not say.
    unit : str
        Unit of length that the header names, where it is not mm.
    """

    spacing_mm: tuple[float, float, float]
    origin_mm: tuple[float, float, float] | None
    directions: np.ndarray | None
    unit: str = "mm"


@dataclass(frozen=True)
class Stored:
    """Voxels as a file stores them.

    Parameters
    ----------
    values : (nz, ny, nx) or (nz, ny, nx, n_layers) array
        In the file's own type, or float32 where the header gives a scale.
    grid : Grid
        Where they lie.
    fields : mapping of str to str
        Key-value pairs of an NRRD header, such as those that name the segments of a segmentation.
    """

    values: np.ndarray
    grid: Grid
    fields: Mapping[str, str] = field(default_factory=dict)


def check_size(size: tuple[int, ...], n_components: int = 1) -> tuple[int, int, int]:
    """Return the numbers of voxels along x, y, z of one scalar volume, before its voxels are read.

    Parameters
    ----------
    size : tuple of int
        Voxels along the axes of the file; trailing axes of length 1 are dropped.
    n_components : int
        Values per voxel.

    Raises
    ------
    InputError
        If it is not such a volume, or has more than `MOST_VOXELS`.
    """
    if not size or min(size) < 1:
        raise InputError(f"the header gives {_by(size)} voxels; each number must be 1 or more")
    while len(size) > 3 and size[-1] == 1:
        size = size[:-1]
    if len(size) > 3:
        raise InputError(f"the image has {len(size)} dimensions; give one 3-D volume, for example a single time point")
    if n_components != 1:
        raise InputError(f"each voxel has {n_components} values; give an image with one intensity per voxel")
    if len(size) < 3 or min(size) < 2:
        raise InputError(
            f"the image is a single slice ({_by(size)} voxels); a volume of two or more slices is needed, "
            "for DICOM the folder of its series"
        )
    if int(np.prod([float(n) for n in size])) > MOST_VOXELS:
        raise InputError(f"the header gives {_by(size)} voxels; at most {MOST_VOXELS:,} can be read: crop the image")
    return size[0], size[1], size[2]


def check_grid(grid: Grid, shape: tuple[int, ...], note: Note) -> None:
    """Judge where the voxels (nz, ny, nx) lie, the same for every format.

    Parameters
    ----------
    note : callable
        Takes sentences on what is assumed.

    Raises
    ------
    InputError
        If a number is not finite, an edge not positive, the axes sheared or unknown, or the size not that of a body part.
    """
    edges = _by(grid.spacing_mm)
    if not all(np.isfinite(edge) and edge > 0 for edge in grid.spacing_mm):
        raise InputError(f"the header gives voxels of {edges} mm; each edge must be a positive number")
    _check_extent(grid, shape, edges)
    if grid.unit != "mm":
        raise InputError(f'the header gives lengths in "{grid.unit}"; they must be in mm')
    if grid.origin_mm is not None and not np.isfinite(grid.origin_mm).all():
        raise InputError(f"the header puts the first voxel at {_by(grid.origin_mm)} mm; all three must be numbers")
    if grid.origin_mm is not None and np.abs(grid.origin_mm).max() > FARTHEST_MM:
        raise InputError(
            f"the header puts the first voxel at {_by(grid.origin_mm)} mm, farther than {FARTHEST_MM / 1000:g} m from 0; "
            "convert the image again"
        )
    if grid.directions is None:
        raise InputError(f"the header does not say how the image lies in the patient; {AXIS_WORDS}")
    check_directions(grid.directions)
    if grid.origin_mm is None:
        note("The header gives no position of the image; its first voxel is taken to lie at 0, 0, 0 mm.")


def check_directions(directions: np.ndarray) -> None:
    """Refuse directions (3, 3) that are not finite, not of length 1, or not at right angles."""
    if not np.isfinite(directions).all():
        raise InputError("the header's directions of the axes are not all numbers; convert the image again")
    product = directions.T @ directions
    cosine = float(np.abs(product - np.diag(np.diag(product))).max())
    if cosine > SHEAR:
        angle = np.rad2deg(np.arcsin(min(cosine, 1.0)))
        raise InputError(
            f"the header's axes are sheared (not orthonormal) by {angle:.2g} degrees; resample the image onto a rectangular grid"
        )
    if np.abs(np.diag(product) - 1).max() > SHEAR:
        raise InputError("the header's directions of the axes are not of length 1; convert the image again")


def scaled(values: np.ndarray, slope: float, intercept: float) -> np.ndarray:
    """Return slope * values + intercept as float32, computed in float64; the values themselves if that changes nothing.

    Raises
    ------
    InputError
        If the slope is 0, or one of the two is not finite.
    """
    if not (np.isfinite(slope) and np.isfinite(intercept) and slope != 0):
        raise InputError(f"the header scales voxels by {slope:g} and adds {intercept:g}; give finite numbers and no 0")
    if (slope, intercept) == (1.0, 0.0):
        return values
    out = np.empty(values.shape, np.float32)
    with np.errstate(over="ignore"):  # what becomes infinite is refused when the whole image is checked
        for plane, to in zip(values, out):
            to[...] = plane * np.float64(slope) + np.float64(intercept)
    return out


def _check_extent(grid: Grid, shape: tuple[int, ...], edges: str) -> None:
    extent = [n * edge for n, edge in zip(shape[::-1], grid.spacing_mm)]
    widest, shown = max(extent), f"{_by(extent)} mm"
    if widest < SMALLEST_MM:
        unit = next((f": {word}?" for low, high, word in UNITS if low <= widest < high), "")
        raise InputError(
            f"the image is {widest:.2g} mm wide ({shown}), a body part {SMALLEST_MM:g} to {LARGEST_MM:g} mm{unit} "
            "- lengths must be in mm"
        )
    if widest > LARGEST_MM:
        unit = ": micrometres?" if widest > 10 * LARGEST_MM else ""
        raise InputError(
            f"the image is {widest:.4g} mm wide ({shown}), a body part {SMALLEST_MM:g} to {LARGEST_MM:g} mm{unit} "
            "- lengths must be in mm"
        )
    if min(grid.spacing_mm) < FINEST_MM or max(grid.spacing_mm) > COARSEST_MM:
        raise InputError(f"the header gives voxels of {edges} mm; an edge is {FINEST_MM:g} to {COARSEST_MM:g} mm")


def _by(numbers) -> str:
    """Return numbers as "3 x 3 x 1.5"."""
    return " x ".join(f"{n:.4g}" if isinstance(n, float) else str(n) for n in numbers)
