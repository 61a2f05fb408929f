"""Reading of DICOM segmentations: segments by name, frames by their own positions.

Source: DICOM PS3.3, A.51 and C.8.20 (Segmentation), C.7.6.16 (Multi-frame Functional Groups).
"""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.deferred import Deferred
from ..core.errors import InputError
from .segments import Segment
from .stack import APART, APART_MM

if TYPE_CHECKING:
    import pydicom
    import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
else:
    pydicom, sitk = Deferred("pydicom"), Deferred("SimpleITK")  # most runs read no DICOM

STORAGE = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")  # Segmentation, Label Map Segmentation
MOST_VOXELS = 500_000_000
ORTHONORMAL = 1e-3


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of one stack.

    Parameters
    ----------
    slices : (n_frames,) int array
        Place of each frame in the stack, from 0.
    numbers : (n_frames,) int array or None
        Segment that each frame shows; None in a label map, whose pixels are the numbers of segments.
    grid : sitk.Image
        Geometry of the stack, including slices without a frame.
    """

    slices: np.ndarray
    numbers: np.ndarray | None
    grid: sitk.Image


def segmentation_in(path: Path, name: str) -> Path | None:
    """Return the DICOM segmentation that a path names, itself or as the only one in a folder; None if there is none.

    Raises
    ------
    InputError
        If a folder has several.
    """
    if not path.is_dir():
        return path if path.is_file() and _is_segmentation(path) else None
    found = [file for file in sorted(path.iterdir()) if file.is_file() and _is_segmentation(file)]
    if len(found) > 1:
        raise InputError(f"{name}: the folder has {len(found)} DICOM segmentations; name the file of one.")
    return found[0] if found else None


def read_frames(path: Path, file: str) -> tuple[list[Segment], sitk.Image]:
    """Read the segments of a DICOM segmentation, with an image that has their geometry.

    Raises
    ------
    InputError
        If a part that the standard demands is missing or contradicts another, or the pixels cannot be read.
    """
    with _damage(file):
        data = pydicom.dcmread(path)
        described = _described(data, file)
        frames = _placed(data, file)
        return list(_segments(data, described, frames, _pixels(data, file), file)), frames.grid


@contextlib.contextmanager
def _damage(file: str) -> Iterator[None]:
    """Replace what pydicom raises at missing and damaged data by one sentence, and silence what it warns of."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except (AttributeError, KeyError) as error:
        raise InputError(f"{file}: the DICOM segmentation is not complete ({_lack(error)}); export it again.") from None
    except Exception:  # damaged bytes make pydicom raise nearly anything, among it struct.error and classes of its own
        raise InputError(f"{file}: the DICOM segmentation is cut short or damaged; export it again.") from None


def _is_segmentation(path: Path) -> bool:
    """Check by content whether a file is a DICOM segmentation; what is wrong with another one, the reader of images says."""
    with contextlib.suppress(InputError, OSError), path.open("rb") as stream:
        if stream.read(132)[128:] == b"DICM":
            with _damage(path.name):
                header = pydicom.dcmread(path, stop_before_pixels=True, specific_tags=["SOPClassUID"])
                return header.get("SOPClassUID") in STORAGE
    return False


def _lack(error: Exception) -> str:
    """Return what a file lacks, by the keyword of DICOM in the message."""
    words = [word for word in re.findall(r"\b[A-Z]\w+", str(error)) if not word.endswith("Dataset")]
    return f"{words[0]} is missing" if words else "a value is missing"


def _described(data: pydicom.Dataset, file: str) -> dict[int, tuple[str, str]]:
    """Return name and coded type of each segment, by number."""
    described: dict[int, tuple[str, str]] = {}
    for item in data.SegmentSequence:
        number, codes = int(item.SegmentNumber), item.get("SegmentedPropertyTypeCodeSequence") or []
        if number in described:
            raise InputError(f"{file}: two segments have the number {number}; export the segmentation again.")
        described[number] = str(item.SegmentLabel), str(codes[0].get("CodeMeaning", "")) if codes else ""
    return described


def _placed(data: pydicom.Dataset, file: str) -> Frames:
    """Return the places of the frames, by their positions; slices without a frame are empty."""
    groups = [_Groups(data, frame) for frame in data.PerFrameFunctionalGroupsSequence]
    n = int(data.NumberOfFrames)
    if len(groups) != n:
        raise InputError(f"{file}: the header says {n} frames and describes {len(groups)}; export it again.")
    orientations = np.array([g("PlaneOrientationSequence").ImageOrientationPatient for g in groups], float)
    positions = np.array([g("PlanePositionSequence").ImagePositionPatient for g in groups], float)
    edges = np.array([g("PixelMeasuresSequence").PixelSpacing for g in groups], float)
    axes = _axes(orientations, edges, positions, file)
    step = _step(data, groups[0], positions @ axes[2], file)
    place = (positions - positions[np.argmin(positions @ axes[2])]) @ axes.T
    slices = np.rint(place[:, 2] / step).astype(int)
    if (np.abs(place - slices[:, None] * [0, 0, step]).max(axis=1) > max(APART_MM, APART * step)).any():
        raise InputError(f"{file}: the frames do not lie at multiples of {step:.3g} mm along one line; resample it.")
    numbers = _numbers(data, groups)
    shown = np.stack([slices, np.zeros_like(slices) if numbers is None else numbers])
    if np.unique(shown, axis=1).shape[1] < n:
        raise InputError(f"{file}: two frames show the same segment at the same place; export the segmentation again.")
    size = (int(data.Columns), int(data.Rows), int(slices.max()) + 1)
    _check_size(size, n, file)
    return Frames(slices, numbers, _grid(size, (edges[0, 1], edges[0, 0], step), axes, positions[np.argmin(slices)]))


