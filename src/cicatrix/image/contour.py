"""Localized region-based active contours in a narrow band, in any number of dimensions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage as ndi

FORCES = ("uniform", "separation")


MARGIN = 3.0  # sites kept beyond the band that moves, so that its stencils see a distance [voxel]
STALE = 0.3  # way after which phi is made a distance again [voxel]
SETTLED = 10  # iterations over which a settled contour must stay


@dataclass(frozen=True)
class Contour:
    """Where the evolution ended.

    ``phi`` is the signed distance, negative inside, cut off at +-``reach`` [voxel]; ``history`` the mean way of the
    contour per iteration [voxel]; ``touched`` how many sites were worked on, summed over the iterations.
    """

    phi: np.ndarray
    history: tuple[float, ...]
    converged: bool
    touched: int

    @property
    def inside(self) -> np.ndarray:
        """Mask of the interior."""
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
    """Move a contour to the edge between locally different means.

    Source: Lankton & Tannenbaum, Localizing region-based active contours, IEEE TIP 17 (2008), Eqs 6, 10 and 13. At each
    band site the means u (inside) and v (outside) are taken within a ball; the site then follows
    ``(I - u)^2 - (I - v)^2`` (uniform) or the mean-separation force of Yezzi, plus ``curvature`` times the curvature.
    Data forces are scaled to at most 1, so ``curvature`` is relative to the strongest edge. After the first distance
    transform only the sites near the contour are ever touched: the balls are gathered by their offsets, and phi is made a
    distance again, there, whenever the contour may have moved by `STALE` voxel (Peng et al., J. Comput. Phys. 155 (1999)).

    Parameters
    ----------
    image : (...) array
        Intensities; isotropic grid.
    inside : (...) bool array
        Where to start.
    radius : float
        Of the ball [voxel].
    force : str
        "uniform" or "separation".
    curvature : float
        Weight of the curvature term.
    band : float
        Half width of the band that moves, and of the smoothed Heaviside and delta [voxel].
    where : (...) bool array, optional
        Sites that may move; the others keep their phi.
    n_iterations, step, tolerance : int, float, float
        At most so many steps of at most ``step`` voxel; stops when the contour's mean way over `SETTLED` steps, forth
        minus back, is below ``tolerance`` voxel.

    Raises
    ------
    ValueError
        An unknown force.
    """
    if force not in FORCES:
        raise ValueError(f"force must be one of {', '.join(FORCES)}; got {force!r}")
    offsets, reach = ball(radius, image.ndim), band + MARGIN
    phi = np.clip(signed_distance(inside), -reach, reach)
    tube = np.argwhere(np.abs(phi) < reach)
    history, ways, touched, moved = [], [], 0, 0.0
    for _ in range(n_iterations):
        sites = tube[np.abs(phi[tuple(tube.T)]) <= reach - 1.0]
        sites = sites if where is None else sites[where[tuple(sites.T)]]
        at = tuple(sites.T)
        close = np.abs(phi[at]) <= band
        if not close.any():
            return Contour(phi, tuple(history), False, touched)
        touched += len(tube)
        data = np.zeros(len(sites))
        data[close] = data_force(image, phi, sites[close], offsets, band, force)
        speed = delta(phi[at], band) / delta(0.0, band) * data / max(float(np.abs(data).max()), 1e-12)
        speed += curvature * mean_curvature(phi, sites)
        change = step * speed / max(1.0, float(np.abs(speed).max()))
        moved += float(np.abs(change).max())
        wide = tuple(_with_neighbours(tube, phi.shape).T)
        before, length = heaviside(-phi[wide], band).sum(), max(float(delta(phi[wide], band).sum()), 1e-9)
        phi[at] += change
        if moved > STALE:
            tube, moved = _redistanced(phi, tube, reach), 0.0
        ways.append(float(heaviside(-phi[wide], band).sum() - before) / length)
        history.append(abs(ways[-1]))
        if len(ways) >= SETTLED and abs(sum(ways[-SETTLED:])) < tolerance:
            return Contour(phi, tuple(history), True, touched)
    return Contour(phi, tuple(history), False, touched)


def data_force(
    image: np.ndarray, phi: np.ndarray, sites: np.ndarray, offsets: np.ndarray, band: float, force: str
) -> np.ndarray:
    """Speed of phi at the sites: sites (n, d) index, offsets (m, d) -> (n,); positive shrinks the inside."""
    u, v, area_u, area_v = local_means(image, phi, sites, offsets, band)
    here = image[tuple(sites.T)]
    if force == "uniform":
        return (here - u) ** 2 - (here - v) ** 2
    return -(u - v) * ((here - u) / np.maximum(area_u, 1) + (here - v) / np.maximum(area_v, 1))


def local_means(
    image: np.ndarray, phi: np.ndarray, sites: np.ndarray, offsets: np.ndarray, band: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Means inside and outside within the ball, and the two ball volumes, at the sites: four arrays (n,)."""
    top = np.asarray(image.shape) - 1
    sums = np.zeros((4, len(sites)))
    for offset in offsets:
        where = tuple(np.clip(sites + offset, 0, top).T)
        h, value = heaviside(-phi[where], band), image[where]
        sums += [h * value, (1 - h) * value, h, 1 - h]
    in_sum, out_sum, in_n, out_n = sums
    return in_sum / np.maximum(in_n, 1e-6), out_sum / np.maximum(out_n, 1e-6), in_n, out_n


