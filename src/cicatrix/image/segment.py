"""Segmentation of a breast MRI into labels and tissue probabilities of one breast."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage as ndi

from ..core.errors import InputError
from ..core.positions import POSITIONS
from ..geometry.borders import wall_heights
from ..geometry.labels import TISSUES, Label
from ..geometry.volume import Volume
from .bias import remove_bias
from .chest import Chest, ChestWall, find_chest
from .classify import bright_mass, gland_probability, skin_probability
from .judge import judge, judge_labels
from .trunk import NO_TRUNK, Trunk, cut_share, extent, shortfall

EDGE_MM = 3.0  # largest depth of the skin's edge below the rough outline
EDGE_SHARE_T1, EDGE_SHARE_FATSAT = 0.2, 0.5  # level of that edge between air (0) and the brightest tissue near it (1)
MIN_BODY_ML = 50.0
MIN_CONTRAST = 3.0  # smallest ratio of the median intensities of body and air

Report = Callable[[str, float], None]


@dataclass(frozen=True)
class Segmentation:
    """Tissue labels and probabilities of the voxels of an image.

    Parameters
    ----------
    labels : Volume
        (nz, ny, nx) uint8 of `Label`. Tissue of the trunk is part of the chest.
    probabilities : Volume
        (4, nz, ny, nx) float32 in the order of `TISSUES`; sums to 1 inside the breast and the trunk, 0 elsewhere.
    body : Volume
        (nz, ny, nx) float32, share of breast and trunk in each voxel. With a trunk it is below 1 in voxels that skin, wall or the
        trunk's border cuts, so that these lie between voxels.
    wall_mm : (nz, nx) array
        y of the chest wall [mm]; NaN where it is unknown.
    notes : tuple of str
        Messages for the record of the run that say how the image was segmented.
    """

    labels: Volume
    probabilities: Volume
    body: Volume
    wall_mm: np.ndarray
    notes: tuple[str, ...]


def segment(
    image: Volume,
    *,
    weighting: str,
    side: str,
    position: str = "prone",
    chest_wall: ChestWall | None = None,
    trunk: Trunk = NO_TRUNK,
    resection_centre_mm: tuple[float, float, float] | None = None,
    report: Report | None = None,
) -> Segmentation:
    """Segment the breast of one side, with the trunk around it: skin, then chest wall, then tissue classes.

    Parameters
    ----------
    image : Volume
        (nz, ny, nx) T1-weighted intensities, patient anterior towards -y.
    weighting : str
        "t1" (fat bright) or "t1-fatsat" (fat dark).
    side : str
        Patient's side, "left" (+x) or "right".
    position : str
        One of `POSITIONS`; it is recorded in the notes but does not change the method.
    chest_wall : mapping or (n, 3) array, optional
        Given wall instead of the automatic one: a plane ``{"point_mm": (3,), "normal": (3,)}``, or n >= 4 points [mm]
        that are interpolated by a thin-plate spline.
    trunk : Trunk
        Margins of trunk around the breast, whose tissue is skin and fat; none by default.
    resection_centre_mm : (3,) tuple, optional
        In fat-saturated images, a bright compact mass at this point is labelled as tumour. Otherwise tumour tissue is not
        distinguished from gland.
    report : callable, optional
        Function that is called with the name of a stage and the fraction done.

    Raises
    ------
    InputError
        If an option is unknown, the image shows no body or no breast, the given chest wall is unusable, the skin crosses the wall
        beside the breast, or what is found cannot be a breast (`judge`).
    """
    report = report or (lambda stage, fraction: None)
    _check_words(weighting, side, position)
    report("body", 0.0)
    body, skin_share = _edge_found(image, _body(image), weighting == "t1")
    report("bias field", 0.1)
    flat = remove_bias(image, body)
    report("chest wall", 0.5)
    chest = find_chest(flat, body, weighting == "t1", side, chest_wall, trunk)
    behind = _behind(flat, chest.found_mm)
    breast = _largest(body & ~behind & chest.columns[:, None, :])
    beside = _beside(body & ~_behind(flat, chest.wall_mm), chest, breast)
    body |= np.maximum.accumulate(body, axis=1) & behind  # dark lungs belong to the body
    report("tissue", 0.65)
    probabilities, mass = _tissue(flat, body, breast, _box(breast), weighting, resection_centre_mm)
    labels = _labels(probabilities, body, breast)
    doubt = judge(flat.with_values(labels), flat, probabilities[0], chest, side)
    _add_trunk(probabilities, body, beside, flat.spacing_mm)
    has_trunk = beside.any()
    share = cut_share(breast | beside, skin_share, chest.wall_mm, flat) if has_trunk else probabilities.sum(axis=0)
    how = f"{weighting}, {side} breast, {position}; N4 bias field, skin at its edge to air"
    report("done", 1.0)
    notes = (how, *chest.notes, *_trunk_notes(trunk, chest, breast, beside, side, flat), mass, doubt)
    wanted = tuple(note for note in notes if note)
    labelled, probable, of_body = (image.with_values(values) for values in (labels, probabilities, share))
    return Segmentation(labelled, probable, of_body, chest.wall_mm, wanted)


def _behind(grid: Volume, wall_mm: np.ndarray) -> np.ndarray:
    """Return the voxels behind a wall: y (nz, nx) [mm] -> (nz, ny, nx) bool."""
    return grid.axis(1)[None, :, None] > wall_mm[:, None, :]


def _beside(front: np.ndarray, chest: Chest, breast: np.ndarray) -> np.ndarray:
    """Return the trunk, the part of the body in front of the wall that is connected with the breast (nz, ny, nx) bool."""
    if not chest.beside.any():
        return np.zeros_like(breast)
    return _largest(breast | (front & (chest.beside | chest.columns)[:, None, :])) & ~breast


def _add_trunk(
    probabilities: np.ndarray, body: np.ndarray, trunk: np.ndarray, spacing_mm: tuple[float, float, float]
) -> None:
    """Add skin and fat of the trunk (nz, ny, nx) bool to the probabilities (4, nz, ny, nx), in place."""
    if not trunk.any():
        return
    box = _box(trunk)
    skin, inside = skin_probability(body[box], spacing_mm), trunk[box]
    for label, share in ((Label.SKIN, skin), (Label.FAT, 1.0 - skin)):
        probabilities[(TISSUES.index(label), *box)][inside] = share[inside]


def _trunk_notes(
    trunk: Trunk, chest: Chest, breast: np.ndarray, beside: np.ndarray, side: str, grid: Volume
) -> tuple[str, ...]:
    """Return notes on how much trunk there is."""
    if trunk.is_empty:
        return ()
    base, domain = breast.any(axis=1), (breast | beside).any(axis=1)
    found = extent(base, domain, side, (grid.spacing_mm[2], grid.spacing_mm[0]))
    ml = np.count_nonzero(beside) * np.prod(grid.spacing_mm) / 1000
    return f"{ml:.0f} ml of trunk around the breast", *shortfall(trunk, found, chest.shows_both)


def from_labels(labels: Volume) -> Segmentation:
    """Return the segmentation of an imported label map; probabilities are its labels smoothed over half a voxel in the breast.

    Raises
    ------
    InputError
        If the label map has no voxel of the breast, or the breast cannot have its size (`judge_labels`).
    """
    values = labels.values.astype(np.uint8)
    breast = (values > Label.AIR) & (values < Label.CHEST)
    if not breast.any():
        raise InputError("labels: the label map has no voxel of the breast; at least one of 1, 2, 3, 4 is needed.")
    soft = np.stack([ndi.gaussian_filter((values == t).astype(np.float32), 0.5) * breast for t in TISSUES])
    soft /= np.maximum(soft.sum(axis=0), 1e-6)
    notes = ("labels imported", *judge_labels(labels.with_values(values)))
    found = labels.with_values(values)
    return Segmentation(
        found, labels.with_values(soft), labels.with_values(soft.sum(axis=0)), wall_heights(found), notes
    )


def _check_words(weighting: str, side: str, position: str) -> None:
    """Check the options; the error for an unknown one lists the known ones."""
    for name, value, known in (
        ("weighting", weighting, ("t1", "t1-fatsat")),
        ("side", side, ("left", "right")),
        ("position", position, tuple(POSITIONS)),
    ):
        if value not in known:
            raise InputError(f'{name} must be one of {", ".join(known)}; got "{value}".')


def _body(image: Volume) -> np.ndarray:
    """Find the body by Otsu's threshold of the log intensity: largest component, holes filled per slice, (nz, ny, nx) bool."""
    sigma = [min(0.6, 0.7 / s) for s in image.spacing_mm[::-1]]
    smooth = ndi.gaussian_filter(image.values.astype(np.float32), sigma)
    top = float(np.percentile(smooth, 99))
    if not top > 0 or np.ptp(smooth) < 1e-3 * top:
        raise InputError("image: no breast found, the image is empty or constant; give a T1-weighted breast MRI.")
    log = np.log(np.clip(smooth, 2e-3 * top, top))
    rough = _largest(ndi.binary_opening(smooth > np.exp(_otsu(log))))
    if not rough.any():
        raise InputError(
            "image: no breast found, nothing stands out from the background; give a T1-weighted breast MRI."
        )
    rough = _filled(rough)
    inside, outside = np.median(smooth[rough]), np.median(smooth[~rough]) if not rough.all() else np.inf
    if rough.sum() * np.prod(image.spacing_mm) < 1000 * MIN_BODY_ML or inside < MIN_CONTRAST * outside:
        raise InputError(
            "image: no breast found, nothing stands out from the background; give a T1-weighted breast MRI."
        )
    return rough


