"""Reading and writing of images as axis-aligned LPS volumes; only voxels and geometry are passed on, no patient data."""

from __future__ import annotations

import contextlib
import errno
import gzip
import os
import shutil
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from ..geometry.volume import AXES, TOWARDS, Volume
from ..image.intensities import from_zero
from .dicom import read_dicom
from .dicom_mark import is_dicom
from .grid import Grid, Note, Stored, check_grid
from .itk import quiet, sitk
from .metaimage import is_metaimage, metaimage_header, read_metaimage
from .nifti import is_nifti, nifti_header, read_nifti
from .nrrd import is_nrrd, nrrd_header, read_nrrd
from .pictures import steps_to
from .streams import opened

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
KNOWN = "NIfTI (.nii, .nii.gz), NRRD (.nrrd, .nhdr), MetaImage (.mha, .mhd) or a folder with one DICOM series"
UNKNOWN = f"this is not an image that can be read; give {KNOWN}, complete"
TILT_TOLERANCE = 1e-4  # direction cosines this close to the axes count as aligned: 0.05 mm over half a metre
HEAD = 1024  # bytes by which a format is known


def unheard(sentence: str) -> None:
    """Take a note that nobody asked for."""


def read_image(
    path: str | Path,
    *,
    note: Note = unheard,
    side: str | None = None,
    axes: str | None = None,
    name: str | None = None,
) -> Volume:
    """Read a scalar 3-D image in any orientation onto an axis-aligned LPS grid.

    Permuted and flipped axes are only re-ordered; an oblique image is resampled linearly at its own spacing.

    Parameters
    ----------
    path : str or Path
        A NIfTI, NRRD or MetaImage file, an enhanced DICOM file, or a folder with one DICOM series; the name decides nothing.
    note : callable, optional
        Takes sentences on what is assumed or left out; none of them names a file.
    side : str, optional
        "left" or "right": the breast whose slab is read where a series has one per breast.
    axes : str, optional
        Directions of the file's x, y and z in the patient, in place of what its header says.
    name : str, optional
        What errors call the image; by default the file's name.

    Returns
    -------
    Volume
        values (nz, ny, nx) float32, in the file's own unit after its rescale slope and intercept; if air lies below 0, all are
        shifted so that it lies at 0, and a note says so.

    Raises
    ------
    InputError
        If the file is missing, damaged, contradicts itself or is of another format, there is not exactly one DICOM series, it is
        unknown where the image lies, or the image is not 3-D, a single slice, not the size of a body part, or not all numbers.
    """
    with _named(Path(path), name):
        stored = _stored(Path(path), note, side, axes)
        return _volume(_axis_aligned(_itk(_intensities(stored.values, note), stored.grid), sitk.sitkLinear))


def read_thinned(
    path: str | Path, max_voxels: int, *, note: Note = unheard, side: str | None = None, axes: str | None = None
) -> Volume:
    """Read an image, and keep only every second, third, ... voxel if it has more than ``max_voxels``; a note says so.

    Raises
    ------
    InputError
        As :func:`read_image`.
    """
    with _named(Path(path), None):
        stored = _stored(Path(path), note, side, axes)
        kz, ky, kx = steps_to(stored.values.shape, stored.grid.spacing_mm, max_voxels)
        values = stored.values[::kz, ::ky, ::kx]
        if max(kx, ky, kz) > 1:
            all_of, kept = ("x".join(str(n) for n in which.shape[::-1]) for which in (stored.values, values))
            note(f"The image has {all_of} voxels; {kept} of them are used.")
        sx, sy, sz = stored.grid.spacing_mm
        grid = replace(stored.grid, spacing_mm=(sx * kx, sy * ky, sz * kz))
        return _volume(_axis_aligned(_itk(_intensities(values, note), grid), sitk.sitkLinear))


