"""Stored values of the pixels of a DICOM file, decoded as the standard says (PS3.3 C.7.6.3, PS3.5 8.1)."""

from __future__ import annotations

import contextlib
import tempfile
import warnings
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.deferred import Deferred
from ..core.errors import InputError
from .itk import quiet, sitk
from .opening import regular_file

if TYPE_CHECKING:
    import pydicom
else:
    pydicom = Deferred("pydicom")  # most runs read no DICOM

DEFLATED = "1.2.840.10008.1.2.1.99"
LARGEST = 1 << 29  # bytes into which a deflated file may unpack
MODULE = ("SamplesPerPixel", "PhotometricInterpretation", "Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit")
MODULE_SIGNED = (*MODULE, "PixelRepresentation")
MR_IMAGE = "1.2.840.10008.5.1.4.1.1.4"
UNREADABLE = "the DICOM file is cut short or damaged, or not as the standard says; export it again"


def dataset_of(path: Path, *, pixels: bool) -> pydicom.Dataset:
    """Read a file, with its pixels or up to them.

    Raises
    ------
    InputError
        If it is no regular file, or cannot be read.
    """
    regular_file(path)
    with understood(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _check_deflated(path)
        return pydicom.dcmread(path, stop_before_pixels=not pixels, force=True)


@contextlib.contextmanager
def understood() -> Iterator[None]:
    """Replace whatever the library raises at a damaged file, which is of no one kind, by a sentence."""
    try:
        yield
    except InputError:
        raise
    except Exception:
        raise InputError(UNREADABLE) from None


def pixel_form(header: pydicom.Dataset) -> str:
    """Return how pixels are stored, in words that are equal for equal forms.

    Raises
    ------
    InputError
        If they are not scalars of 8, 16 or 32 bits, brighter where the value is larger, or the header contradicts itself.
    """
    missing = [name for name in MODULE_SIGNED if header.get(name) in (None, "")]
    if missing:
        raise InputError(f"the DICOM header has no {missing[0]}; export it again")
    samples, photometric, _, _, allocated, stored, high, sign = (header.get(name) for name in MODULE_SIGNED)
    if samples != 1:
        raise InputError(f"each voxel has {samples} values; give an image with one intensity per voxel")
    if photometric != "MONOCHROME2":
        raise InputError(f"the pixels are {photometric}, where dark may be a large value; export them as MONOCHROME2")
    if allocated not in (8, 16, 32):
        raise InputError(f"the pixels have {allocated} bits (BitsAllocated); an image has 8, 16 or 32")
    if not 1 <= stored <= allocated or high != stored - 1 or sign not in (0, 1):
        raise InputError(
            f"the DICOM header contradicts itself: BitsAllocated {allocated}, BitsStored {stored}, HighBit {high}, "
            f"PixelRepresentation {sign}; HighBit must be BitsStored - 1"
        )
    return f"{allocated} {stored} {sign}"


PIXELS = 0x7FE00010  # tag of PixelData
AFTER_PIXELS = (0x7FE1, 0xFFFA, 0xFFFC)  # groups that may follow: a maker's own, signatures, padding (PS3.10, 7.2)


class PixelFile:
    """Frames of a file; those of a file with several are kept, those of a file with one are read when asked for."""

    def __init__(self, path: Path, n_frames: int):
        self._path, self._n_frames = path, n_frames
        self._kept: np.ndarray | None = None

    def frame(self, number: int) -> np.ndarray:
        """Return the stored values of a frame (n_rows, n_columns).

        Raises
        ------
        InputError
            If the pixels are missing, cut short, damaged, too many, or beyond the bits that the header gives them.
        """
        frames = self._read() if self._kept is None else self._kept
        if self._n_frames > 1:
            self._kept = frames
        return frames[number]

    def _read(self) -> np.ndarray:
        dataset = dataset_of(self._path, pixels=True)
        data = dataset.PixelData
        tags = list(dataset.keys())  # in the order of the file
        if not all(_may_follow(tag, tags) for tag in tags[tags.index(PIXELS) + 1 :]):
            raise InputError("bytes that are no DICOM element follow the pixels: the file is damaged; export it again")
        syntax = dataset.file_meta.get("TransferSyntaxUID")  # none: implicit and little endian
        if syntax and syntax.is_compressed and syntax != DEFLATED:
            return _decompressed(dataset, self._n_frames)
        return _native(dataset, data, self._n_frames, big=bool(syntax) and not syntax.is_little_endian)


def _may_follow(tag: pydicom.tag.BaseTag, tags: Sequence[int]) -> bool:
    """Return whether an element may follow the pixels: of a known group, or in a block that a maker reserved (PS3.5, 7.8.1)."""
    reserved = (tag.group << 16) | (tag.element if tag.element < 0x100 else tag.element >> 8)
    return tag.group in AFTER_PIXELS or (tag.group % 2 == 1 and reserved & 0xFFFF >= 0x10 and reserved in tags)


def _native(dataset: pydicom.Dataset, data: bytes, n_frames: int, *, big: bool) -> np.ndarray:
    """Return uncompressed pixels (n_frames, n_rows, n_columns); those of other bits than the stored ones are refused."""
    size = dataset.BitsAllocated // 8
    row = dataset.Columns * size
    needed = n_frames * dataset.Rows * row
    if not needed <= len(data) < needed + max(row, 2):
        raise InputError(
            f"{n_frames} x {dataset.Rows} x {dataset.Columns} pixels of {size} bytes need {needed} bytes, but the file has "
            f"{len(data)}; export it again"
        )
    kind = np.dtype((">" if big else "<") + ("i" if dataset.PixelRepresentation else "u") + str(size))
    values = np.frombuffer(data, kind, needed // size).reshape(n_frames, dataset.Rows, dataset.Columns)
    spare = dataset.BitsAllocated - dataset.BitsStored
    if not spare:
        return values
    cut = (values.astype(kind.newbyteorder("=")) << spare) >> spare  # an arithmetic shift keeps the sign
    has_overlay = any(tag.group >> 8 == 0x60 for tag in dataset.keys())  # noqa: SIM118 - not its elements, which may be damaged
    if not has_overlay and (cut != values).any():
        raise InputError(f"pixels have more than the {dataset.BitsStored} bits that the header gives them (BitsStored)")
    return cut


def _decompressed(dataset: pydicom.Dataset, n_frames: int) -> np.ndarray:
    """Return compressed pixels (n_frames, n_rows, n_columns), which ITK decodes one frame at a time."""
    packed = list(pydicom.encaps.generate_frames(dataset.PixelData, number_of_frames=n_frames))
    if len(packed) != n_frames:
        raise InputError(f"the header says {n_frames} frames, but the file has {len(packed)}; export it again")
    with tempfile.TemporaryDirectory() as folder:
        frames = np.stack([_decoded(dataset, frame, Path(folder) / "frame.dcm") for frame in packed])
    if frames.shape != (n_frames, dataset.Rows, dataset.Columns):
        raise InputError(UNREADABLE)
    return frames


def _decoded(dataset: pydicom.Dataset, frame: bytes, path: Path) -> np.ndarray:
    """Return the stored values of one compressed frame, by a file that holds nothing else."""
    alone = pydicom.Dataset()
    alone.file_meta = pydicom.dataset.FileMetaDataset()
    alone.file_meta.TransferSyntaxUID = dataset.file_meta.TransferSyntaxUID
    alone.SOPClassUID = alone.file_meta.MediaStorageSOPClassUID = MR_IMAGE
    alone.SOPInstanceUID = alone.file_meta.MediaStorageSOPInstanceUID = "1.2.3"
    for name in MODULE_SIGNED:
        setattr(alone, name, dataset.get(name))
    alone.PixelData = pydicom.encaps.encapsulate([frame])
    alone["PixelData"].is_undefined_length = True
    alone.save_as(path, enforce_file_format=True)
    with quiet():
        return sitk.GetArrayFromImage(sitk.ReadImage(str(path), imageIO="GDCMImageIO"))[0]


def _check_deflated(path: Path) -> None:
    """Refuse a deflated file that unpacks into more than `LARGEST` bytes, or is damaged."""
    with path.open("rb") as file:
        if file.read(132)[128:] != b"DICM":
            return
        meta = pydicom.filereader.read_file_meta_info(path)
        if meta.get("TransferSyntaxUID") != DEFLATED:
            return
        file.seek(132 + 12 + meta.FileMetaInformationGroupLength)
        inflate, total = zlib.decompressobj(-zlib.MAX_WBITS), 0
        while not inflate.eof and (packed := inflate.unconsumed_tail or file.read(1 << 16)):
            total += len(inflate.decompress(packed, 1 << 22))
            if total > LARGEST:
                raise InputError(f"the deflated DICOM file unpacks into more than {LARGEST >> 20} MB; export it plain")
