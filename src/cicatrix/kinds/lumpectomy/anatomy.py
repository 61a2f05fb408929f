"""The anatomy of a case: its image read and segmented, or its labels as given."""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError
from ...files.images import read_image
from ...files.segmentations import read_labels
from ...geometry.labels import TISSUES, Label
from ...geometry.volume import Volume
from ...image.phantom import phantom
from ...image.segment import Segmentation, from_labels, segment
from ...image.trunk import Trunk
from ...runs.progress import Progress
from .body import Anatomy
from .case import ImageTable, LumpectomyCase

LEAST_MATCHED = 0.5  # share of the labelled breast that must lie in the image


def anatomy_of(case: LumpectomyCase, progress: Progress | None = None) -> tuple[Anatomy, tuple[str, ...]]:
    """Read the case's image and segment it, or take the labels as given; also return notes for the user.

    Raises
    ------
    InputError
        If the image cannot be read or shows no breast.
    """
    image, progress = case.image, progress or Progress()
    notes: list[str] = []
    picture, tumour = None, None
    with progress.stage("image"):
        if image.phantom is not None:
            picture, truth = phantom(
                spacing_mm=image.voxel_mm,
                seed=case.run.seed,
                weighting=image.weighting,
                side=image.side,
                size_mm=size_of(image),
                trunk=trunk_of(case),
            )
            tumour = truth.position(np.argwhere(truth.values == Label.TUMOUR).mean(axis=0))
        elif image.path is not None:
            picture = read_image(image.path, note=notes.append, side=image.side, axes=image.axes, name="image.path")
    with progress.stage("segment"):
        if image.labels is not None:
            found = _imported(image, picture, notes)
            if not trunk_of(case).is_empty:
                notes.append("a label map has no trunk: the body ends beside the breast, and is held there")
        else:
            centre = case.resection.centre_mm if tumour is None else tuple(tumour.tolist())
            found = _segment(case, picture, centre, progress)
    return Anatomy.of(picture, found, tumour), (*notes, *found.notes)


def trunk_of(case: LumpectomyCase) -> Trunk:
    """Return the margins of trunk that the case asks for."""
    return Trunk(**case.trunk.model_dump())


def size_of(image: ImageTable) -> tuple[float, float, float]:
    """Return width, depth and height of the phantom's breast [mm]."""
    width, depth, height = image.phantom_size_mm
    return width, depth, height


def _imported(image: ImageTable, picture: Volume | None, notes: list[str]) -> Segmentation:
    """Return the segmentation of the label map that a case names, and add how it was read and how it lies in the image."""
    labels = read_labels(image.labels, image.label_names, notes.append, axes=image.axes, name="image.labels")
    if picture is not None:
        notes += matched(labels, picture)
    return from_labels(labels)


def matched(labels: Volume, picture: Volume) -> list[str]:
    """Check that the labelled breast lies in the image, by positions in the patient; their grids may differ.

    Returns
    -------
    list of str
        A note if a part of the breast lies outside of the image.

    Raises
    ------
    InputError
        If less than half of the breast lies in the image.
    """
    breast = labels.position(np.argwhere(np.isin(labels.values, TISSUES)))
    voxels = picture.voxel(breast)
    inside = float(np.all((voxels > -0.5) & (voxels < np.array(picture.shape) - 0.5), axis=-1).mean())
    if inside < LEAST_MATCHED:
        low, high = (picture.position(np.array(end)) for end in ((0, 0, 0), np.array(picture.shape) - 1))
        raise InputError(
            f"image.labels: {100 * inside:.0f} % of the labelled breast lie in the image; the breast's centre is at "
            f"{_point(breast.mean(axis=0))} mm and the image spans {_point(low)} to {_point(high)} mm (LPS): "
            "give labels and image of one frame of reference."
        )
    return [f"{100 * (1 - inside):.0f} % of the labelled breast lie outside of the image"] if inside < 0.99 else []


def _point(position: np.ndarray) -> str:
    return ", ".join(f"{p:.0f}" for p in position)


def _segment(
    case: LumpectomyCase, picture: Volume | None, centre: tuple[float, ...] | None, progress: Progress
) -> Segmentation:
    if picture is None:
        raise InputError("image.path is missing: name an image, a label map by image.labels, or a phantom.")
    image = case.image
    wall = image.chest_wall and (image.chest_wall.points_mm or image.chest_wall.model_dump(exclude_none=True))
    return segment(
        picture,
        weighting=image.weighting,
        side=image.side,
        position=image.position,
        chest_wall=wall,
        trunk=trunk_of(case),
        resection_centre_mm=centre,
        report=lambda stage, fraction: progress.update(fraction, stage),
    )
