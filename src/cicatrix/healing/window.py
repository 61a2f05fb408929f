"""Rectangular window of a lattice as a flat array: a neighbour is a fixed shift of the flat index."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry.hexgrid import Lattice


@dataclass(frozen=True, eq=False)
class Window:
    """Sites ``low`` (included) to ``high`` (excluded) of a lattice, with one border site added on every side.

    A flat array over the window has ``size`` entries; "flat index" means an index into it. Border sites count as
    unfillable, so sites outside the window are never read or written.

    Parameters
    ----------
    lattice : Lattice
        The whole lattice.
    mask : bool array of the lattice's shape
        Sites that can be occupied by a cell.
    low, high : tuple of int
        Range of sites on each axis.
    """

    lattice: Lattice
    mask: np.ndarray
    low: tuple[int, ...]
    high: tuple[int, ...]

    @classmethod
    def whole(cls, lattice: Lattice, mask: np.ndarray) -> Window:
        """Return the window that covers the whole lattice."""
        return cls(lattice, mask, (0,) * lattice.ndim, lattice.shape)

    @classmethod
    def around(cls, lattice: Lattice, mask: np.ndarray, sites: np.ndarray, margin: int) -> Window:
        """Return the bounding box of the marked sites (bool, at least one), enlarged by ``margin``, within the lattice."""
        axes = range(lattice.ndim)
        marked = [np.flatnonzero(sites.any(axis=tuple(b for b in axes if b != a))) for a in axes]
        low = tuple(max(0, int(m[0]) - margin) for m in marked)
        high = tuple(min(n, int(m[-1]) + 1 + margin) for m, n in zip(marked, lattice.shape))
        return cls(lattice, mask, low, high)

    @property
    def is_whole(self) -> bool:
        """True if the window covers the whole lattice."""
        return self.low == (0,) * self.lattice.ndim and self.high == self.lattice.shape

    @property
    def box(self) -> tuple[slice, ...]:
        """Slices that select the window in an array of the lattice's shape."""
        return tuple(slice(a, b) for a, b in zip(self.low, self.high))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of sites along each axis, border included."""
        return tuple(b - a + 2 for a, b in zip(self.low, self.high))

    @cached_property
    def shifts(self) -> np.ndarray:
        """Shift of the flat index to each neighbour, in the lattice's order: (n_neighbours,) int64."""
        strides = np.cumprod((1, *self.shape[:0:-1]))[::-1]
        return self.lattice.neighbours @ strides

    @cached_property
    def fillable(self) -> np.ndarray:
        """Sites that can be occupied by a cell; false on the border: (size,) bool."""
        return self.cut(self.mask)

    def cut(self, values: np.ndarray) -> np.ndarray:
        """Return the window's part of a lattice array as a flat array, zero on the border: (*lattice.shape) -> (size,)."""
        padded = np.zeros(self.shape, values.dtype)
        padded[(slice(1, -1),) * self.lattice.ndim] = values[self.box]
        return padded.ravel()

    def paste(self, flat: np.ndarray, onto: np.ndarray) -> np.ndarray:
        """Return a copy of ``onto`` (*lattice.shape) with the window's sites replaced by those of ``flat`` (size,)."""
        result = onto.copy()
        result[self.box] = flat.reshape(self.shape)[(slice(1, -1),) * self.lattice.ndim]
        return result

    def site(self, index: np.ndarray) -> np.ndarray:
        """Return the number of each site in the C order of the whole lattice: flat indices (n,) -> (n,) int64."""
        inner = np.unravel_index(index, self.shape)
        return np.ravel_multi_index([i - 1 + a for i, a in zip(inner, self.low)], self.lattice.shape)

    def beside(self, marked: np.ndarray) -> np.ndarray:
        """Return the inner sites that are marked or have a marked neighbour, fillable or not: (size,) bool -> (size,) bool."""
        wide = marked.copy()
        reach = int(abs(self.shifts).max())
        inner = slice(reach, wide.size - reach)
        for shift in self.shifts:
            wide[inner] |= marked[reach + shift : wide.size - reach + shift]
        return wide & self._inner

    def within(self, marked: np.ndarray, n_hops: int) -> np.ndarray:
        """Return the inner sites within ``n_hops`` hops of a marked site: (size,) bool -> (size,) bool."""
        for _ in range(n_hops):
            marked = self.beside(marked)
        return marked

    @cached_property
    def _inner(self) -> np.ndarray:
        inner = np.zeros(self.shape, bool)
        inner[(slice(1, -1),) * self.lattice.ndim] = True
        return inner.ravel()
