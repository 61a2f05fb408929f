"""Surface of a segmented body at sub-voxel resolution, and the signed distance to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage as ndi
from scipy.spatial import cKDTree

from ..core.errors import InputError
from .labels import TISSUES
from .volume import Volume

LEVEL = 0.5  # body fraction of a voxel on the surface
MARGIN = 4  # margin around the body when the image is cropped [voxels]


@dataclass(frozen=True, eq=False)
class SegmentedBody:
    """Body segmented from an image, as a volume fraction per voxel.

    Parameters
    ----------
    share : Volume
        (nz, ny, nx) float32, fraction of each voxel that belongs to the body, 0 .. 1; cropped to the body with a margin.
    volume : float
        Volume of the largest connected component with its holes filled, thin parts included [mm^3].
    notes : tuple of str
        Messages that say what was averaged, left out or filled.
    """

    share: Volume
    volume: float
    notes: tuple[str, ...]


def segmented_body(
    labels: Volume, tissue: Volume | None = None, *, finest_mm: float = 0.0, thin_mm: float = 0.0
) -> SegmentedBody:
    """Extract the body from a label map: the largest connected component, with holes filled and thin parts removed.

    Parameters
    ----------
    labels : Volume
        (nz, ny, nx) of `Label`; the body consists of fat, gland, skin and tumour.
    tissue : Volume, optional
        Tissue fraction 0 .. 1 of each voxel on the same grid; without it the fraction is 1 or 0, by the label.
    finest_mm : float
        Smaller voxels are averaged to about this edge [mm].
    thin_mm : float
        Parts that a ball of this diameter cannot enter are removed (morphological opening) [mm].

    Raises
    ------
    InputError
        If the labels contain no breast, the grids differ, or the breast is too thin.
    """
    if tissue is not None and tissue.shape != labels.shape:
        raise InputError(
            f"tissue shares must lie on the grid of the labels, {labels.shape} voxels; got {tissue.shape}."
        )
    mask = np.isin(labels.values, TISSUES) if tissue is None else tissue.values > LEVEL
    if not mask.any():
        raise InputError(
            "labels: no voxel of the breast; at least one of 1 fat, 2 gland, 3 skin or 4 tumour is needed."
        )
    box = _box(mask)
    values = mask[box] if tissue is None else np.clip(tissue.values[box], 0, 1)
    start = labels.position(np.array([s.start for s in box]))
    share, notes = _averaged(Volume(values.astype(np.float32), labels.spacing_mm, _triple(start)), finest_mm)
    whole, more = _whole(share.values > LEVEL)
    thick = _opened(whole, thin_mm / np.asarray(share.spacing_mm[::-1]))
    if n_thin := int(whole.sum() - thick.sum()):
        more += (f"parts thinner than {thin_mm:.1f} mm left out, {n_thin} of {whole.sum()} voxels",)
    volume = _kept(share, whole).values.sum(dtype=float) * np.prod(share.spacing_mm)
    return SegmentedBody(_kept(share, thick), float(volume), (*notes, *more))


def _triple(numbers: np.ndarray) -> tuple[float, float, float]:
    x, y, z = np.asarray(numbers, float).tolist()
    return x, y, z


def _box(mask: np.ndarray) -> tuple[slice, ...]:
    """Return the bounding box of a mask, enlarged by `MARGIN` voxels."""
    return tuple(slice(max(s.start - MARGIN, 0), s.stop + MARGIN) for s in ndi.find_objects(mask.astype(np.uint8))[0])


def _averaged(share: Volume, finest_mm: float) -> tuple[Volume, tuple[str, ...]]:
    """Return the volume averaged over blocks of voxels with edges up to ``finest_mm``, and a note if the grid changed."""
    spacing = np.asarray(share.spacing_mm)
    n = np.maximum(np.floor(finest_mm / spacing + 1e-6).astype(int), 1)
    if np.all(n == 1):
        return share, ()
    kz, ky, kx = n[::-1].tolist()
    nz, ny, nx = (size // k for size, k in zip(share.shape, (kz, ky, kx)))
    blocks = share.values[: nz * kz, : ny * ky, : nx * kx].reshape(nz, kz, ny, ky, nx, kx)
    origin = np.asarray(share.origin_mm) + 0.5 * (n - 1) * spacing
    note = f"voxels averaged by {kx} x {ky} x {kz}, to {max(n * spacing):.2f} mm"
    return Volume(blocks.mean(axis=(1, 3, 5)), _triple(n * spacing), _triple(origin)), (note,)


def _whole(mask: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return a mask's largest connected component with its holes filled, and notes on parts left out and holes filled."""
    pieces, n = ndi.label(mask)  # pyright: ignore[reportGeneralTypeIssues]
    notes = []
    if n > 1:
        sizes = np.bincount(pieces.ravel())[1:]
        mask = pieces == 1 + int(np.argmax(sizes))
        notes.append(f"the largest of {n} pieces kept; {sizes.sum() - sizes.max()} of {sizes.sum()} voxels left out")
    filled = np.asarray(ndi.binary_fill_holes(mask))
    if n_holes := int(filled.sum() - mask.sum()):
        notes.append(f"holes of {n_holes} voxels inside the body filled")
    return filled, tuple(notes)


