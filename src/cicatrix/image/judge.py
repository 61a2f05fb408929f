"""Whether a segmentation can be that of a breast; one that cannot be is refused, with what to give by hand.

The limits were measured on MR images of prone patients and on the phantom, read right and wrong; docs/kinds/lumpectomy.md
has the numbers.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import ndimage as ndi

from ..core.errors import InputError
from ..geometry.labels import TISSUES, Label
from ..geometry.volume import Volume
from .chest import Chest

VOLUME_ML = (50.0, 4000.0)
DEPTH_MM = (15.0, 200.0)  # from the skin to the chest wall
MIDDLE = (0.25, 0.75)  # midline between two breasts, as a share of the body's width
BESIDE = 0.02  # share of the body's width by which the midline beside a single breast may lie outside of it
BEHIND_MM = 10.0  # the skin at the midline lies at most this far behind the skin at the other end of a single breast
FRONT_SHARE = 0.02  # largest share of the breast's columns that the image's front edge may cut
REAR_SHARE, REAR_NOTED = 0.5, 0.05  # largest share that the rear edge may cut, and the share from which that is said
FAT_RATIO = 1.4  # of the most frequent intensities of fat in front, in the middle and behind
LEAST_FAT = 300  # voxels from which that intensity is known

BY_HAND = "or give image.chest_wall (--chest-wall-plane) or image.labels"


def judge(labels: Volume, flat: Volume, fat: np.ndarray, chest: Chest, side: str) -> str:
    """Refuse an automatic segmentation that cannot be that of a breast; return a note on what is cut off, or "".

    Parameters
    ----------
    labels : Volume
        (nz, ny, nx) of `Label`.
    flat : Volume
        (nz, ny, nx) intensities without bias field.
    fat : (nz, ny, nx) array
        Probability of fat.
    chest : Chest
        The chest behind the breast.
    side : str
        "left" or "right".

    Raises
    ------
    InputError
        If the breast is cut by the image's front edge, its midline, volume, depth or fat is not that of a breast, or the chest
        wall lies behind the image.
    """
    breast = np.isin(labels.values, TISSUES)
    _check_front(breast)
    _check_midline(labels, chest, side)
    _check_volume(_volume_ml(labels, breast))
    low, high = DEPTH_MM
    if not low <= chest.depth_mm <= high:
        raise InputError(
            f"image: the chest wall lies {chest.depth_mm:.0f} mm behind the skin, and a breast is {low:g} to {high:g} mm deep; "
            f"check image.side and image.axes, {BY_HAND}."
        )
    if chest.rear_share > REAR_SHARE:
        raise InputError(
            f"image: the image ends before the chest wall behind {100 * chest.rear_share:.0f} % of the breast; "
            f"take an image that shows the wall, {BY_HAND}."
        )
    _check_fat(flat.values, breast & (labels.values == Label.FAT) & (fat > 0.9), breast)
    return _cut_note(chest.rear_share)


def judge_labels(labels: Volume) -> Iterator[str]:
    """Refuse a label map whose breast cannot have its volume; return notes on where it is cut off.

    A slab, cut through the breast from one face of the map to the other, may have any smaller volume.

    Raises
    ------
    InputError
        If the volume is not that of a breast.
    """
    breast = np.isin(labels.values, TISSUES)
    faces = {
        f"{name} {end}": bool(breast.take(index, axis=axis).any())
        for axis, name in enumerate("zyx")
        for end, index in (("low", 0), ("high", -1))
    }
    slab = any(faces[f"{name} low"] and faces[f"{name} high"] for name in "zyx")
    ml = _volume_ml(labels, breast)
    if ml > VOLUME_ML[1] or (ml < VOLUME_ML[0] and not slab):
        raise InputError(
            f"labels: the labelled breast has {ml:.3g} ml, and a breast has {VOLUME_ML[0]:g} to {VOLUME_ML[1]:g} ml; "
            "check the voxel size of the label map, in mm, and which tissue each label is."
        )
    if not (labels.values == Label.CHEST).any():
        touched = ", ".join(face for face, hit in faces.items() if hit)
        yield f"no chest label; the breast touches the image at {touched or 'no face'}"
    elif note := _cut_note(float(breast[:, -1].sum() / breast.any(axis=1).sum())):
        yield note


def _volume_ml(labels: Volume, breast: np.ndarray) -> float:
    return float(np.count_nonzero(breast) * np.prod(labels.spacing_mm)) / 1000


def _cut_note(share: float) -> str:
    """Return a note on a breast that the image's rear edge cuts off; "" if it cuts next to nothing."""
    return (
        f"behind {100 * share:.0f} % of the breast the image ends before the chest wall" if share > REAR_NOTED else ""
    )


