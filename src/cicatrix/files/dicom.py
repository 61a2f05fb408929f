"""Planes of DICOM images, classic and enhanced; of their headers, which may identify a patient, only geometry is passed on."""

from __future__ import annotations

import codecs
import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.deferred import Deferred
from ..core.errors import InputError
from .dicom_mark import is_dicom
from .dicom_pixels import PixelFile, dataset_of, pixel_form, understood
from .grid import Note, Stored, scaled
from .stack import Frame, stacked

if TYPE_CHECKING:
    import pydicom
else:
    pydicom = Deferred("pydicom")  # most runs read no DICOM

STANDARD = "1.2.840.10008."  # how classes of the standard begin
HEAD = 4096  # bytes by which a file is known to be DICOM, or text


def read_dicom(path: Path, side: str | None, note: Note) -> Stored:
    """Read a series: the files of a folder (not of its sub-folders), or one file with several frames.

    Parameters
    ----------
    path : Path
        The folder or file.
    side : str, optional
        "left" or "right": the breast whose slab is taken where there are two.
    note : callable
        Takes sentences on files and slices that are left out.

    Raises
    ------
    InputError
        If there is no series or more than one, a file cannot be read, or the slices make no volume.
    """
    headers = _one_series(_headers(path, note) if path.is_dir() else [(path, dataset_of(path, pixels=False))])
    frames = []
    for number, (file, header) in enumerate(headers, start=1):
        with _placed(number, len(headers)):
            frames += [
                replace(f, values=partial(_in_place, f.values, number, len(headers))) for f in _frames(file, header)
            ]
    return stacked(frames, side, note)


@contextlib.contextmanager
def _placed(number: int, n: int) -> Iterator[None]:
    """Say in an error which file it is about; its name may be that of a patient."""
    try:
        with understood():
            yield
    except InputError as error:
        place = f" (file {number} of {n} in the order of their names)" if n > 1 else ""
        raise InputError(f"{error}{place}") from None


def _in_place(values: Callable[[], np.ndarray], number: int, n: int) -> np.ndarray:
    with _placed(number, n):
        return values()


def _headers(folder: Path, note: Note) -> list[tuple[Path, pydicom.Dataset]]:
    """Return the files of a folder that are DICOM images, with their headers; none may be damaged."""
    found, others, damaged = [], [], []
    for path in sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith(".")):
        with path.open("rb") as file:
            head = file.read(HEAD)
        if not is_dicom(head):
            others.append((path, head))
            continue
        try:
            header = dataset_of(path, pixels=False)
            if "Rows" in header:
                found.append((path, header))
            else:
                (others if _is_no_image(header) else damaged).append((path, head))
        except InputError:
            damaged.append((path, head))
    endings = {_ending(path) for path, _ in found}
    damaged += [
        (path, head)
        for path, head in others
        if found and not is_dicom(head) and _ending(path) in endings and not _is_text(head)
    ]
    if damaged:
        n = len(found) + len(damaged)
        names = sorted(path for path, _ in damaged)
        number = sorted([*(path for path, _ in found), *names]).index(names[0]) + 1
        raise InputError(
            f"{len(damaged)} of {n} files cannot be read as DICOM (the first is number {number} in the order of their names); "
            "export the series again"
        )
    if not found:
        raise InputError("the folder has no DICOM image; give the one whose files are the slices")
    if others:
        note(f"Left out: {len(others)} of the files in the folder, no DICOM images.")
    return found


def _is_no_image(header: pydicom.Dataset) -> bool:
    """Return whether the class of a DICOM file is that of no image: a directory, a report, or a maker's own, given twice."""
    uid = pydicom.uid.UID(str(getattr(getattr(header, "file_meta", None), "MediaStorageSOPClassUID", "")))
    if uid.name == uid:
        return uid.is_valid and not uid.startswith(STANDARD) and _element(header, "SOPClassUID") == uid
    return "Image Storage" not in uid.name


def _ending(path: Path) -> str:
    """Return the ending of a file's name; one that is a number, as of a UID, is none."""
    ending = path.suffix.lower()
    return "" if ending[1:].isdigit() else ending


def _is_text(head: bytes) -> bool:
    """Return whether a file begins as text; an empty one does not."""
    try:
        text = codecs.getincrementaldecoder("utf-8")().decode(head, final=len(head) < HEAD)
    except UnicodeDecodeError:
        return False
    return text != "" and all(letter.isprintable() or letter.isspace() or letter == "\ufeff" for letter in text)


def _one_series(headers: list[tuple[Path, pydicom.Dataset]]) -> list[tuple[Path, pydicom.Dataset]]:
    counts: dict[str, int] = {}
    for _, header in headers:
        series = str(_element(header, "SeriesInstanceUID") or "")
        counts[series] = counts.get(series, 0) + 1
    if len(counts) > 1:
        shown = ", ".join(str(n) for n in counts.values())
        raise InputError(f"the folder has {len(counts)} DICOM series ({shown} files); keep one series per folder")
    return headers


