"""How a wound closes: open area or volume, length or area of its front, roundness, point symmetry."""

from __future__ import annotations

import numpy as np

from ..geometry.hexgrid import Lattice

# (cut bonds) x pitch / length, (cut bonds) x pitch^2 / area: means over directions of the front
BONDS_PER_FRONT = {2: (6.0 / np.pi) / (np.sqrt(3.0) / 2.0), 3: (6.0 / 2.0) * np.sqrt(2.0)}


def open_size(lattice: Lattice, is_open: np.ndarray) -> float:
    """Area (a solid's volume) of open sites: bool array of the lattice's shape -> [mm^2, mm^3]."""
    return float(np.count_nonzero(is_open) * lattice.site_measure)


def front_size(lattice: Lattice, is_open: np.ndarray, occupied: np.ndarray) -> float:
    """Length (a solid's area) of the front between open and occupied sites [mm, mm^2].

    By the Cauchy-Crofton relation: a straight line of direction e cuts sum |n_k . e| h / A bonds per length (three
    bond directions n_k, pitch h, A = sqrt(3)/2 h^2 per site), whose mean over directions is (3 * 2 / pi) h / A. Exact on
    average over directions, within 5 % for any one. A plane of normal e cuts sum |n_k . e| h / V per area (six bond
    directions, V = h^3 / sqrt(2)), on average (6 / 2) h / V; between -18 and +6 % for any one.
    """
    bonds = lattice.n_bonds(is_open, occupied)
    return bonds * lattice.pitch_mm ** (lattice.ndim - 1) / BONDS_PER_FRONT[lattice.ndim]


def asymmetry(is_open: np.ndarray, centre: np.ndarray) -> float:
    """Share of the open region that its mirror image through a site does not cover [1]: 0 = point-symmetric, 1 = none.

    is_open: bool array of the lattice's shape; centre: (n,) site index. In axial storage the mirror image of site i is
    2 centre - i, exactly. Sites whose image leaves the lattice count as not covered.
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
    """How far the centroid of the open region has moved from the fresh wound's: (n,) [mm]; 0 when closed."""
    if not is_open.any():
        return np.zeros(lattice.ndim)
    return lattice.position(np.argwhere(is_open).mean(axis=0)) - lattice.position(np.argwhere(open0).mean(axis=0))


def roundness(lattice: Lattice, is_open: np.ndarray) -> float:
    """Ratio of the open region's smaller to larger radius of gyration [1]: 1 = round; NaN below ten sites."""
    points = lattice.position(np.argwhere(is_open))
    if len(points) < 10:
        return float("nan")
    spread = np.linalg.eigvalsh(np.cov(points.T))
    return float(np.sqrt(spread[0] / spread[-1]))


def wound_centre(open0: np.ndarray) -> np.ndarray:
    """Site nearest the centroid of the fresh wound: bool array of the lattice's shape -> (n,) int."""
    return np.rint(np.argwhere(open0).mean(axis=0)).astype(int)


def middle_layer(is_open: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """The layer of sites through a site (n,) that pictures show: (ny, nx) bool; of a section all there is.

    In the face-centred cubic lattice the last two axes span a hexagonal lattice, in a plane of constant z.
    """
    return is_open if is_open.ndim == 2 else is_open[centre[0]]
