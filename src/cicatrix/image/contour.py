"""Localized region-based active contours in a narrow band, in any number of dimensions.

The computation uses lists of sites of a padded grid: a site is a flat index, and neighbours differ by the stride of an axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage as ndi

FORCES = ("uniform", "separation")
MARGIN = 3.0  # width beyond the band in which phi is also updated, for the stencils in the band [voxel]
STALE = 0.3  # displacement of the contour after which phi is reinitialised as a distance [voxel]
SETTLED = 10  # iterations over which the net displacement of a converged contour must be small


@dataclass(frozen=True)
class Contour:
    """Result of the evolution of an active contour.

    ``phi`` (...) is the signed distance, negative inside, limited to a little more than the band [voxel]; ``history`` is the
    mean displacement of the contour in each iteration [voxel]; ``converged`` is whether the evolution reached its tolerance;
    ``touched`` is the number of sites processed, summed over iterations.
    """

    phi: np.ndarray
    history: tuple[float, ...]
    converged: bool
    touched: int

    @property
    def inside(self) -> np.ndarray:
        """Mask of the interior of the contour, bool array of the image's shape."""
        return self.phi < 0


def evolve(
    image: np.ndarray,
    inside: np.ndarray,
    *,
    radius: float,
    force: str = "uniform",
    curvature: float = 0.2,
    band: float = 1.5,
    where: np.ndarray | None = None,
    n_iterations: int = 300,
    step: float = 0.45,
    tolerance: float = 0.05,
) -> Contour:
    """Move a contour to an edge, where the local means on its two sides differ most.

    Source: Lankton & Tannenbaum, Localizing region-based active contours, IEEE TIP 17 (2008), Eqs 6, 10 and 13. At each
    site of the band the means u (inside) and v (outside) are taken within a ball; phi changes at the speed
    ``(I - u)^2 - (I - v)^2`` (uniform) or by the mean-separation force of Yezzi, plus ``curvature`` times the curvature.
    Data forces are scaled to at most 1, so ``curvature`` is relative to the strongest edge. After the initial distance
    transform only sites near the contour are processed; there phi is reinitialised as a distance whenever the contour may
    have moved by `STALE` voxel (Peng et al., J. Comput. Phys. 155 (1999)).

    Parameters
    ----------
    image : (...) array
        Intensities on an isotropic grid.
    inside : (...) bool array
        Interior of the initial contour.
    radius : float
        Radius of the ball [voxel].
    force : str
        "uniform" or "separation".
    curvature : float
        Weight of the curvature term.
    band : float
        Half width of the band in which phi is driven by the image, and of the smoothed Heaviside and delta [voxel].
    where : (...) bool array, optional
        Sites at which phi may change; the others only contribute to the local means.
    n_iterations, step, tolerance : int, float, float
        Largest number of iterations, largest change of phi per iteration [voxel], and net mean displacement of the contour
        over `SETTLED` iterations below which it has converged [voxel].

    Raises
    ------
    ValueError
        If the force is unknown.
    """
    if force not in FORCES:
        raise ValueError(f"force must be one of {', '.join(FORCES)}; got {force!r}")
    pad = int(radius) + 1
    image = np.pad(np.asarray(image, float), pad, mode="edge")
    reach = band + MARGIN
    phi = np.pad(np.clip(signed_distance(inside), -reach, reach), pad, mode="edge")
    may_move = np.pad(np.ones(inside.shape, bool) if where is None else where, pad)
    grid = _Grid(image.shape, may_move.ravel())
    flat, offsets = phi.reshape(-1), grid.flat(ball(radius, image.ndim))
    tube = np.flatnonzero(may_move.ravel() & (np.abs(flat) < reach))
    share = heaviside(-flat, band)
    ways: list[float] = []
    converged, touched, moved = False, 0, 0.0
    while len(ways) < n_iterations and not converged:
        sites = tube[np.abs(flat[tube]) <= reach - 1.0]
        close = np.abs(flat[sites]) <= band
        if not close.any():
            break
        touched += len(tube)
        data = np.zeros(len(sites))
        data[close] = data_force(image.reshape(-1), share, sites[close], offsets, force)
        speed = delta(flat[sites], band) / delta(0.0, band) * data / max(float(np.abs(data).max()), 1e-12)
        speed += curvature * mean_curvature(flat, sites, grid.strides)
        change = step * speed / max(1.0, float(np.abs(speed).max()))
        moved += float(np.abs(change).max())
        wide = grid.with_neighbours(tube)
        length = max(float(delta(flat[wide], band).sum()), 1e-9)
        flat[sites] += change
        if moved > STALE:
            tube, moved = _redistanced(flat, tube, reach, grid), 0.0
        before, share[wide] = share[wide], heaviside(-flat[wide], band)
        ways.append(float((share[wide] - before).sum()) / length)
        converged = len(ways) >= SETTLED and abs(sum(ways[-SETTLED:])) < tolerance
    return Contour(phi[(slice(pad, -pad),) * phi.ndim].copy(), tuple(abs(w) for w in ways), converged, touched)


class _Grid:
    """Strides of a padded grid, and the sites at which phi may change."""

    def __init__(self, shape: tuple[int, ...], allowed: np.ndarray) -> None:
        self.strides = np.array([int(np.prod(shape[i + 1 :])) for i in range(len(shape))])
        self._allowed = allowed

    def flat(self, offsets: np.ndarray) -> np.ndarray:
        """Convert index offsets (m, d) to shifts of the flat index (m,)."""
        return offsets @ self.strides

    def with_neighbours(self, sites: np.ndarray) -> np.ndarray:
        """Return the allowed sites among the given ones and their face neighbours, without duplicates, ascending."""
        several = np.unique(
            np.concatenate([sites, *(sites + s for s in self.strides), *(sites - s for s in self.strides)])
        )
        return several[self._allowed[several]]