def read_grid(
    path: Path, *, note: Note = unheard, axes: str | None = None, name: str | None = None
) -> tuple[tuple[int, int, int], Grid] | None:
    """Return the numbers of voxels along x, y, z and where they lie, judged as :func:`read_image` does; no voxel is read.

    Returns
    -------
    tuple or None
        None for DICOM, whose header is spread over its frames.

    Raises
    ------
    InputError
        As :func:`read_image`, of what the header tells.
    """
    with _named(path, name):
        header, head = _head(path)
        readers = ((is_nrrd, nrrd_header), (is_nifti, nifti_header), (is_metaimage, metaimage_header))
        read = next((read for is_one, read in readers if is_one(head)), None)
        if read is None and is_dicom(head):
            return None
        if read is None:
            raise InputError(UNKNOWN)
        size, grid = read(header)
        grid = grid if axes is None else _turned(grid, axes)
        check_grid(grid, size[::-1], note)
        return size, grid


def open_image(
    path: str | Path,
    layers: bool = False,
    *,
    note: Note = unheard,
    axes: str | None = None,
    name: str | None = None,
) -> sitk.Image:
    """Read a 3-D image as the file stores it, with pairs of its header; with ``layers``, a voxel may have several values.

    Raises
    ------
    InputError
        As :func:`read_image`.
    """
    with _named(Path(path), name):
        stored = _stored(Path(path), note, None, axes, layers=layers)
        image = _itk(stored.values, stored.grid)
    for key, value in stored.fields.items():
        image.SetMetaData(key, value)
    return image


def labels_on(image: sitk.Image, values: np.ndarray) -> Volume:
    """Return labels (nz, ny, nx) of the voxels of an image on an axis-aligned LPS grid, by the nearest voxel, as uint8."""
    labels = sitk.GetImageFromArray(np.ascontiguousarray(values, np.uint8))
    labels.SetSpacing(image.GetSpacing())
    labels.SetOrigin(image.GetOrigin())
    labels.SetDirection(image.GetDirection())
    return _volume(_axis_aligned(labels, sitk.sitkNearestNeighbor))


def write_volume(path: str | Path, volume: Volume) -> None:
    """Write a volume as NIfTI, without text in its header; channels (n_channels, nz, ny, nx) become its fourth axis.

    Raises
    ------
    OSError
        If the file was not written whole, as on a full disk, which ITK does not report.
    """
    values = np.ascontiguousarray(volume.values)
    image = sitk.GetImageFromArray(values, isVector=False)
    pad = values.ndim - 3
    image.SetSpacing((*map(float, volume.spacing_mm), *(1.0,) * pad))
    image.SetOrigin((*map(float, volume.origin_mm), *(0.0,) * pad))
    with quiet():
        try:
            sitk.WriteImage(image, str(path), useCompression=True)
        except RuntimeError as error:
            raise _unwritten(path, values.nbytes) from error
    if Path(path).suffix == ".gz" and not _is_whole_gzip(Path(path)):
        raise _unwritten(path, values.nbytes)


def _is_whole_gzip(path: Path) -> bool:
    """Return whether a compressed file ends as it must, with the checksum of its content."""
    try:
        with gzip.open(path) as stream:
            while stream.read(1 << 20):
                pass
    except (OSError, EOFError, zlib.error):
        return False
    return True


def _unwritten(path: str | Path, size: int) -> OSError:
    code = errno.ENOSPC if shutil.disk_usage(Path(path).parent).free < size else errno.EIO
    return OSError(code, os.strerror(code), str(path))


