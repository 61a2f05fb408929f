"""Growth of tissue driven by the traction of its cells: a model from the single bond to the tissue."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from ..core.law import Law, param
from .adhesion import Adhesion
from .signals import Signal
from .turnover import Densities, Turnover

NAMES = ("growth", "rho", "c", "m_f", "bound")  # names of the states, followed by those of the signal


class MechanicalStimulus(NamedTuple):
    """Mechanical quantities that cells sense, each of shape (...)."""

    elastic: Array
    """Elastic stretch lambda_s of the tissue [1]."""
    force: Array
    """Force of one bond [pN]."""
    traction: Array
    """Traction t_a at the adhesions [kPa]."""
    signal: Array
    """Mechanical signal H [1]."""


class MechanobiologyModel(Law):
    r"""Tissue under stretch whose cells adhere and contract; the traction that they sense drives collagen production and growth.

    .. math:: \lambda = \lambda_s \lambda_g, \qquad \dot\lambda_g = \dot m_f / \varrho_f, \qquad
        \dot\phi = k_{on} (1 - \phi) - k_{off}(\lambda_s) \, \phi, \qquad t_a = f(\lambda_s) \, \phi \, \rho_i, \qquad H = H(t_a)

    together with the rates of :class:`.turnover.Turnover`. Source: Guo, Mofrad & Buganza Tepole, section V A, Eqs (24)-(30). The
    adhesion is evaluated at the elastic stretch of every state, and the bound fraction is itself a state variable.
    The strain passed to the signal is :math:`\lambda_s^2 - 1`, the elastic change of area under equibiaxial stretch.

    Parameters
    ----------
    adhesion : Adhesion
        Adhesion of the cells. Its substrate must not be time-dependent: after hours it has fully relaxed.
    signal : Signal
        Mechanical signal H.
    turnover : Turnover
        Rates of cells, cytokine and collagen.
    density : float or (...) array [1]
        varrho_f: amount of collagen, relative to healthy tissue, whose production raises the growth stretch by 1.
    """

    adhesion: Adhesion
    signal: Signal
    turnover: Turnover
    density: float | Array = param("1", "varrho_f", above=0.0, default=1.0)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states (n_states,)."""
        return (*NAMES, *self.signal.names)

    def stimulus(self, y: Array, stretch: Array) -> MechanicalStimulus:
        """Return the mechanical stimulus of the cells in states (..., n_states) at a stretch lambda (...) [1]."""
        elastic = stretch / y[..., 0]
        force = self.adhesion.steady_state(elastic).force
        traction = self.adhesion.traction(force, y[..., 4])
        return MechanicalStimulus(elastic, force, traction, self.signal.value(y[..., 5:], traction, _strain(elastic)))

    def rate(self, y: Array, stretch: Array) -> Array:
        """Return rates of states (..., n_states) [1] at a stretch lambda (...) [1] -> (..., n_states) [1/s]; NaN if invalid."""
        stimulus = self.stimulus(y, stretch)
        made = self.turnover.rates(Densities(y[..., 1], y[..., 2], y[..., 3]), stimulus.signal)
        bound = self.adhesion.rate(y[..., 4], stimulus.elastic)
        own = jnp.stack([made.m_f / self.density, *made, bound], axis=-1)
        return jnp.concatenate(
            [own, self.signal.rate(y[..., 5:], stimulus.traction, _strain(stimulus.elastic))], axis=-1
        )


def _strain(elastic: Array) -> Array:
    return elastic**2 - 1.0
