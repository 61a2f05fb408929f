"""Localized region-based active contours in a narrow band, in any number of dimensions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage as ndi

FORCES = ("uniform", "separation")


@dataclass(frozen=True)
class Contour:
    """Where the evolution ended.

    ``phi`` is the signed distance, negative inside [voxel]; ``history`` the mean ``|step|`` of phi per iteration.
    """

    phi: np.ndarray
    history: tuple[float, ...]
    converged: bool

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
    n_iterations: int = 300,
    step: float = 0.45,
    tolerance: float = 0.01,
) -> Contour:
    """Move a contour to the edge between locally different means.

    Source: Lankton & Tannenbaum, Localizing region-based active contours, IEEE TIP 17 (2008), Eqs 6, 10 and 13. At each
    band site the means u (inside) and v (outside) are taken within a ball; the site then follows
    ``(I - u)^2 - (I - v)^2`` (uniform) or the mean-separation force of Yezzi, plus ``curvature`` times the curvature.
    Data forces are scaled to at most 1, so ``curvature`` is relative to the strongest edge. Work arrays exist only for
    the sites with ``|phi| <= band``: the balls are gathered by their offsets, not convolved. phi is made a signed
    distance again after every step.

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
        Half width of the band, and of the smoothed Heaviside and delta [voxel].
    n_iterations, step, tolerance : int, float, float
        At most so many steps of at most ``step`` voxel; stops when the enclosed volume changes by less than
        ``tolerance`` of the band over ten steps.

    Raises
    ------
    ValueError
        An unknown force.
    """
    if force not in FORCES:
        raise ValueError(f"force must be one of {', '.join(FORCES)}; got {force!r}")
    offsets = ball(radius, image.ndim)
    phi, history, volumes = signed_distance(inside), [], []
    for _ in range(n_iterations):
        sites = band_sites(phi, band)
        if not len(sites):
            return Contour(phi, tuple(history), False)
        data = data_force(image, phi, sites, offsets, band, force)
        at = tuple(sites.T)
        speed = delta(phi[at], band) / delta(0.0, band) * data / max(float(np.abs(data).max()), 1e-12)
        speed = speed + curvature * mean_curvature(phi, sites)
        change = step * speed / max(1.0, float(np.abs(speed).max()))
        phi = _moved(phi, at, change)
        history.append(float(np.abs(change).mean()))
        volumes.append(float(heaviside(-phi[at], band).sum()) + float((phi < -band).sum()))
        if len(volumes) > 10 and abs(volumes[-1] - volumes[-11]) < tolerance * len(sites):
            return Contour(phi, tuple(history), True)
    return Contour(phi, tuple(history), False)


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


def band_sites(phi: np.ndarray, band: float) -> np.ndarray:
    """Find the indices of the sites with |phi| <= band, (n, d)."""
    return np.argwhere(np.abs(phi) <= band)


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


def _moved(phi: np.ndarray, at: tuple[np.ndarray, ...], change: np.ndarray) -> np.ndarray:
    """Add the change at the band, then restore the distance without moving the zero level.

    Sites beside the zero level take phi / |grad phi|; the rest of the near band follows by Sussman steps; what lies
    farther takes the distance of the mask.
    """
    phi = phi.copy()
    phi[at] += change
    fresh = signed_distance(phi < 0)
    near = np.abs(fresh) <= 3
    beside = np.abs(fresh) <= 0.5
    sites = np.argwhere(beside)
    start = np.where(near, np.clip(phi, fresh - 1, fresh + 1), fresh)
    start[tuple(sites.T)] = phi[tuple(sites.T)] / np.clip(_slope(phi, sites), 0.3, 3.0)
    return _sussman(start, np.argwhere(near & ~beside))


def _slope(phi: np.ndarray, sites: np.ndarray) -> np.ndarray:
    """|grad phi| by central differences at the sites: (n, d) -> (n,)."""
    top, eye = np.asarray(phi.shape) - 1, np.eye(phi.ndim, dtype=int)
    rise = [(phi[tuple(np.clip(sites + e, 0, top).T)] - phi[tuple(np.clip(sites - e, 0, top).T)]) / 2 for e in eye]
    return np.sqrt(sum(g * g for g in rise))


def _sussman(phi: np.ndarray, sites: np.ndarray, n: int = 3) -> np.ndarray:
    """Take a few steps of phi_t = sign(phi0)(1 - |grad phi|), Godunov upwind, at the sites only."""
    top, at, eye = np.asarray(phi.shape) - 1, tuple(sites.T), np.eye(phi.ndim, dtype=int)
    sign = phi[at] / np.sqrt(phi[at] ** 2 + 1)
    for _ in range(n):
        here, square = phi[at], np.zeros(len(sites))
        for e in eye:
            back = (here - phi[tuple(np.clip(sites - e, 0, top).T)]) * np.sign(sign)
            ahead = (phi[tuple(np.clip(sites + e, 0, top).T)] - here) * np.sign(sign)
            square += np.maximum(np.maximum(back, 0) ** 2, np.minimum(ahead, 0) ** 2)
        phi[at] = here + 0.3 * sign * (1 - np.sqrt(square))
    return phi
