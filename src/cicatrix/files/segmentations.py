"""Reading of segmentations as label maps: by the names of their segments where a file has names, else by value."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.deferred import Deferred
from ..core.errors import InputError
from ..geometry.labels import Label
from ..geometry.volume import Volume
from .dicom_segmentations import read_frames, segmentation_in
from .grid import Note
from .images import labels_on, open_image, unheard
from .segments import BY_NAME, Segment, check_given, how_named, labels_of

if TYPE_CHECKING:
    import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
else:
    sitk = Deferred("SimpleITK")  # most runs read no image

SEGMENT_FIELD = re.compile(r"Segment(\d{1,6})_(\w+)", re.ASCII)


def read_labels(
    path: str | Path,
    names: Mapping[str, str] | None = None,
    note: Note = unheard,
    *,
    axes: str | None = None,
    name: str | None = None,
) -> Volume:
    """Read a label map or a segmentation onto an axis-aligned LPS grid.

    A segmentation of 3D Slicer (``.seg.nrrd``) or in DICOM is read by the names of its segments, whatever their values are. A
    label map without names has 0 air, 1 fat, 2 gland, 3 skin, 4 tumour and 5 chest.

    Parameters
    ----------
    path : str or Path
        A NIfTI, NRRD or MetaImage file, a DICOM segmentation, or a folder with one.
    names : mapping of str to str, optional
        Tissue by the name of a segment, or by the value of a label map: ``{"FGT left": "gland"}``, ``{"7": "skin"}``.
    note : callable, optional
        Takes sentences on how the segments were read.
    axes : str, optional
        Directions of the file's x, y and z, such as "LPS", in place of those in its header; a DICOM segmentation keeps its own.
    name : str, optional
        What messages call the file; by default its name.

    Returns
    -------
    Volume
        values (nz, ny, nx) uint8 of `Label`; oblique maps are resampled by the nearest voxel.

    Raises
    ------
    InputError
        If the file cannot be read, a segment has no known name, there are labels other than whole numbers 0 to 5, or there is no
        voxel of the breast (1 to 4).
    """
    path = Path(path)
    file = name or path.name
    image, values, notes = _read(path, names or {}, note, axes, file)
    if not ((values > Label.AIR) & (values < Label.CHEST)).any():
        raise InputError(f"{file}: the label map has no voxel of the breast (1 fat, 2 gland, 3 skin, 4 tumour).")
    for sentence in notes:
        note(sentence)
    return labels_on(image, values)


def _read(
    path: Path, names: Mapping[str, str], note: Note, axes: str | None, file: str
) -> tuple[sitk.Image, np.ndarray, tuple[str, ...]]:
    """Return an image with the geometry, the labels (nz, ny, nx) of its voxels, and notes."""
    segmentation = segmentation_in(path, file)
    if segmentation is not None:
        if axes is not None:
            note(f"{file}: the frames of a DICOM segmentation say where they lie; the given axes {axes} are not used.")
        segments, image = read_frames(segmentation, file)
        return image, *labels_of(segments, names, file)
    image = open_image(path, layers=True, note=note, axes=axes, name=file)
    values = sitk.GetArrayViewFromImage(image)
    fields = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys() if SEGMENT_FIELD.fullmatch(key)}
    if fields:
        return image, *labels_of(slicer_segments(fields, values, file), names, file)
    if values.ndim > 3:
        raise InputError(
            f"{file}: each voxel has {values.shape[-1]} values, and no segment is named; give one label per voxel."
        )
    return image, *labels_by_value(values, names, file)


def labels_by_value(values: np.ndarray, names: Mapping[str, str], file: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the labels (nz, ny, nx) of a map without names; ``names`` gives tissues of values in place of the usual ones."""
    found = np.unique(values)
    check_given(names, [f"{value:g}" for value in found], file)
    tissues = {float(label): label for label in Label} | {float(key): BY_NAME[name] for key, name in names.items()}
    strange = [f"{value:g}" for value in found if float(value) not in tissues]
    if strange:
        raise InputError(
            f"{file}: a label map has only 0 air, 1 fat, 2 gland, 3 skin, 4 tumour and 5 chest; this one also has "
            f"{', '.join(strange[:3])}: {how_named(strange[0])}"
        )
    labels = np.array([tissues[float(value)] for value in found], np.uint8)
    notes = (f"labels by value: {', '.join(f'{key} is {name}' for key, name in names.items())}",) if names else ()
    return labels[np.searchsorted(found, values)], notes


def slicer_segments(fields: Mapping[str, str], values: np.ndarray, file: str) -> list[Segment]:
    """Return the segments that the header of a segmentation of 3D Slicer names.

    Source: Slicer documentation, module Segmentations, "Segmentation file (.seg.nrrd)".

    Parameters
    ----------
    fields : mapping of str to str
        Key-value pairs of the header: ``Segment0_Name``, ``Segment0_LabelValue``, ``Segment0_Layer``, ``Segment0_Tags``, ...
    values : (nz, ny, nx) or (nz, ny, nx, n_layers) array
        Voxels; segments that overlap lie in different layers. A value without a segment counts as one with this name.
    file : str
        Name of the file, for messages.

    Raises
    ------
    InputError
        If a segment has no name, no whole number as value, or no layer, or two segments are the same voxels.
    """
    layers = values[..., None] if values.ndim == 3 else values
    table: dict[int, dict[str, str]] = {}
    for key, value in fields.items():
        if match := SEGMENT_FIELD.fullmatch(key):
            table.setdefault(int(match[1]), {})[match[2]] = value.strip()
    segments: dict[tuple[int, int], Segment] = {}
    for number, of in sorted(table.items()):
        if not of.get("Name"):
            raise InputError(f"{file}: Segment{number}_Name is missing in the header; save the segmentation again.")
        # files of Slicer before 4.11 have neither: each segment is a layer of zeros and ones
        layer, value = (
            _whole(of, key, default, number, file) for key, default in (("Layer", number), ("LabelValue", 1))
        )
        if layer >= layers.shape[-1] or (layer, value) in segments:
            fault = "as another one has" if layer < layers.shape[-1] else "which is not in the file"
            raise InputError(
                f'{file}: the segment "{of["Name"]}" has value {value} in layer {layer}, {fault}; save it again.'
            )
        segments[layer, value] = Segment(of["Name"], _coded_type(of.get("Tags", "")), layers[..., layer] == value)
    nameless = [
        Segment(f"{value:g}", "", layers[..., layer] == value)
        for layer in range(layers.shape[-1])
        for value in np.unique(layers[..., layer])
        if value != 0 and (layer, value) not in segments
    ]
    return [*segments.values(), *nameless]


def _whole(of: Mapping[str, str], key: str, default: int, number: int, file: str) -> int:
    """Return a field of a segment that must be a whole number."""
    text = of.get(key, str(default))
    if not re.fullmatch(r"\d{1,9}", text):
        raise InputError(
            f'{file}: Segment{number}_{key} must be a whole number, 0 or more; the header has "{text[:40]}".'
        )
    return int(text)


def _coded_type(tags: str) -> str:
    """Return the meaning of the coded type in the tags of a segment, the third part of the terminology; empty without one."""
    entry = re.search(r"TerminologyEntry:([^|]*)", tags)
    parts = entry[1].split("~") if entry else []
    return parts[2].rpartition("^")[2] if len(parts) > 2 else ""
