"""How cells feel the tissue about them: by its strain, or by the traction at adhesions that they close and open."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import Law
from .adhesion import Adhesion
from .signals import Signal


class Sensing(Law):
    """A mechanical signal with the adhesion that its traction comes from, if it heeds any.

    Parameters
    ----------
    signal : Signal
        H.
    adhesion : Adhesion, optional
        Its bonds are a state, before those of the signal; without it the traction is 0.
    """

    signal: Signal
    adhesion: Adhesion | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Of the states (n_states,)."""
        return (("bound",) if self.adhesion else ()) + tuple(self.signal.names)

    def rate(self, y: Array, stretch: Array, strain: Array) -> Array:
        """Of states (..., n_states) at an elastic stretch (...) of fibres and a strain (...) [1] -> (..., n_states) [1/s]."""
        if self.adhesion is None:
            return self.signal.rate(y, jnp.zeros_like(strain), strain)
        bound = self.adhesion.rate(y[..., 0], stretch)
        rest = self.signal.rate(y[..., 1:], self.traction(y, stretch), strain)
        return jnp.concatenate([bound[..., None], rest], axis=-1)

    def value(self, y: Array, stretch: Array, strain: Array) -> Array:
        """H (...) in [0, 1]."""
        own = y if self.adhesion is None else y[..., 1:]
        return self.signal.value(own, self.traction(y, stretch), strain)

    def traction(self, y: Array, stretch: Array) -> Array:
        """t_a at the adhesions (...) [kPa]."""
        if self.adhesion is None:
            return jnp.zeros_like(stretch)
        return self.adhesion.traction(self.adhesion.anchored(stretch).force, y[..., 0])
