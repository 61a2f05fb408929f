"""Which files of a folder form its DICOM series, in which order; headers are looked at here and never handed on."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pydicom
from pydicom.errors import InvalidDicomError

from ..core.errors import InputError

TAGS = [
    "SeriesInstanceUID",
    "ImagePositionPatient",
    "ImageOrientationPatient",
    "NumberOfFrames",
    "PixelSpacing",
    "Rows",
]
GAP_TOLERANCE = 0.02  # gaps between slices may differ by this part of their median


@dataclass(frozen=True)
class Slice:
    """A file of a series and where it lies along the series' normal [mm]."""

    path: Path
    position_mm: float


def series_files(folder: Path) -> list[Path]:
    """Files of the one DICOM series in ``folder`` (not its sub-folders), in the order of their positions.

    Raises
    ------
    InputError
        No DICOM file, more than one series, slices without a position, twice at one place, or missing.
    """
    series: dict[str, list[tuple[Path, pydicom.Dataset]]] = {}
    for path in sorted(p for p in folder.iterdir() if p.is_file()):
        header = _header(path)
        if header is not None and "Rows" in header:
            series.setdefault(str(header.get("SeriesInstanceUID", "")), []).append((path, header))
    if not series:
        raise InputError(f"{folder.name}: the folder holds no DICOM image; give the one whose files are the slices.")
    if len(series) > 1:
        counts = ", ".join(str(len(s)) for s in series.values())
        raise InputError(
            f"{folder.name}: the folder holds {len(series)} DICOM series ({counts} files); keep one series per folder."
        )
    return _ordered(next(iter(series.values())), folder.name)


def _header(path: Path) -> pydicom.Dataset | None:
    """Read the few tags needed, or None if the file is not DICOM."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return pydicom.dcmread(path, stop_before_pixels=True, specific_tags=TAGS)
    except (InvalidDicomError, OSError, EOFError, ValueError, AttributeError, KeyError):
        return None


def _ordered(files: list[tuple[Path, pydicom.Dataset]], name: str) -> list[Path]:
    """Sort slices along the normal and check that they are evenly spaced."""
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
        raise InputError(f"{name}: two DICOM slices lie at the same place; keep one time point or echo in the folder.")
    if np.ptp(gaps) > GAP_TOLERANCE * np.median(gaps):
        raise InputError(
            f"{name}: the gaps between DICOM slices run from {gaps.min():.2f} to {gaps.max():.2f} mm; "
            "slices are missing, export the whole series."
        )
    return [s.path for s in slices]


def _slice(path: Path, header: pydicom.Dataset) -> Slice:
    """Position along the normal of the slice."""
    row, column = np.asarray(header.ImageOrientationPatient, float).reshape(2, 3)
    position = float(np.cross(row, column) @ np.asarray(header.ImagePositionPatient, float))
    return Slice(path, position)
