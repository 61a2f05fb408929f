"""Reading and writing of images as axis-aligned LPS volumes; only voxels and geometry are passed on, no patient data."""

from __future__ import annotations

import contextlib
import errno
import gzip
import os
import shutil
import sys
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.deferred import Deferred
from ..core.errors import InputError
from ..geometry.labels import Label
from ..geometry.volume import Volume
from .dicom import series_files
from .nifti import check_nifti
from .pictures import steps_to

if TYPE_CHECKING:
    import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
else:
    sitk = Deferred("SimpleITK")  # most runs read no image

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
KNOWN = "NIfTI (.nii, .nii.gz), NRRD (.nrrd, .nhdr), MetaImage (.mha, .mhd) or a folder with one DICOM series"
TILT_TOLERANCE = 1e-4  # direction cosines this close to the axes count as aligned: 0.05 mm over half a metre


def read_image(path: str | Path) -> Volume:
    """Read a scalar 3-D image in any orientation onto an axis-aligned LPS grid.

    Permuted and flipped axes are only re-ordered; an oblique image is resampled linearly at its own spacing.

    Parameters
    ----------
    path : str or Path
        A NIfTI, NRRD or MetaImage file, or a folder with one DICOM series.

    Returns
    -------
    Volume
        values (nz, ny, nx) float32, in the file's own unit after its rescale slope and intercept.

    Raises
    ------
    InputError
        If the file is missing, truncated or of another format, there is not exactly one DICOM series, or the image is not 3-D, a
        single slice, or has NaN or infinite voxels.
    """
    image = _checked(_read(Path(path)), Path(path).name)
    image = _axis_aligned(sitk.Cast(image, sitk.sitkFloat32), sitk.sitkLinear)
    return _volume(image)


def read_thinned(path: str | Path, max_voxels: int) -> tuple[Volume, str]:
    """Read an image, and keep only every second, third, ... voxel if it has more than ``max_voxels``.

    Returns
    -------
    Volume, str
        The image as :func:`read_image` returns it, and a sentence on the voxels left out; empty if none are.

    Raises
    ------
    InputError
        As :func:`read_image`.
    """
    image = _checked(_read(Path(path)), Path(path).name)
    nx, ny, nz = image.GetSize()
    sx, sy, sz = image.GetSpacing()
    kz, ky, kx = steps_to((nz, ny, nx), (sx, sy, sz), max_voxels)
    image = image[::kx, ::ky, ::kz]
    kept = "x".join(str(n) for n in image.GetSize())
    words = f"The image has {nx}x{ny}x{nz} voxels; {kept} of them are used."
    thin = _axis_aligned(sitk.Cast(image, sitk.sitkFloat32), sitk.sitkLinear)
    return _volume(thin), words if max(kx, ky, kz) > 1 else ""


def read_labels(path: str | Path) -> Volume:
    """Read a label map (0 air, 1 fat, 2 gland, 3 skin, 4 tumour, 5 chest) onto an axis-aligned LPS grid.

    Returns
    -------
    Volume
        values (nz, ny, nx) uint8; oblique maps are resampled by the nearest voxel.

    Raises
    ------
    InputError
        As :func:`read_image`, or if there are labels other than whole numbers 0 to 5, or no voxel of the breast (1 to 4).
    """
    name = Path(path).name
    image = _checked(_read(Path(path)), name)
    values = sitk.GetArrayViewFromImage(image)
    strange = sorted({float(v) for v in np.unique(values)} - {float(label) for label in Label})
    if strange:
        shown = ", ".join(f"{v:g}" for v in strange[:3])
        raise InputError(
            f"{name}: a label map has only 0 air, 1 fat, 2 gland, 3 skin, 4 tumour and 5 chest; this one also has {shown}."
        )
    if not ((values > Label.AIR) & (values < Label.CHEST)).any():
        raise InputError(f"{name}: the label map has no voxel of the breast (1 fat, 2 gland, 3 skin, 4 tumour).")
    return _volume(_axis_aligned(sitk.Cast(image, sitk.sitkUInt8), sitk.sitkNearestNeighbor))


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
    with _quiet():
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