def _element(dataset: pydicom.Dataset, name: str):
    """Return the value of an element; None if there is none, or it is not as its type says."""
    try:
        return dataset.get(name)
    except Exception:  # a damaged value raises in the library what it likes
        return None


def _numbers(dataset: pydicom.Dataset | None, name: str, n: int) -> np.ndarray:
    """Return the numbers (n,) of an element."""
    value = None if dataset is None else _element(dataset, name)
    try:
        numbers = np.array([float(x) for x in (value if n > 1 else [value])])  # pyright: ignore[reportOptionalIterable]
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if len(numbers) != n or not np.isfinite(numbers).all():
        words = "missing" if value in (None, "") else "not as the standard says"
        raise InputError(
            f"{name} is {words}: {n} finite {'number is' if n == 1 else 'numbers are'} needed; export it again"
        )
    return numbers


def _frames(path: Path, header: pydicom.Dataset) -> Iterator[Frame]:
    """Yield the planes of a file."""
    form = pixel_form(header)
    n_frames = int(_numbers(header, "NumberOfFrames", 1)[0]) if _element(header, "NumberOfFrames") else 1
    if n_frames < 1:
        raise InputError(f"the DICOM header says {n_frames} frames (NumberOfFrames); it must be 1 or more")
    pixels = PixelFile(path, n_frames)
    per_frame = _element(header, "PerFrameFunctionalGroupsSequence")
    if per_frame is None:
        if n_frames > 1:
            raise InputError(
                f"the {n_frames} frames of the file have no place of their own (no functional groups); "
                "export them as a series or as enhanced DICOM"
            )
        yield _frame(header, header, header, header, pixels, 0, form, header)
        return
    if len(per_frame) != n_frames:
        raise InputError(f"the header says {n_frames} frames, but places {len(per_frame)}; export the file again")
    shared = _element(header, "SharedFunctionalGroupsSequence")
    for number, groups in enumerate(per_frame):
        position, orientation, measures, transform = (
            _group(name, groups, shared[0] if shared else None)
            for name in (
                "PlanePositionSequence", "PlaneOrientationSequence", "PixelMeasuresSequence", "PixelValueTransformationSequence"
            )
        )  # fmt: skip
        yield _frame(position, orientation, measures, transform, pixels, number, form, header)


def _group(name: str, own: pydicom.Dataset, shared: pydicom.Dataset | None) -> pydicom.Dataset | None:
    """Return a functional group of a frame: its own, or the one shared by all (PS3.3 C.7.6.16)."""
    for groups in (own, shared):
        sequence = None if groups is None else _element(groups, name)
        if sequence:
            return sequence[0]
    return None


def _frame(position, orientation, measures, transform, pixels: PixelFile, number: int, form: str, header) -> Frame:
    """Return a plane from the parts of a header that say where it lies and how its values are scaled."""
    row, column = _numbers(orientation, "ImageOrientationPatient", 6).reshape(2, 3)
    gap_of_rows, gap_of_columns = _numbers(measures, "PixelSpacing", 2).tolist()
    if not (gap_of_rows > 0 and gap_of_columns > 0):
        raise InputError(
            f"PixelSpacing is {gap_of_rows:g}, {gap_of_columns:g} mm; both must be positive, export it again"
        )
    return Frame(
        _numbers(position, "ImagePositionPatient", 3),
        np.column_stack([row, column, np.cross(row, column)]),
        (gap_of_columns, gap_of_rows),
        (int(header.Rows), int(header.Columns)),
        form,
        partial(_values, pixels, number, *_scale(transform), _element(header, "ModalityLUTSequence") and header),
    )


def _scale(transform: pydicom.Dataset | None) -> tuple[float, float]:
    """Return slope and intercept of a plane; 1 and 0 where the header has none."""
    parts = []
    for name, default in (("RescaleSlope", 1.0), ("RescaleIntercept", 0.0)):
        absent = transform is None or (name in transform and transform[name].VM == 0) or name not in transform
        parts.append(default if absent else float(_numbers(transform, name, 1)[0]))
    if parts[0] == 0:
        raise InputError("RescaleSlope is 0, which leaves no image; export it again")
    return parts[0], parts[1]


def _values(
    pixels: PixelFile, number: int, slope: float, intercept: float, table: pydicom.Dataset | None
) -> np.ndarray:
    """Return the values of a plane, after its modality table or its slope and intercept."""
    stored = pixels.frame(number)
    return pydicom.pixels.apply_modality_lut(stored, table) if table else scaled(stored, slope, intercept)