def _numbers(data: pydicom.Dataset, groups: list[_Groups]) -> np.ndarray | None:
    """Return the segment that each frame shows; None in a label map."""
    if data.SegmentationType == "LABELMAP":
        return None
    return np.array([int(g("SegmentIdentificationSequence").ReferencedSegmentNumber) for g in groups])


class _Groups:
    """Functional groups of one frame: its own, or else those that all frames share."""

    def __init__(self, data: pydicom.Dataset, frame: pydicom.Dataset) -> None:
        shared = data.get("SharedFunctionalGroupsSequence") or []
        self.tables = [frame, *shared]

    def __call__(self, name: str) -> Any:
        """Return the one item of a group.

        Raises
        ------
        KeyError
            If neither the frame nor the file has it.
        """
        for table in self.tables:
            if table.get(name):
                return table[name][0]
        raise KeyError(f"{name} is missing")


def _axes(orientations: np.ndarray, edges: np.ndarray, positions: np.ndarray, file: str) -> np.ndarray:
    """Return the directions (3, 3) of a row, a column and the stack, after a check that all frames share one geometry."""
    if not (np.isfinite(positions).all() and np.isfinite(edges).all() and (edges > 0).all()):
        raise InputError(
            f"{file}: a frame has a position or a pixel spacing that is not a number above 0; export it again."
        )
    row, column = orientations[0, :3], orientations[0, 3:]
    axes = np.array([row, column, np.cross(row, column)])
    if not np.isfinite(axes).all() or np.abs(axes @ axes.T - np.eye(3)).max() > ORTHONORMAL:
        raise InputError(
            f"{file}: the directions of rows and columns are not at right angles; export the segmentation again."
        )
    if np.abs(orientations - orientations[0]).max() > ORTHONORMAL or np.ptp(edges, axis=0).max() > ORTHONORMAL:
        raise InputError(
            f"{file}: frames differ in orientation or pixel spacing; export each stack as a file of its own."
        )
    return axes


def _step(data: pydicom.Dataset, first: _Groups, heights: np.ndarray, file: str) -> float:
    """Return the distance of slices [mm]: as the file says, or else the smallest between frames, or else their thickness."""
    gaps = np.diff(np.unique(np.round(heights, 3)))
    gaps = gaps[gaps > APART_MM]
    measures = first("PixelMeasuresSequence")
    told = measures.get("SpacingBetweenSlices")
    step = float(told or (gaps.min() if len(gaps) else measures.SliceThickness))
    if not 0.01 <= step <= 50.0:
        raise InputError(f"{file}: slices are {step:g} mm apart; a distance of 0.01 to 50 mm is expected.")
    return step


def _check_size(size: tuple[int, int, int], n_frames: int, file: str) -> None:
    """Refuse a stack of a single slice, or one that does not fit into memory."""
    shown = " x ".join(str(n) for n in size)
    if min(size) < 2:
        raise InputError(f"{file}: the segmentation is a single slice ({shown} voxels); two or more slices are needed.")
    if max(float(size[2]), float(n_frames) / 4) * size[0] * size[1] > MOST_VOXELS:
        raise InputError(f"{file}: {n_frames} frames span {shown} voxels; at most {MOST_VOXELS:,} can be read.")


def _grid(
    size: tuple[int, int, int], spacing: tuple[float, float, float], axes: np.ndarray, origin: np.ndarray
) -> sitk.Image:
    """Return an empty image with a geometry; ``axes`` (3, 3) are the directions of x, y and z, LPS."""
    image = sitk.Image(size, sitk.sitkUInt8)
    image.SetSpacing([float(s) for s in spacing])
    image.SetDirection(axes.T.ravel().tolist())
    image.SetOrigin(origin.tolist())
    return image


def _pixels(data: pydicom.Dataset, file: str) -> np.ndarray:
    """Return the pixels (n_frames, rows, columns) as they are stored."""
    n, rows, columns, bits = (int(data[key].value) for key in ("NumberOfFrames", "Rows", "Columns", "BitsAllocated"))
    syntax = data.file_meta.TransferSyntaxUID
    needed = (n * rows * columns * bits + 7) // 8
    if not syntax.is_compressed and not needed <= len(data.PixelData) <= needed + 1:
        raise InputError(
            f"{file}: the pixels have {len(data.PixelData)} bytes for {needed}; the file is cut short or damaged."
        )
    try:
        return pydicom.pixels.pixel_array(data, raw=True).reshape(n, rows, columns)
    except (RuntimeError, NotImplementedError, ValueError, AttributeError):
        raise InputError(
            f"{file}: the pixels cannot be unpacked ({syntax.name}); export them without compression."
        ) from None


def _segments(
    data: pydicom.Dataset, described: dict[int, tuple[str, str]], frames: Frames, pixels: np.ndarray, file: str
) -> Iterator[Segment]:
    """Return the segments on the whole stack."""
    shape = frames.grid.GetSize()[::-1]
    used = np.unique(pixels if frames.numbers is None else frames.numbers)
    nameless = set(used.tolist()) - set(described) - {0, int(data.get("PixelPaddingValue", 0))}
    if nameless:
        raise InputError(f"{file}: no segment has the number {min(nameless)}, which the frames show; export it again.")
    largest = float(data.MaximumFractionalValue) if data.SegmentationType == "FRACTIONAL" else 1.0
    for number, (name, code) in described.items():
        share = np.zeros(shape, bool if largest == 1.0 else np.float32)
        if frames.numbers is None:
            share[frames.slices] = pixels == number
        else:
            mine = frames.numbers == number
            share[frames.slices[mine]] = pixels[mine] / largest
        yield Segment(name, code, share)