def data_force(image: np.ndarray, share: np.ndarray, sites: np.ndarray, offsets: np.ndarray, force: str) -> np.ndarray:
    """Return the speed of phi at sites (n,) from the flat image and inside fraction in balls of offsets (m,); > 0 shrinks."""
    u, v, area_u, area_v = local_means(image, share, sites, offsets)
    here = image[sites]
    if force == "uniform":
        return (here - u) ** 2 - (here - v) ** 2
    return -(u - v) * ((here - u) / np.maximum(area_u, 1) + (here - v) / np.maximum(area_v, 1))


def local_means(
    image: np.ndarray, share: np.ndarray, sites: np.ndarray, offsets: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the means inside and outside the contour within a ball around each site, and both volumes: four arrays (n,)."""
    in_n, in_sum, all_sum = np.zeros((3, len(sites)))
    for offset in offsets:
        near = sites + offset
        h, value = share[near], image[near]
        in_n += h
        in_sum += h * value
        all_sum += value
    out_n = len(offsets) - in_n
    return in_sum / np.maximum(in_n, 1e-6), (all_sum - in_sum) / np.maximum(out_n, 1e-6), in_n, out_n


def mean_curvature(phi: np.ndarray, sites: np.ndarray, strides: np.ndarray) -> np.ndarray:
    """Return |grad phi| div(grad phi / |grad phi|) at sites, by central differences: flat phi, (n,) -> (n,) [1/voxel]."""
    first = [(phi[sites + s] - phi[sites - s]) / 2 for s in strides]
    square = sum(g * g for g in first) + 1e-9
    total = np.zeros(len(sites))
    for i, s in enumerate(strides):
        second = phi[sites + s] - 2 * phi[sites] + phi[sites - s]
        total += second * (square - first[i] ** 2)
        for j, t in enumerate(strides[:i]):
            mixed = (phi[sites + s + t] - phi[sites + s - t] - phi[sites - s + t] + phi[sites - s - t]) / 4
            total -= 2 * first[i] * first[j] * mixed
    return total / square


def ball(radius: float, dimension: int) -> np.ndarray:
    """Return the index offsets (m, d) of all voxels within a radius [voxel] of a voxel, in d dimensions."""
    r = int(radius)
    grid = np.stack(np.meshgrid(*[np.arange(-r, r + 1)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    return grid[(grid**2).sum(axis=1) <= radius**2]


def signed_distance(inside: np.ndarray) -> np.ndarray:
    """Return the signed distance of each voxel to the edge of a mask, negative inside: bool (...) -> (...) [voxel]."""
    return np.where(inside, 0.5 - ndi.distance_transform_edt(inside), ndi.distance_transform_edt(~inside) - 0.5)  # pyright: ignore[reportOperatorIssue]


def heaviside(x: np.ndarray, width: float) -> np.ndarray:
    """Return the smoothed Heaviside function, from 0 to 1 over +-width (Lankton & Tannenbaum, Eq. 2)."""
    t = np.clip(x / width, -1, 1)
    return 0.5 * (1 + t + np.sin(np.pi * t) / np.pi)


def delta(x: np.ndarray | float, width: float) -> np.ndarray:
    """Return the derivative of the smoothed Heaviside function `heaviside` with respect to x."""
    t = np.clip(np.asarray(x) / width, -1, 1)
    return 0.5 * (1 + np.cos(np.pi * t)) / width


def _redistanced(phi: np.ndarray, tube: np.ndarray, reach: float, grid: _Grid) -> np.ndarray:
    """Reinitialise flat phi as a signed distance within ``reach`` of its zero level, in place; return the sites in reach.

    The distance of sites adjacent to the zero level is computed directly, to second order (Russo & Smereka, J. Comput. Phys. 163
    (2000)), so the contour does not drift; the others are found by upwind relaxation.
    """
    tube = grid.with_neighbours(tube[np.abs(phi[tube]) < reach - 1.0])
    ahead, back, beside = _differences(phi, tube, grid.strides)
    phi[tube[beside]] /= _steepest(ahead[:, beside], back[:, beside])
    rest = tube[~beside]
    sign = np.sign(phi[rest])
    for _ in range(2 * int(np.ceil(reach)) + 2):
        ahead, back, _ = _differences(phi, rest, grid.strides)
        rise = np.maximum(np.maximum(back * sign, 0.0), np.maximum(-ahead * sign, 0.0))
        phi[rest] += 0.5 * sign * (1.0 - np.sqrt((rise**2).sum(axis=0)))
    phi[tube] = np.clip(phi[tube], -reach, reach)
    return tube[np.abs(phi[tube]) < reach]


def _differences(phi: np.ndarray, sites: np.ndarray, strides: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return forward and backward differences of phi (d, n) at sites, and whether a neighbour's phi has the other sign (n,)."""
    here = phi[sites]
    after = np.stack([phi[sites + s] for s in strides])
    before = np.stack([phi[sites - s] for s in strides])
    beside = ((after < 0) != (here < 0)).any(axis=0) | ((before < 0) != (here < 0)).any(axis=0)
    return after - here, here - before, beside


def _steepest(ahead: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Return the magnitude of the gradient of phi from forward and backward differences: (d, n), (d, n) -> (n,) [1/voxel].

    Differences are central, or one-sided where the largest one-sided one is more than twice as large.
    """
    central = np.abs(ahead + back) / 2
    slope = np.sqrt((central**2).sum(axis=0))
    one_sided = np.maximum(np.abs(ahead), np.abs(back)).max(axis=0)
    return np.maximum(np.where(slope < 0.5 * one_sided, one_sided, slope), 1e-3)
