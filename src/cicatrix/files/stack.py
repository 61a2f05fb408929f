"""A volume built from planes that each have their own place: slices of a DICOM series and frames of a file alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..core.errors import InputError
from .grid import Grid, Note, Stored, check_directions, check_size

APART_MM, APART = 0.1, 0.02  # largest distance of a plane from its even place: 0.1 mm, or this share of the gap
SAME_DIRECTION = 5e-4  # direction cosines this close are the same: 0.15 mm over 300 mm
SAME_EDGE = 1e-3  # relative difference of pixel spacings that are the same
SLANTED = 0.95  # cosine between the normals of planes of another orientation, at most
FEW = 0.1  # largest share of planes of another orientation that are left out
SLAB_GAPS, SLAB_MM = 3.0, 10.0  # smallest gap between the slabs of two breasts, in gaps of slices and mm
SLAB_RATIO = 0.5  # smallest ratio of their numbers of slices
SIDEWAYS = 0.7  # smallest x of the normal of sagittal planes


@dataclass(frozen=True, eq=False)
class Frame:
    """A plane of pixels.

    Parameters
    ----------
    position_mm : (3,) array
        Centre of its first pixel, LPS [mm].
    directions : (3, 3) array
        Columns: directions in LPS of increasing column, of increasing row, and the normal [1].
    spacing_mm : (2,) tuple of float
        Distance of pixels along a row, and of rows [mm].
    shape : (2,) tuple of int
        Number of rows and columns.
    form : str
        How pixels are stored; it must be the same in all planes.
    values : callable
        Gives the pixels (n_rows, n_columns), scaled as this plane says.
    """

    position_mm: np.ndarray
    directions: np.ndarray
    spacing_mm: tuple[float, float]
    shape: tuple[int, int]
    form: str
    values: Callable[[], np.ndarray]


def stacked(frames: Sequence[Frame], side: str | None, note: Note) -> Stored:
    """Build a volume from planes in any order.

    Parameters
    ----------
    frames : sequence of Frame
        The planes; a few of another orientation, such as a scout, are left out.
    side : str, optional
        "left" or "right": the breast whose slab is taken where there are two.
    note : callable
        Takes sentences on planes that are left out.

    Raises
    ------
    InputError
        If the planes are not of one orientation, size and form, or do not lie evenly behind each other.
    """
    frames = _of_one_orientation(frames, note)
    first = frames[0]
    if len(frames) < 2:
        raise InputError(
            "the DICOM series is a single file with a single slice; a series of two or more slices is needed: give its folder"
        )
    _check_alike(frames)
    normal = first.directions[:, 2]
    frames = sorted(frames, key=lambda frame: float(normal @ frame.position_mm))
    frames = _one_slab(frames, normal, side, note)
    gap, origin = _evenly_spaced(frames)
    rows, columns = first.shape
    check_size((columns, rows, len(frames)))
    values = np.empty((len(frames), rows, columns), np.float32)
    for plane, frame in zip(values, frames):
        with np.errstate(over="ignore"):  # what becomes infinite is refused when the whole image is checked
            plane[...] = frame.values()
    ox, oy, oz = origin.tolist()
    return Stored(values, Grid((*first.spacing_mm, gap), (ox, oy, oz), first.directions))


def _of_one_orientation(frames: Sequence[Frame], note: Note) -> list[Frame]:
    """Return the planes of the commonest orientation; a few clearly slanted to it may be left out."""
    groups: list[list[Frame]] = []
    for frame in frames:
        check_directions(frame.directions)
        for group in groups:
            if np.abs(group[0].directions - frame.directions).max() < SAME_DIRECTION:
                group.append(frame)
                break
        else:
            groups.append([frame])
    main = max(groups, key=len)
    others = [group for group in groups if group is not main]
    n_others = sum(len(group) for group in others)
    slanted = all(abs(main[0].directions[:, 2] @ group[0].directions[:, 2]) < SLANTED for group in others)
    if n_others > max(3, FEW * len(frames)) or n_others >= len(main):
        raise InputError(
            f"the slices have {len(groups)} orientations ({', '.join(str(len(group)) for group in groups)} slices); "
            "keep those of one orientation"
        )
    if not slanted:
        raise InputError(
            f"{n_others} of {len(frames)} slices are turned against the others (ImageOrientationPatient); export them again"
        )
    if n_others:
        note(f"Left out: {n_others} of {len(frames)} slices, of another orientation, as a scout has.")
    return main


def _check_alike(frames: Sequence[Frame]) -> None:
    first = frames[0]
    for what, differs in (
        ("sizes", lambda frame: frame.shape != first.shape),
        ("pixel spacings", lambda frame: not np.allclose(frame.spacing_mm, first.spacing_mm, SAME_EDGE, 0.0)),
        ("pixel formats (bits, sign or photometric interpretation)", lambda frame: frame.form != first.form),
    ):
        n = sum(differs(frame) for frame in frames)
        if n:
            raise InputError(
                f"the slices have different {what}: {n} of {len(frames)} differ from the first; export them again"
            )


def _one_slab(frames: list[Frame], normal: np.ndarray, side: str | None, note: Note) -> list[Frame]:
    """Return all planes, or where sagittal ones form a slab per breast, those of the side asked for."""
    gaps = np.diff([float(normal @ frame.position_mm) for frame in frames])
    wide = np.flatnonzero(gaps > max(SLAB_GAPS * float(np.median(gaps)), SLAB_MM))
    if len(wide) != 1 or abs(normal[0]) < SIDEWAYS:
        return frames
    slabs = [frames[: wide[0] + 1], frames[wide[0] + 1 :]]
    counts = [len(slab) for slab in slabs]
    if min(counts) < max(2, SLAB_RATIO * max(counts)):
        return frames
    if side is None:
        raise InputError(
            f"the slices form two sagittal slabs ({counts[0]} and {counts[1]} slices, {gaps[wide[0]]:.0f} mm apart); "
            "say which side, or keep the slices of one breast"
        )
    slabs.sort(key=lambda slab: float(slab[0].position_mm[0]))
    taken = slabs[1] if side == "left" else slabs[0]  # x points to the patient's left
    note(f"The slices form two sagittal slabs; the {len(taken)} slices of the {side} one are used.")
    return taken


def _evenly_spaced(frames: Sequence[Frame]) -> tuple[float, np.ndarray]:
    """Return the gap between planes [mm], and the place of the first (3,) on the even stack that fits them best.

    Raises
    ------
    InputError
        If a plane lies farther from its even place than `APART_MM` and `APART` of the gap.
    """
    directions = frames[0].directions
    places = np.array([frame.position_mm for frame in frames]) @ directions  # along row, column and normal
    gaps = np.diff(places[:, 2])
    if gaps.min() < 1e-3:
        raise InputError("two DICOM slices have the same position; keep one time point, echo or stack")
    number = np.arange(len(frames)) - 0.5 * (len(frames) - 1)
    slope = number @ (places - places.mean(axis=0)) / (number @ number)
    allowed = max(APART_MM, APART * float(np.median(gaps))) + 1e-6
    uneven = np.abs(places[:, 2] - places[:, 2].mean() - slope[2] * number).max()
    if uneven > allowed:
        raise InputError(
            f"the gaps between DICOM slices range from {gaps.min():.2f} to {gaps.max():.2f} mm; "
            "slices are missing, export the whole series"
        )
    aside = np.linalg.norm(places[:, :2] - places[:, :2].mean(axis=0), axis=1).max()
    if aside > allowed:
        angle = np.rad2deg(np.arctan2(np.linalg.norm(slope[:2]), slope[2]))
        raise InputError(
            f"the slices lie up to {aside:.2f} mm aside of a straight stack (sheared by {angle:.1f} degrees, as by a tilted "
            "gantry); resample them onto a rectangular grid"
        )
    start = [places[:, 0].mean(), places[:, 1].mean(), places[:, 2].mean() + slope[2] * number[0]]
    return float(np.round(slope[2], 9)), directions @ np.array(start)
