"""Find and sort the files of a DICOM series; their headers, which may identify a patient, are not passed on."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.deferred import Deferred
from ..core.errors import InputError

if TYPE_CHECKING:
    import pydicom
else:
    pydicom = Deferred("pydicom")  # most runs read no DICOM

TAGS = [
    "SeriesInstanceUID",
    "ImagePositionPatient",
    "ImageOrientationPatient",
    "NumberOfFrames",
    "PixelSpacing",
    "Rows",
]
GAP_TOLERANCE = 0.02  # largest difference between gaps of slices, relative to their median


@dataclass(frozen=True)
class Slice:
    """A file of a series, and the position of its slice along the normal [mm]."""

    path: Path
    position_mm: float


def series_files(folder: Path) -> list[Path]:
    """Return the files of the one DICOM series in ``folder`` (not its sub-folders), in the order of their positions.

    Raises
    ------
    InputError
        If there is no DICOM file or more than one series, or slices have no position, share a position or are missing.
    """
    series: dict[str, list[tuple[Path, pydicom.Dataset]]] = {}
    for path in sorted(p for p in folder.iterdir() if p.is_file()):
        header = _header(path)
        if header is not None and "Rows" in header:
            series.setdefault(str(header.get("SeriesInstanceUID", "")), []).append((path, header))
    if not series:
        raise InputError(f"{folder.name}: the folder has no DICOM image; give the one whose files are the slices.")
    if len(series) > 1:
        counts = ", ".join(str(len(s)) for s in series.values())
        raise InputError(
            f"{folder.name}: the folder has {len(series)} DICOM series ({counts} files); keep one series per folder."
        )
    return _ordered(next(iter(series.values())), folder.name)


def _header(path: Path) -> pydicom.Dataset | None:
    """Read the header tags that are needed; return None if the file is not DICOM."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return pydicom.dcmread(path, stop_before_pixels=True, specific_tags=TAGS)
    except (pydicom.errors.InvalidDicomError, OSError, EOFError, ValueError, AttributeError, KeyError):
        return None


def _ordered(files: list[tuple[Path, pydicom.Dataset]], name: str) -> list[Path]:
    """Sort slices along their normal; raise an error that names the folder (``name``) if they are not evenly spaced."""
    try:
        slices = sorted((_slice(path, header) for path, header in files), key=lambda s: s.position_mm)
    except (AttributeError, TypeError, ValueError):
        raise InputError(
            f"{name}: a DICOM slice has no readable position or orientation; export the series again."
        ) from None
    if len(slices) < 2:
        raise InputError(
            f"{name}: the DICOM series is a single file; a series of two or more slices, one per file, is needed."
        )
    gaps = np.diff([s.position_mm for s in slices])
    if gaps.min() < 1e-3:
        raise InputError(f"{name}: two DICOM slices have the same position; keep one time point or echo in the folder.")
    if np.ptp(gaps) > GAP_TOLERANCE * np.median(gaps):
        raise InputError(
            f"{name}: the gaps between DICOM slices range from {gaps.min():.2f} to {gaps.max():.2f} mm; "
            "slices are missing, export the whole series."
        )
    return [s.path for s in slices]


def _slice(path: Path, header: pydicom.Dataset) -> Slice:
    """Compute the position of a slice along its normal."""
    row, column = np.asarray(header.ImageOrientationPatient, float).reshape(2, 3)
    position = float(np.cross(row, column) @ np.asarray(header.ImagePositionPatient, float))
    return Slice(path, position)
