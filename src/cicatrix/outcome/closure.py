"""Measures of wound closure: open area or volume, length or area of the front, roundness, point symmetry."""

from __future__ import annotations

import numpy as np

from ..geometry.hexgrid import Lattice

# number of cut bonds times pitch per length of the front (2-D), or times pitch^2 per area (3-D), mean over its directions
BONDS_PER_FRONT = {2: (6.0 / np.pi) / (np.sqrt(3.0) / 2.0), 3: (6.0 / 2.0) * np.sqrt(2.0)}


def open_size(lattice: Lattice, is_open: np.ndarray) -> float:
    """Return the area (2-D) or volume (3-D) of open sites: bool array of the lattice's shape -> [mm^2, mm^3]."""
    return float(np.count_nonzero(is_open) * lattice.site_measure)


def front_size(lattice: Lattice, is_open: np.ndarray, occupied: np.ndarray) -> float:
    """Return the length (2-D) or area (3-D) of the front between open and occupied sites [mm, mm^2].

    The size follows from the number of cut bonds by the Cauchy-Crofton relation. In 2-D a straight line with normal e cuts
    sum |n_k . e| h / A bonds per length (three bond directions n_k, pitch h, A = sqrt(3)/2 h^2 per site), with the mean
    (3 * 2 / pi) h / A over directions: the length is exact on average, and within 5 % for any one direction. In 3-D a plane
    with normal e cuts sum |n_k . e| h / V bonds per area (six bond directions, V = h^3 / sqrt(2)), with the mean
    (6 / 2) h / V; the error is between -18 and +6 % for any one direction.
    """
    bonds = lattice.n_bonds(is_open, occupied)
    return bonds * lattice.pitch_mm ** (lattice.ndim - 1) / BONDS_PER_FRONT[lattice.ndim]


def asymmetry(is_open: np.ndarray, centre: np.ndarray) -> float:
    """Return the fraction of the open region not covered by its point reflection through a site [1].

    0 means point-symmetric, 1 no overlap. is_open: bool array of the lattice's shape; centre: (n,) site index. In axial
    storage the image of site i is exactly 2 centre - i. Sites whose image lies outside the lattice count as not covered.
    """
    index = np.argwhere(is_open)
    if not len(index):
        return 0.0
    image = 2 * np.asarray(centre) - index
    inside = ((image >= 0) & (image < is_open.shape)).all(axis=1)
    covered = np.zeros(len(index), bool)
    covered[inside] = is_open[tuple(image[inside].T)]
    return float(1.0 - covered.mean())


def centroid_shift(lattice: Lattice, is_open: np.ndarray, open0: np.ndarray) -> np.ndarray:
    """Return the displacement of the open region's centroid from the centroid of the fresh wound: (n,) [mm]; 0 when closed."""
    if not is_open.any():
        return np.zeros(lattice.ndim)
    return lattice.position(np.argwhere(is_open).mean(axis=0)) - lattice.position(np.argwhere(open0).mean(axis=0))


def roundness(lattice: Lattice, is_open: np.ndarray) -> float:
    """Return the ratio of smallest to largest radius of gyration of the open region [1]: 1 if round; NaN below ten sites."""
    points = lattice.position(np.argwhere(is_open))
    if len(points) < 10:
        return float("nan")
    spread = np.linalg.eigvalsh(np.cov(points.T))
    return float(np.sqrt(spread[0] / spread[-1]))


def wound_centre(open0: np.ndarray) -> np.ndarray:
    """Return the site nearest to the centroid of the fresh wound: bool array of the lattice's shape -> (n,) int."""
    return np.rint(np.argwhere(open0).mean(axis=0)).astype(int)


def middle_layer(is_open: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the open sites of the layer through a site (n,) at constant z, for figures: (ny, nx) bool; in 2-D, all open sites.

    The last two axes of the face-centred cubic lattice span a hexagonal lattice in a plane of constant z.
    """
    return is_open if is_open.ndim == 2 else is_open[centre[0]]
