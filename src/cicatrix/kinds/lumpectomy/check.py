"""What ``cicatrix check`` opens in a case of kind "lumpectomy": its image, its label map, and the network of its healing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...cases.continuum_laws import network_of, scarring_of
from ...core.errors import InputError
from ...files.image_headers import image_box
from ...files.images import read_image
from ...files.segmentations import read_labels
from ...geometry.labels import TISSUES
from ...geometry.volume import Volume
from ...image.phantom import phantom_grid
from .anatomy import size_of, trunk_of
from .body import Anatomy, resection_of
from .case import LumpectomyCase
from .continuum import continuum_values
from .section import plane_of

LARGEST = 64_000_000  # of an image that is read as a whole [B]; of a larger one the header is read


def image(case: LumpectomyCase) -> Sequence[str]:
    """Open the image, and compare the places that the case gives with the space that it covers; return notes on reading it.

    Raises
    ------
    InputError
        If the image cannot be read, the resection's centre or the nipple lies outside of it, or the section misses the resection.
    """
    centre = case.resection.centre_mm
    if case.dimension == 2 and centre is not None:
        plane_of(case, np.array(centre))
    notes: list[str] = []
    box = _box(case, notes)
    if box is not None:
        for key, point in (("resection.centre_mm", centre), ("outcome.nipple_mm", case.outcome.nipple_mm)):
            _refuse_outside(key, point, box)
    return notes


def labels(case: LumpectomyCase) -> Sequence[str]:
    """Read the label map, and look up the label at the resection's centre (InputError if that is no breast); return notes."""
    given, notes = case.image, []
    assert given.labels is not None
    found = read_labels(given.labels, given.label_names, notes.append, axes=given.axes, name="image.labels")
    centre = resection_of(case, Anatomy(None, found, found))
    if case.dimension == 2:
        section, _ = plane_of(case, centre)
        centre = section.to_patient(section.from_patient(centre)[:2])
    _refuse_outside("resection.centre_mm", centre, _box_of(found))
    if found.nearest(centre) not in TISSUES:
        raise InputError(f"resection.centre_mm must lie inside the breast; {_point(centre)} mm does not.")
    return notes


def network(case: LumpectomyCase) -> None:
    """Read the network, and find in it the input and the output that the case names; InputError as :func:`scarring_of`."""
    scarring_of(continuum_values(case), network_of(case.healing.mechanosensing))


PARTS = {"image": image, "image.labels": labels, "healing.mechanosensing.species": network}


def _box(case: LumpectomyCase, notes: list[str]) -> np.ndarray | None:
    """Return the lowest and the highest corner of the image (2, 3) LPS [mm], None if there is no image; add notes on reading."""
    given = case.image
    if given.phantom is not None:
        return _box_of(_phantom_grid(case))
    if not isinstance(given.path, Path):
        return None
    if given.path.is_file() and given.path.stat().st_size > LARGEST:
        box = image_box(given.path, notes.append, axes=given.axes, name="image.path")
        if box is not None:
            return box
    return _box_of(read_image(given.path, note=notes.append, side=given.side, axes=given.axes, name="image.path"))


def _phantom_grid(case: LumpectomyCase) -> Volume:
    image = case.image
    spacing = min(image.voxel_mm, 10.0)
    return phantom_grid(spacing_mm=spacing, side=image.side, size_mm=size_of(image), trunk=trunk_of(case))


def _box_of(volume: Volume) -> np.ndarray:
    ends = np.array([[-0.5] * 3, np.array(volume.shape) - 0.5])
    return volume.position(ends)


def _refuse_outside(key: str, point: object, box: np.ndarray) -> None:
    if point is None or ((box[0] <= point) & (point <= box[1])).all():
        return
    spans = ", ".join(f"{axis} {low:.1f} to {high:.1f}" for axis, low, high in zip("xyz", *box))
    raise InputError(f"{key} must lie inside the image, {spans} mm (LPS); got {_point(point)}.")


def _point(point: object) -> str:
    return "(" + ", ".join(f"{c:.1f}" for c in np.asarray(point)) + ")"
