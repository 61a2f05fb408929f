"""From the single bond to tissue that grows because its cells pull."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from ..core.law import Law, param
from .adhesion import Adhesion
from .signals import Signal
from .turnover import Contents, Turnover

NAMES = ("growth", "rho", "c", "m_f", "bound")  # of the states, before those of the signal


class Felt(NamedTuple):
    """What the cells of a state feel, each (...)."""

    elastic: Array
    """lambda_s, stretch that the tissue bears [1]."""
    force: Array
    """Of one bond [pN]."""
    traction: Array
    """t_a at the adhesions [kPa]."""
    signal: Array
    """H [1]."""


class Chain(Law):
    r"""Tissue under a stretch: its cells adhere to it and pull, what they feel drives what they make, and that is its growth.

    .. math:: \lambda = \lambda_s \lambda_g, \qquad \dot\lambda_g = \dot m_f / \varrho_f, \qquad
        \dot\phi = k_{on} (1 - \phi) - k_{off}(\lambda_s) \, \phi, \qquad t_a = f(\lambda_s) \, \phi \, \rho_i, \qquad H = H(t_a)

    beside the rates of :class:`.turnover.Turnover`. Source: Guo, Mofrad & Buganza Tepole, section V A, Eqs (24)-(30). The
    adhesion is solved at the stretch of every state, and its bonds are a state themselves. The strain that a signal may heed is
    :math:`\lambda_s^2 - 1`, the elastic change of area under equal stretches in the plane.

    Parameters
    ----------
    adhesion : Adhesion
        Its substrate must not yield in time: hours later it has yielded.
    signal : Signal
        H.
    turnover : Turnover
        Cells, cytokine and collagen.
    density : float or (...) array [1]
        varrho_f: collagen, over that of healthy tissue, that makes tissue longer by its own length.
    """

    adhesion: Adhesion
    signal: Signal
    turnover: Turnover
    density: float | Array = param("1", "varrho_f", above=0.0, default=1.0)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the states (n_states,)."""
        return (*NAMES, *self.signal.names)

    def felt(self, y: Array, stretch: Array) -> Felt:
        """What cells feel in states (..., n_states) at a stretch lambda (...) [1]."""
        elastic = stretch / y[..., 0]
        force = self.adhesion.anchored(elastic).force
        traction = self.adhesion.traction(force, y[..., 4])
        return Felt(elastic, force, traction, self.signal.value(y[..., 5:], traction, _strain(elastic)))

    def rate(self, y: Array, stretch: Array) -> Array:
        """Rate of states (..., n_states) [1] at a stretch lambda (...) [1] -> (..., n_states) [1/s]; NaN beyond the adhesion."""
        felt = self.felt(y, stretch)
        made = self.turnover.rates(Contents(y[..., 1], y[..., 2], y[..., 3]), felt.signal)
        bound = self.adhesion.rate(y[..., 4], felt.elastic)
        own = jnp.stack([made.m_f / self.density, *made, bound], axis=-1)
        return jnp.concatenate([own, self.signal.rate(y[..., 5:], felt.traction, _strain(felt.elastic))], axis=-1)


def _strain(elastic: Array) -> Array:
    return elastic**2 - 1.0