def _read(path: Path) -> sitk.Image:
    """Read a file or folder with ITK, and replace its errors by an InputError."""
    if not path.exists():
        raise InputError(f"{path.name}: there is no such image; give {KNOWN}.")
    if path.is_dir():
        return _read_series(path)
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(path))
    with _quiet():
        try:
            reader.ReadImageInformation()
        except RuntimeError as error:
            raise InputError(_unreadable(path.name, str(error))) from None
        _check_form(reader.GetDimension(), reader.GetSize(), reader.GetNumberOfComponents(), path.name)
        if path.name.endswith((".nii", ".nii.gz")):
            check_nifti(path)
        try:
            return reader.Execute()
        except RuntimeError:
            raise InputError(f"{path.name}: the file is cut short or damaged; copy it again from its source.") from None


def _unreadable(name: str, reason: str) -> str:
    """Return the error for a header that ITK cannot use."""
    if "orthonormal" in reason:
        return f"{name}: the header's axes are sheared (not orthonormal); resample the image onto a rectangular grid."
    return f"{name}: this is not an image that can be read; give {KNOWN}, complete and under its right name."


def _check_form(dimension: int, size: tuple[int, ...], n_components: int, name: str) -> None:
    """Refuse an image that is not a scalar volume, before its voxels are read."""
    while dimension > 3 and size[dimension - 1] == 1:
        dimension -= 1
    if dimension > 3:
        raise InputError(
            f"{name}: the image has {dimension} dimensions; give one 3-D volume, for example a single time point."
        )
    if n_components != 1:
        raise InputError(f"{name}: each voxel has {n_components} values; give an image with one intensity per voxel.")
    if dimension < 3 or min(size[:3]) < 2:
        shown = " x ".join(str(n) for n in size[:dimension])
        raise InputError(
            f"{name}: the image is a single slice ({shown} voxels); a volume of two or more slices is needed."
        )


def _read_series(folder: Path) -> sitk.Image:
    """Read the one DICOM series of a folder."""
    files = series_files(folder)
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames([str(f) for f in files])
    with _quiet():
        try:
            image = reader.Execute()
        except RuntimeError:
            raise InputError(
                f"{folder.name}: a slice of the DICOM series is cut short, damaged or of another size; export it again."
            ) from None
    _check_form(image.GetDimension(), image.GetSize(), image.GetNumberOfComponentsPerPixel(), folder.name)
    return image


def _checked(image: sitk.Image, name: str) -> sitk.Image:
    """Drop trailing axes of length 1, and refuse voxels that are NaN or infinite."""
    while image.GetDimension() > 3:
        image = image[..., 0]
    values = sitk.GetArrayViewFromImage(image)
    bad = values.size - np.count_nonzero(np.isfinite(values)) if values.dtype.kind == "f" else 0
    if bad:
        raise InputError(
            f"{name}: {bad} of {values.size} voxels are NaN or infinite; give an image whose voxels are all numbers."
        )
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
    """Convert an ITK image to a volume of its voxels and geometry; all other header data are dropped."""
    sx, sy, sz = image.GetSpacing()
    ox, oy, oz = image.GetOrigin()
    return Volume(sitk.GetArrayFromImage(image), (sx, sy, sz), (ox, oy, oz))


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress output that the C++ libraries print to file descriptors 1 and 2."""
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    sys.stdout.flush()
    sys.stderr.flush()
    kept = [os.dup(1), os.dup(2)]
    with tempfile.TemporaryFile() as sink:
        try:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
            yield
        finally:
            for descriptor, copy in enumerate(kept, start=1):
                os.dup2(copy, descriptor)
                os.close(copy)
            sitk.ProcessObject.SetGlobalWarningDisplay(shown)