def _edge_found(image: Volume, rough: np.ndarray, fat_bright: bool) -> tuple[np.ndarray, np.ndarray]:
    """Shrink the rough body mask, which extends beyond the skin where the breast is bright, to the edge of the skin.

    In a fat-saturated image the skin is bright, and its edge lies halfway between air and the brightest tissue nearby.
    Without fat saturation the skin is dark in front of bright fat, and its edge lies at a lower level.

    Returns
    -------
    (nz, ny, nx) bool array
        Voxels of the body.
    (nz, ny, nx) float32 array
        Share of the body in each voxel: at its edge 1/2 where the image has that level.
    """
    size = image.spacing_mm[::-1]
    air = float(np.median(image.values[~rough])) if not rough.all() else 0.0
    reach = ndi.distance_transform_edt(rough, sampling=size) <= EDGE_MM  # pyright: ignore[reportOperatorIssue]
    peak = ndi.maximum_filter(image.values, [2 * max(round(EDGE_MM / s), 1) + 1 for s in size])
    level = air + (EDGE_SHARE_T1 if fat_bright else EDGE_SHARE_FATSAT) * (peak - air)
    body = _filled(_largest(rough & ~(reach & (image.values < level))))
    return body, _share(body, 0.5 * (image.values - air) / np.maximum(level - air, 1e-6))