@contextlib.contextmanager
def _named(path: Path, name: str | None) -> Iterator[None]:
    """Put the image's name before the sentence of an error, and keep the path out of it."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{name or path.name}: {str(error).replace(str(path), 'the file')}.") from None


def _stored(path: Path, note: Note, side: str | None, axes: str | None, *, layers: bool = False) -> Stored:
    """Read a file or folder by its content, and judge where its voxels lie."""
    try:
        is_there = path.exists()
    except (OSError, ValueError):  # a name too long, or with a NUL character
        is_there = False
    if not is_there:
        raise InputError(f"there is no such image; give {KNOWN}")
    stored = read_dicom(path, side, note) if path.is_dir() else _by_content(path, side, note, layers)
    grid = stored.grid if axes is None else _turned(stored.grid, axes)
    check_grid(grid, stored.values.shape[:3], note)
    return replace(stored, grid=grid)


def _head(path: Path) -> tuple[Path, bytes]:
    """Return the file that holds the header, and its first bytes."""
    header = path.with_suffix(".hdr")
    if path.suffix == ".img" and header.exists():  # the voxels of a pair, whose header tells what they are
        path = header
    with opened(path) as source:
        return path, source.some(HEAD)


def _by_content(path: Path, side: str | None, note: Note, layers: bool) -> Stored:
    path, head = _head(path)
    if is_nrrd(head):
        return read_nrrd(path, layers=layers)
    if is_nifti(head):
        return read_nifti(path)
    if is_metaimage(head):
        return read_metaimage(path)
    if is_dicom(head):
        return read_dicom(path, side, note)
    raise InputError(UNKNOWN)


def _intensities(values: np.ndarray, note: Note) -> np.ndarray:
    """Return voxels as float32, all of which must be finite, with air not below 0."""
    with np.errstate(over="ignore", invalid="ignore"):
        single = values.astype(np.float32, copy=False)
    bad = 0 if values.dtype.kind in "iu" else values.size - np.count_nonzero(np.isfinite(single))
    if bad:
        raise InputError(
            f"{bad} of {values.size} voxels are NaN or infinite as 32-bit floats; give an image whose voxels are all numbers"
        )
    return from_zero(single, note)


def _turned(grid: Grid, axes: str) -> Grid:
    """Return a grid whose axes have the directions that the user gives, turned about the zero point."""
    if axes not in AXES:
        raise InputError(
            f'the axes "{axes}" are not the directions of x, y and z, one each of L or R, A or P, S or I, without mirroring'
        )
    directions = np.zeros((3, 3))
    for column, letter in enumerate(axes):
        row, sign = TOWARDS[letter]
        directions[row, column] = sign
    if grid.origin_mm is None:
        return replace(grid, directions=directions)
    along = np.eye(3) if grid.directions is None else grid.directions
    ox, oy, oz = (directions @ along.T @ grid.origin_mm).tolist()
    return replace(grid, origin_mm=(ox, oy, oz), directions=directions)


def _itk(values: np.ndarray, grid: Grid) -> sitk.Image:
    """Return voxels (nz, ny, nx), or (nz, ny, nx, n_layers), as an image of ITK."""
    image = sitk.GetImageFromArray(np.ascontiguousarray(values), isVector=values.ndim > 3)
    image.SetSpacing(grid.spacing_mm)
    image.SetOrigin(grid.origin_mm or (0.0, 0.0, 0.0))
    image.SetDirection(np.asarray(grid.directions).ravel().tolist())
    return image


def _axis_aligned(image: sitk.Image, interpolator: int) -> sitk.Image:
    """Re-order the axes to LPS, then resample if the image is still tilted."""
    image = sitk.DICOMOrient(image, "LPS")
    if np.abs(np.subtract(image.GetDirection(), IDENTITY)).max() < TILT_TOLERANCE:
        image.SetDirection(IDENTITY)
        return image
    last = np.asarray(image.GetSize()) - 1
    corners = np.array(
        [image.TransformContinuousIndexToPhysicalPoint((last * c).tolist()) for c in np.ndindex(2, 2, 2)]
    )
    spacing = np.asarray(image.GetSpacing())
    size = np.ceil(np.ptp(corners, axis=0) / spacing - 1e-6).astype(int) + 1
    low = float(sitk.GetArrayViewFromImage(image).min())
    return sitk.Resample(
        image, size.tolist(), sitk.Transform(3, sitk.sitkIdentity), interpolator, corners.min(axis=0).tolist(),
        image.GetSpacing(), IDENTITY, low,
    )  # fmt: skip


def _volume(image: sitk.Image) -> Volume:
    """Convert an ITK image to a volume of its voxels and geometry."""
    sx, sy, sz = image.GetSpacing()
    ox, oy, oz = image.GetOrigin()
    return Volume(sitk.GetArrayFromImage(image), (sx, sy, sz), (ox, oy, oz))