def mean_curvature(phi: np.ndarray, sites: np.ndarray) -> np.ndarray:
    """|grad phi| div(grad phi / |grad phi|) at the sites by central differences: (n, d) -> (n,) [1/voxel]."""
    top, d = np.asarray(phi.shape) - 1, phi.ndim

    def at(*moves: int) -> np.ndarray:
        return phi[tuple(np.clip(sites + moves, 0, top).T)]

    unit = np.eye(d, dtype=int)
    first = [(at(*unit[i]) - at(*-unit[i])) / 2 for i in range(d)]
    square = sum(g * g for g in first) + 1e-9
    total = np.zeros(len(sites))
    for i in range(d):
        second = at(*unit[i]) - 2 * at(*(0 * unit[i])) + at(*-unit[i])
        total += second * (square - first[i] ** 2)
        for j in range(i):
            p, m = unit[i] + unit[j], unit[i] - unit[j]
            total -= 2 * first[i] * first[j] * (at(*p) - at(*m) - at(*-m) + at(*-p)) / 4
    return total / square


def ball(radius: float, dimension: int) -> np.ndarray:
    """Integer offsets within a radius, (m, d)."""
    r = int(radius)
    grid = np.stack(np.meshgrid(*[np.arange(-r, r + 1)] * dimension, indexing="ij"), axis=-1).reshape(-1, dimension)
    return grid[(grid**2).sum(axis=1) <= radius**2]


def signed_distance(inside: np.ndarray) -> np.ndarray:
    """Signed distance to a mask's edge, negative inside [voxel]."""
    return np.where(inside, 0.5 - ndi.distance_transform_edt(inside), ndi.distance_transform_edt(~inside) - 0.5)  # pyright: ignore[reportOperatorIssue]


def heaviside(x: np.ndarray, width: float) -> np.ndarray:
    """Smoothed step from 0 to 1 over +-width (their Eq. 2)."""
    t = np.clip(x / width, -1, 1)
    return 0.5 * (1 + t + np.sin(np.pi * t) / np.pi)


def delta(x: np.ndarray | float, width: float) -> np.ndarray:
    """Evaluate the derivative of `heaviside`."""
    t = np.clip(np.asarray(x) / width, -1, 1)
    return 0.5 * (1 + np.cos(np.pi * t)) / width


def _redistanced(phi: np.ndarray, tube: np.ndarray, reach: float) -> np.ndarray:
    """Make phi a signed distance within ``reach`` of its zero level, in place; returns the sites of the new tube.

    The sites beside the zero level keep their distance to it to second order (Russo & Smereka, J. Comput. Phys. 163
    (2000)), so the contour does not drift; the others follow by upwind relaxation.
    """
    old = phi[tuple(tube.T)]
    tube = _with_neighbours(tube[np.abs(old) < reach - 1.0], phi.shape)
    start = phi[tuple(tube.T)]
    ahead, back, beside = _differences(phi, tube)
    fixed = np.zeros(len(tube))
    fixed[beside] = start[beside] / _steepest(ahead[:, beside], back[:, beside])
    phi[tuple(tube[beside].T)] = fixed[beside]
    rest = tube[~beside]
    at, sign = tuple(rest.T), np.sign(start[~beside])
    for _ in range(2 * int(np.ceil(reach)) + 2):
        ahead, back, _ = _differences(phi, rest)
        rise = np.maximum(np.maximum(back * sign, 0.0), np.maximum(-ahead * sign, 0.0))
        phi[at] += 0.5 * sign * (1.0 - np.sqrt((rise**2).sum(axis=0)))
    phi[tuple(tube.T)] = np.clip(phi[tuple(tube.T)], -reach, reach)
    return tube[np.abs(phi[tuple(tube.T)]) < reach]


def _with_neighbours(sites: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Sites and the sites that share a face with them, each once: (n, d) -> (m, d)."""
    top, eye = np.asarray(shape) - 1, np.eye(len(shape), dtype=int)
    several = np.concatenate([sites, *(np.clip(sites + s * e, 0, top) for e in eye for s in (-1, 1))])
    return np.stack(np.unravel_index(np.unique(np.ravel_multi_index(tuple(several.T), shape)), shape), axis=-1)


def _differences(phi: np.ndarray, sites: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward and backward differences (d, n) at the sites, and whether the zero level passes beside them (n,)."""
    top, here = np.asarray(phi.shape) - 1, phi[tuple(sites.T)]
    eye = np.eye(phi.ndim, dtype=int)
    after = np.stack([phi[tuple(np.clip(sites + e, 0, top).T)] for e in eye])
    before = np.stack([phi[tuple(np.clip(sites - e, 0, top).T)] for e in eye])
    beside = ((after < 0) != (here < 0)).any(axis=0) | ((before < 0) != (here < 0)).any(axis=0)
    return after - here, here - before, beside


def _steepest(ahead: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Slope of phi (d, n) -> (n,): central, or one-sided where that is steeper, so that no cell is taken for flat."""
    central = np.abs(ahead + back) / 2
    slope = np.sqrt((central**2).sum(axis=0))
    one_sided = np.maximum(np.abs(ahead), np.abs(back)).max(axis=0)
    return np.maximum(np.where(slope < 0.5 * one_sided, one_sided, slope), 1e-3)