def _share(mask: np.ndarray, at_edge: np.ndarray) -> np.ndarray:
    """Return the share of a mask in voxels (nz, ny, nx): 1 inside, 0 outside, as given on both sides of its edge."""
    inside, near = ndi.binary_erosion(mask, border_value=1), np.asarray(ndi.binary_dilation(mask), bool)
    share = np.clip(at_edge, np.where(mask, 0.5, 0.0), np.where(mask, 1.0, 0.5))
    return np.where(inside, 1.0, np.where(near, share, 0.0)).astype(np.float32)


def _otsu(v: np.ndarray) -> float:
    """Return Otsu's threshold of values (n,), which maximises the variance between the classes below and above it."""
    counts, edges = np.histogram(v, 256)
    centres = 0.5 * (edges[1:] + edges[:-1])
    below = np.cumsum(counts)[:-1]
    above = below[-1] + counts[-1] - below
    moment = np.cumsum(counts * centres)
    gap = moment[:-1] / np.maximum(below, 1) - (moment[-1] - moment[:-1]) / np.maximum(above, 1)
    return float(edges[1:-1][np.argmax(below * above * gap**2)])


def _largest(mask: np.ndarray) -> np.ndarray:
    """Return the largest connected component of a mask."""
    pieces, n = ndi.label(mask)  # pyright: ignore[reportGeneralTypeIssues]
    return mask if n < 2 else pieces == 1 + int(np.argmax(np.bincount(pieces.ravel())[1:]))


