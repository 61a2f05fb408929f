"""Mechanosensing of cells: by the strain of the tissue, or by the traction at their adhesions."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import Law
from .adhesion import Adhesion
from .signals import Signal


class Sensing(Law):
    """Mechanosensing of a cell: a mechanical signal and, optionally, the adhesion whose traction it depends on.

    Parameters
    ----------
    signal : Signal
        Mechanical signal H.
    adhesion : Adhesion, optional
        Adhesion; its bound fraction is the first state, and the states of the signal follow. Without it the traction is 0.
    """

    signal: Signal
    adhesion: Adhesion | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states (n_states,)."""
        return (("bound",) if self.adhesion else ()) + tuple(self.signal.names)

    def rate(self, y: Array, stretch: Array, strain: Array) -> Array:
        """Return rates of states (..., n_states) at an elastic fibre stretch and strain (...) [1] -> (..., n_states) [1/s]."""
        if self.adhesion is None:
            return self.signal.rate(y, jnp.zeros_like(strain), strain)
        bound = self.adhesion.rate(y[..., 0], stretch)
        rest = self.signal.rate(y[..., 1:], self.traction(y, stretch), strain)
        return jnp.concatenate([bound[..., None], rest], axis=-1)

    def value(self, y: Array, stretch: Array, strain: Array) -> Array:
        """Return the signal H (...) in [0, 1] in states (..., n_states) at an elastic fibre stretch and strain (...) [1]."""
        own = y if self.adhesion is None else y[..., 1:]
        return self.signal.value(own, self.traction(y, stretch), strain)

    def traction(self, y: Array, stretch: Array) -> Array:
        """Return the traction t_a at the adhesions (...) [kPa] in states (..., n_states) at a fibre stretch (...) [1]."""
        if self.adhesion is None:
            return jnp.zeros_like(stretch)
        return self.adhesion.traction(self.adhesion.steady_state(stretch).force, y[..., 0])
