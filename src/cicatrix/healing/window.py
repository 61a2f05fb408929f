"""A box of a lattice with a border of unfillable sites, flattened: a neighbour is a fixed shift of the flat index."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.hexgrid import Lattice


@dataclass(frozen=True, eq=False)
class Window:
    """Sites ``low`` (included) to ``high`` (excluded) of a lattice, one border site added on every side.

    A flat array over the window has ``size`` entries; "flat index" means an index into it. Border sites count as
    unfillable, so what lies outside the window is never read and never written.

    Parameters
    ----------
    lattice : Lattice
        The whole lattice.
    mask : bool array of the lattice's shape
        Sites that may ever hold a cell.
    low, high : tuple of int
        The box on each axis.
    """

    lattice: Lattice
    mask: np.ndarray
    low: tuple[int, ...]
    high: tuple[int, ...]

    @classmethod
    def whole(cls, lattice: Lattice, mask: np.ndarray) -> Window:
        """Return the window that is the whole lattice."""
        return cls(lattice, mask, (0,) * lattice.ndim, lattice.shape)

    @classmethod
    def around(cls, lattice: Lattice, mask: np.ndarray, sites: np.ndarray, margin: int) -> Window:
        """Bounding box of the marked sites (bool, at least one) and ``margin`` sites more, cut at the frame."""
        axes = range(lattice.ndim)
        marked = [np.flatnonzero(sites.any(axis=tuple(b for b in axes if b != a))) for a in axes]
        low = tuple(max(0, int(m[0]) - margin) for m in marked)
        high = tuple(min(n, int(m[-1]) + 1 + margin) for m, n in zip(marked, lattice.shape))
        return cls(lattice, mask, low, high)

    @property
    def is_whole(self) -> bool:
        """Whether nothing of the lattice lies outside."""
        return self.low == (0,) * self.lattice.ndim and self.high == self.lattice.shape

    @property
    def box(self) -> tuple[slice, ...]:
        """Where the window lies in an array over the lattice."""
        return tuple(slice(a, b) for a, b in zip(self.low, self.high))

    @property
    def shape(self) -> tuple[int, ...]:
        """Sites along each axis, border included."""
        return tuple(b - a + 2 for a, b in zip(self.low, self.high))

    @cached_property
    def shifts(self) -> np.ndarray:
        """Flat shift to each neighbour, in the lattice's order: (n_neighbours,) int64."""
        strides = np.cumprod((1, *self.shape[:0:-1]))[::-1]
        return self.lattice.neighbours @ strides

    @cached_property
    def fillable(self) -> np.ndarray:
        """Sites that may ever hold a cell; false on the border: (size,) bool."""
        return self.cut(self.mask)

    def cut(self, values: np.ndarray) -> np.ndarray:
        """Flat copy of a lattice array, zero on the border: (*lattice.shape) -> (size,)."""
        padded = np.zeros(self.shape, values.dtype)
        padded[(slice(1, -1),) * self.lattice.ndim] = values[self.box]
        return padded.ravel()

    def paste(self, flat: np.ndarray, onto: np.ndarray) -> np.ndarray:
        """Copy of ``onto`` (*lattice.shape) with the window's sites replaced by those of ``flat`` (size,)."""
        result = onto.copy()
        result[self.box] = flat.reshape(self.shape)[(slice(1, -1),) * self.lattice.ndim]
        return result

    def site(self, index: np.ndarray) -> np.ndarray:
        """Return the number of each site in the C order of the whole lattice: flat indices (n,) -> (n,) int64."""
        inner = np.unravel_index(index, self.shape)
        return np.ravel_multi_index([i - 1 + a for i, a in zip(inner, self.low)], self.lattice.shape)

    def beside(self, marked: np.ndarray) -> np.ndarray:
        """Fillable or not, every inner site that is marked or has a marked neighbour: (size,) bool -> (size,) bool."""
        wide = marked.copy()
        reach = int(abs(self.shifts).max())
        inner = slice(reach, wide.size - reach)
        for shift in self.shifts:
            wide[inner] |= marked[reach + shift : wide.size - reach + shift]
        return wide & self._inner

    def within(self, marked: np.ndarray, n_hops: int) -> np.ndarray:
        """Return the inner sites within a hop distance of a marked one: (size,) bool -> (size,) bool."""
        for _ in range(n_hops):
            marked = self.beside(marked)
        return marked

    @cached_property
    def _inner(self) -> np.ndarray:
        inner = np.zeros(self.shape, bool)
        inner[(slice(1, -1),) * self.lattice.ndim] = True
        return inner.ravel()
