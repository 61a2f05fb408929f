"""Anderson acceleration of fixed-point iterations."""

from __future__ import annotations

import numpy as np

DEPTH = 4  # number of earlier iterations used


class Anderson:
    """Anderson acceleration of x = g(x): combine the latest iterates so that the residual g(x) - x is smallest to first order.

    Source: Walker & Ni (2011), Anderson acceleration for fixed-point iterations, SIAM Journal on Numerical Analysis 49.
    """

    def __init__(self) -> None:
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._changes: list[tuple[np.ndarray, np.ndarray]] = []

    def mixed(self, x: np.ndarray, image: np.ndarray) -> np.ndarray:
        """Return the next iterate from x (n,) and its image g(x) (n,) under the fixed-point map."""
        left = image - x
        if self._last is not None:
            self._changes = [*self._changes, (left - self._last[0], image - self._last[1])][-DEPTH:]
        self._last = left, image
        if not self._changes:
            return image
        lefts, images = (np.stack(part, axis=1) for part in zip(*self._changes))
        share, *_ = np.linalg.lstsq(lefts, left, rcond=1e-10)
        return image - images @ share