def _opened(mask: np.ndarray, diameter: np.ndarray) -> np.ndarray:
    """Open a mask with a ball of ``diameter`` (3,) voxels and return the largest component; outside the image counts as body."""
    if not np.asarray(ndi.binary_erosion(mask, np.ones((3, 3, 3)), border_value=1)).any():
        raise InputError("labels: the breast is thinner than three voxels everywhere; give labels with smaller voxels.")
    n = np.maximum(np.floor((diameter - 1) / 2), 0).astype(int)
    offsets = np.stack(np.meshgrid(*[np.arange(-k, k + 1) for k in n], indexing="ij"), axis=-1)
    ball = np.sum((offsets / np.maximum(n, 1)) ** 2, axis=-1) <= 1.0
    core = np.asarray(ndi.binary_erosion(mask, ball, border_value=1))
    if not core.any():
        raise InputError("labels: the breast is thinner than an element; choose a smaller mesh.edge_mm.")
    return _whole(np.logical_and(ndi.binary_dilation(core, ball), mask))[0]


def _kept(share: Volume, body: np.ndarray) -> Volume:
    """Return the body fraction in the voxels of ``body`` (nz, ny, nx) and in partly filled ones next to it; 0 elsewhere."""
    near = np.logical_and(ndi.binary_dilation(body), share.values <= LEVEL)
    inner = np.where(share.values > LEVEL, share.values, 1.0)  # a filled hole belongs to the body completely
    return share.with_values(np.where(body, inner, np.where(near, share.values, 0.0)).astype(np.float32))


@dataclass(frozen=True, eq=False)
class Isosurface:
    """Surface of a body as a dense set of points with outward normals.

    Parameters
    ----------
    points : (n, 3) array [mm]
        Points at which lines between neighbouring voxel centres cross the surface.
    normals : (n, 3) array
        Outward unit normals.
    share : Volume
        (nz, ny, nx), smoothed body fraction.
    """

    points: np.ndarray
    normals: np.ndarray
    share: Volume

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree of the points."""
        return cKDTree(self.points)

    @cached_property
    def volume(self) -> float:
        """Volume inside the surface [mm^3], of planes through the voxels that the surface cuts."""
        slope = sum(np.abs(step) for step in np.gradient(self.share.values))
        filled = np.clip(0.5 + (self.share.values - LEVEL) / np.maximum(slope, 1e-9), 0, 1)
        return float(filled.sum(dtype=float) * np.prod(self.share.spacing_mm))

    def distance(self, x: np.ndarray, reach_mm: float = np.inf) -> np.ndarray:
        """Return the signed distance of points, negative inside and limited to +-``reach_mm``: (n, 3) [mm] -> (n,) [mm].

        Within two voxels of the surface it is the distance to the tangent plane at the nearest point.
        """
        away, near = self.tree.query(x, distance_upper_bound=reach_mm)
        sign = np.where(self.share.sample(x) > LEVEL, -1.0, 1.0)
        out = sign * np.minimum(away, reach_mm)
        close = away < 2 * max(self.share.spacing_mm)
        to_point = x[close] - self.points[near[close]]
        out[close] = np.einsum("ij,ij->i", to_point, self.normals[near[close]])
        return out


def isosurface(share: Volume, smooth_mm: np.ndarray | float = 0.0) -> Isosurface:
    """Return the surface on which the smoothed body fraction is one half.

    Smoothing with standard deviation s shrinks the radius r of a ball by s^2 / r.

    Parameters
    ----------
    share : Volume
        (nz, ny, nx), body fraction 0 .. 1.
    smooth_mm : float or (3,) array [mm]
        Standard deviation of the Gaussian smoothing along x, y, z; it removes the voxel steps of the image.
    """
    voxels = np.broadcast_to(smooth_mm / np.asarray(share.spacing_mm), 3)[::-1]
    u = share.with_values(ndi.gaussian_filter(share.values, voxels, mode="nearest"))
    points = np.concatenate([_crossings(u, axis) for axis in range(3)])
    steps = 0.5 * np.diag(u.spacing_mm)
    slope = np.stack([(u.sample(points + h) - u.sample(points - h)) / h.sum() for h in steps], axis=-1)
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    return Isosurface(points, -slope / np.maximum(length, 1e-12), u)


def _crossings(u: Volume, axis: int) -> np.ndarray:
    """Return the points at which voxel values, interpolated along an array axis, equal `LEVEL` (n, 3) [mm]."""
    low, high = (np.take(u.values, np.arange(k, u.shape[axis] - 1 + k), axis) for k in (0, 1))
    index = np.nonzero((low > LEVEL) != (high > LEVEL))
    at = np.stack(index, axis=-1).astype(float)
    at[:, axis] += (LEVEL - low[index]) / (high[index] - low[index])
    return u.position(at)