def _check_front(breast: np.ndarray) -> None:
    """Refuse a breast that the front edge of the image cuts: the patient's front is then another one."""
    share = breast[:, 0].sum() / breast.any(axis=1).sum()
    if share > FRONT_SHARE:
        raise InputError(
            f"image: the image's front edge cuts {100 * share:.0f} % of the breast, which ends in air there; "
            "give image.axes if the front is another side of the image, or image.labels."
        )


def _check_midline(labels: Volume, chest: Chest, side: str) -> None:
    """Refuse a midline that is neither between two breasts nor beside one, on its medial side.

    The thorax recedes from the midline to the sides, so the skin beside a single breast lies farther back on its lateral side.
    """
    x = labels.axis(2)[(labels.values != Label.AIR).any(axis=(0, 1))]
    share = (chest.midline_mm - x[0]) / (x[-1] - x[0])
    if MIDDLE[0] <= share <= MIDDLE[1]:
        return
    from_medial = share if side == "left" else 1 - share
    x_mm, skin = chest.skin_mm
    medial, lateral = (float(np.interp(at, x_mm, skin)) for at in (chest.midline_mm, x[-1] if side == "left" else x[0]))
    at = f"x = {chest.midline_mm:.0f} mm"
    if medial > lateral + BEHIND_MM:
        raise InputError(
            f"image: no {side} breast is found: at the midline, {at}, the skin would lie {medial - lateral:.0f} mm behind "
            "the skin at the side, as if this were the other breast; check image.side and image.axes, or give image.labels."
        )
    if not -BESIDE <= from_medial <= MIDDLE[0]:
        raise InputError(
            f"image: the midline would be at {at}, {100 * share:.0f} % of the body's width from its right edge, neither "
            f"between two breasts nor medial of the {side} one; check image.side and image.axes, crop the image to the breasts, "
            "or give image.labels."
        )


def _check_volume(ml: float) -> None:
    low, high = VOLUME_ML
    if not low <= ml <= high:
        remedy = "crop the image to the breasts" if ml > high else "check image.side and image.axes"
        raise InputError(
            f"image: the breast that is found has {ml:,.0f} ml, and a breast has {low:g} to {high:g} ml; "
            f"check the voxel size of the image, {remedy}, {BY_HAND}."
        )


def _check_fat(values: np.ndarray, fat: np.ndarray, breast: np.ndarray) -> None:
    """Refuse a breast whose fat is much brighter in one third of its depth than in another: one of them is not fat."""
    first = breast.argmax(axis=1)
    depth = np.maximum(breast.shape[1] - 1 - breast[:, ::-1].argmax(axis=1) - first, 1)
    z, y, x = np.nonzero(fat)
    third = np.clip(3 * (y - first[z, x]) // depth[z, x], 0, 2)
    parts = [values[z[third == k], y[third == k], x[third == k]] for k in range(3)]
    if min(len(part) for part in parts) < LEAST_FAT:
        return
    modes = [_mode(part) for part in parts]
    if max(modes) > FAT_RATIO * min(modes):
        relative = ", ".join(f"{mode / max(modes):.2f}" for mode in modes)
        raise InputError(
            f"image: what is taken for fat is not equally bright in front, in the middle and behind ({relative} of the most); "
            f"check image.weighting and image.side, {BY_HAND}."
        )


def _mode(values: np.ndarray) -> float:
    """Return the most frequent intensity of (n,), by a smoothed histogram."""
    low, high = np.percentile(values, [1, 99])
    counts, edges = np.histogram(values, 64, (low, max(high, low + 1e-6)))
    peak = int(ndi.gaussian_filter1d(counts.astype(float), 2.0).argmax())
    return float(0.5 * (edges[peak] + edges[peak + 1]))
