"""Lattices of cell sites: hexagonal in 2-D (root lattice A2) and face-centred cubic in 3-D (root lattice A3).

Axial storage: site ``i`` (one integer per axis) lies at ``origin + i @ basis``. The basis vectors have the length of the
pitch and meet at 60 degrees, so the nearest neighbours are exactly +-e_i and e_i - e_j: 6 in 2-D, 12 in 3-D.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from ..core.errors import InputError

MAX_SITES = 2**40


@dataclass(frozen=True)
class Lattice:
    """Block of lattice sites in axial storage.

    Parameters
    ----------
    shape : tuple of 2 or 3 int
        Number of sites along each lattice axis; the last axis runs along x.
    pitch_mm : float
        Distance between nearest neighbours [mm].
    origin_mm : tuple of 2 or 3 float
        Position of site 0 as x, y (, z) [mm].

    Raises
    ------
    InputError
        If a size is not positive or too large, or the arguments differ in dimension.
    """

    shape: tuple[int, ...]
    pitch_mm: float
    origin_mm: tuple[float, ...]

    def __post_init__(self):
        if len(self.shape) not in (2, 3) or any(int(n) != n or n < 1 for n in self.shape):
            raise InputError(f"Lattice.shape must be two or three positive counts of sites; got {self.shape}")
        if self.n_sites > MAX_SITES:
            raise InputError(f"Lattice.shape {self.shape} holds {self.n_sites} sites; at most {MAX_SITES} are possible")
        if not (np.isfinite(self.pitch_mm) and self.pitch_mm > 0):
            raise InputError(f"Lattice.pitch_mm must be positive; got {self.pitch_mm}")
        if len(self.origin_mm) != self.ndim or not np.isfinite(self.origin_mm).all():
            raise InputError(f"Lattice.origin_mm must be {self.ndim} finite numbers; got {self.origin_mm}")
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        object.__setattr__(self, "origin_mm", tuple(float(x) for x in self.origin_mm))

    @classmethod
    def covering(cls, low_mm: np.ndarray, high_mm: np.ndarray, pitch_mm: float) -> Lattice:
        """Return the smallest lattice of given pitch that covers a box from ``low`` to ``high`` (n,) [mm]; ``low`` is a site.

        For every point of the box all surrounding sites exist, so ``nearest`` never leaves the lattice there. The block
        of sites is sheared, so some of them lie outside the box.
        """
        low, high = np.asarray(low_mm, float), np.asarray(high_mm, float)
        if low.ndim != 1 or low.shape != high.shape or low.size not in (2, 3):
            raise InputError(f"the corners of a box must have two or three numbers each; got {low_mm} and {high_mm}")
        if not (high > low).all():
            raise InputError(f"a box to cover with sites must have low < high on every axis; got {low_mm} to {high_mm}")
        unit = cls((1,) * low.size, pitch_mm, tuple(low.tolist()))
        index = unit.index(np.array(list(product(*zip(low, high)))))
        first, last = np.floor(index.min(axis=0) - 1e-9), np.ceil(index.max(axis=0) + 1e-9)
        origin = tuple(unit.position(first).tolist())
        return cls(tuple(int(n) for n in last - first + 1), pitch_mm, origin)

    @property
    def ndim(self) -> int:
        """Number of dimensions, 2 or 3."""
        return len(self.shape)

    @property
    def n_sites(self) -> int:
        """Number of sites."""
        return int(np.prod([int(n) for n in self.shape], dtype=object))

    @cached_property
    def basis_mm(self) -> np.ndarray:
        """Basis vectors as rows: (n, n) [mm]; their length is the pitch, their mutual angle 60 degrees, the last is along x."""
        gram = (np.ones((self.ndim, self.ndim)) + np.eye(self.ndim)) / 2
        return self.pitch_mm * np.linalg.cholesky(gram)[::-1]

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Index offsets of the nearest neighbours, in the order of docs/theory/automaton.md: (6, 2) or (12, 3) int."""
        e = np.eye(self.ndim, dtype=np.int64)
        straight = [sign * v for v in e for sign in (1, -1)]
        across = [e[i] - e[j] for i in range(self.ndim) for j in range(self.ndim) if i != j]
        return np.array(straight + across)

    @property
    def site_measure(self) -> float:
        """Area (2-D: sqrt(3)/2 pitch^2) [mm2] or volume (3-D: pitch^3/sqrt(2)) [mm3] of one site."""
        return float(abs(np.linalg.det(self.basis_mm)))

    def position(self, index: np.ndarray) -> np.ndarray:
        """Return the positions of sites: indices (..., n) -> (..., n) x, y (, z) [mm]."""
        return np.asarray(index, float) @ self.basis_mm + np.asarray(self.origin_mm)

    def positions(self) -> np.ndarray:
        """Return the positions of all sites: (*shape, n) [mm]."""
        return self.position(np.stack(np.meshgrid(*map(np.arange, self.shape), indexing="ij"), axis=-1))

    def near_middle(self, radius_mm: float) -> np.ndarray:
        """Return whether each site lies within a radius of the block's centre, bool array of its shape (computed row by row)."""
        middle = self.position((np.array(self.shape) - 1) / 2)
        along = np.arange(self.shape[-1])[:, None] * self.basis_mm[-1]
        out = np.zeros(self.shape, bool)
        for row in np.ndindex(self.shape[:-1]):
            start = self.position(np.array([*row, 0])) - middle
            out[row] = ((start + along) ** 2).sum(axis=1) < radius_mm**2
        return out

    def index(self, points_mm: np.ndarray) -> np.ndarray:
        """Return fractional site indices: points (..., n) [mm] -> (..., n) [1]."""
        return (np.asarray(points_mm, float) - np.asarray(self.origin_mm)) @ np.linalg.inv(self.basis_mm)

    def nearest(self, points_mm: np.ndarray) -> np.ndarray:
        """Find the nearest sites: points (..., n) [mm] -> (..., n) int64; not clipped to the lattice.

        The lattice cell around a point is a 60-degree parallelepiped, and the nearest site is one of its corners.
        """
        fractional = self.index(points_mm)
        low = np.floor(fractional)
        corners = np.array(list(product((0.0, 1.0), repeat=self.ndim)))
        gap = (fractional - low)[..., None, :] - corners
        nearest = np.argmin(((gap @ self.basis_mm) ** 2).sum(axis=-1), axis=-1)
        return (low + corners[nearest]).astype(np.int64)

    def contains(self, index: np.ndarray) -> np.ndarray:
        """Check whether site indices lie within the lattice: (..., n) int -> (...) bool."""
        index = np.asarray(index)
        return np.asarray(((index >= 0) & (index < np.array(self.shape))).all(axis=-1))

    def beside(self, marked: np.ndarray) -> np.ndarray:
        """Mark the sites that have a marked neighbour on the lattice: bool array of the lattice's shape -> the same."""
        return np.logical_or.reduce(list(self._shifted(marked)))

    def n_bonds(self, one: np.ndarray, other: np.ndarray) -> int:
        """Count the pairs of neighbouring sites between two disjoint sets, each a bool array of the lattice's shape."""
        return sum(int(np.count_nonzero(one & shifted)) for shifted in self._shifted(other))

    def _shifted(self, marked: np.ndarray) -> Iterator[np.ndarray]:
        """Yield, for each neighbour direction, the value at that neighbour of every site; False if it is outside the lattice."""
        padded = np.pad(marked, 1)
        for offset in self.neighbours:
            yield padded[tuple(slice(1 + o, 1 + o + n) for o, n in zip(offset, self.shape))]

    def ball(self, radius_sites: int) -> np.ndarray:
        """Return the index offsets of all sites within ``radius_sites`` hops of a site, itself included: (n_offsets, n) int64."""
        axis = np.arange(-radius_sites, radius_sites + 1)
        cube = np.stack(np.meshgrid(*[axis] * self.ndim, indexing="ij"), axis=-1).reshape(-1, self.ndim)
        return cube[hops(cube) <= radius_sites]


def hops(offset: np.ndarray) -> np.ndarray:
    """Return the hop distance, the least number of steps between neighbours, of an offset: (..., n) int -> (...) int.

    It is the larger of the sums of positive and of negative components, as a step +-e_i or e_i - e_j changes each by at
    most one.
    """
    offset = np.asarray(offset)
    return np.maximum(np.maximum(offset, 0).sum(axis=-1), np.maximum(-offset, 0).sum(axis=-1))