def _filled(mask: np.ndarray) -> np.ndarray:
    """Fill the holes of a mask in each axial slice."""
    return np.stack([ndi.binary_fill_holes(s) for s in mask])  # pyright: ignore[reportCallIssue]


def _box(mask: np.ndarray) -> tuple[slice, slice, slice]:
    """Return the bounding box of a mask, enlarged by three voxels."""
    out = []
    for axis in range(3):
        hit = np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis)))
        out.append(slice(max(int(hit[0]) - 3, 0), int(hit[-1]) + 4))
    return out[0], out[1], out[2]


def _tissue(
    flat: Volume,
    body: np.ndarray,
    breast: np.ndarray,
    box: tuple[slice, slice, slice],
    weighting: str,
    centre_mm: tuple[float, float, float] | None,
) -> tuple[np.ndarray, str]:
    """Return the probabilities (4, nz, ny, nx) in the order of `TISSUES`, and a note on the tumour."""
    origin = flat.position(np.array([s.start for s in box]))
    part = Volume(flat.values[box], flat.spacing_mm, (float(origin[0]), float(origin[1]), float(origin[2])))
    skin = skin_probability(body[box], flat.spacing_mm) * breast[box]
    inner = breast[box] & (skin < 0.5)
    if inner.sum() < 1000:
        raise InputError("image: no breast found that is thick enough to distinguish its tissues; use smaller voxels.")
    gland = gland_probability(part, inner, weighting == "t1")
    gland[ndi.binary_dilation(skin > 0.05)] = 0  # voxels partly in the skin, and their neighbours, are not gland  # pyright: ignore[reportCallIssue]
    tumour, note = np.zeros_like(inner), "no voxels are labelled as tumour; that needs a label map"
    if weighting == "t1-fatsat" and centre_mm is not None:
        tumour = bright_mass(part, inner, centre_mm)
        ml = tumour.sum() * np.prod(flat.spacing_mm) / 1000
        note = (
            f"tumour: bright mass of {ml:.1f} ml at the resection centre"
            if ml
            else "no bright mass at the resection centre"
        )
    soft = np.clip(ndi.gaussian_filter(tumour.astype(np.float32), 0.5), 0, 1) * (1 - skin)
    rest = (1 - skin - soft).clip(0)
    out = np.zeros((4, *flat.shape), np.float32)
    stack = np.stack([rest * (1 - gland), rest * gland, skin, soft]) * breast[box]
    out[(slice(None), *box)] = stack / np.maximum(stack.sum(axis=0), 1e-6)
    return out, note


def _labels(probabilities: np.ndarray, body: np.ndarray, breast: np.ndarray) -> np.ndarray:
    """Return the most probable tissue in the breast, and chest in the rest of the body: (nz, ny, nx) uint8."""
    tissue = np.asarray(TISSUES, np.uint8)[probabilities.argmax(axis=0)]
    return np.where(breast, tissue, np.where(body, Label.CHEST, Label.AIR)).astype(np.uint8)
