"""The anatomy of a case: its image read and segmented, or its labels as given."""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError
from ...files.images import read_image, read_labels
from ...geometry.labels import Label
from ...geometry.volume import Volume
from ...image.phantom import phantom
from ...image.segment import Segmentation, from_labels, segment
from ...runs.progress import Progress
from .body import Anatomy
from .case import LumpectomyCase


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
                spacing_mm=image.voxel_mm, seed=case.run.seed, weighting=image.weighting, side=image.side
            )
            tumour = truth.position(np.argwhere(truth.values == Label.TUMOUR).mean(axis=0))
        elif image.path is not None:
            picture = read_image(image.path, note=notes.append, side=image.side, axes=image.axes, name="image.path")
    with progress.stage("segment"):
        if image.labels is not None:
            found = from_labels(read_labels(image.labels, note=notes.append, axes=image.axes, name="image.labels"))
        else:
            centre = case.resection.centre_mm if tumour is None else tuple(tumour.tolist())
            found = _segment(case, picture, centre, progress)
    return Anatomy(picture, found.labels, found.probabilities, tumour), (*notes, *found.notes)


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
        resection_centre_mm=centre,
        report=lambda stage, fraction: progress.update(fraction, stage),
    )
