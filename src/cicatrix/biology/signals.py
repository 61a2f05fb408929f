"""What a cell makes of the traction at its adhesions and of the strain about it: a number from 0 to 1."""

from __future__ import annotations

from typing import Protocol

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.nn import sigmoid

from ..core.errors import InputError
from ..core.law import Law, param
from .moreo import Moreo
from .network import HillNetwork
from .rules import unknown_species


class Signal(Protocol):
    """A mechanical signal, which may have states of its own."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of its states (n_states,)."""
        ...

    def rate(self, y: Array, traction: Array, strain: Array) -> Array:
        """Rate of its states (..., n_states) at a traction (...) [kPa] and a strain (...) [1] -> (..., n_states) [1/s]."""
        ...

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """H (...) in [0, 1]; 0 where the cell feels nothing."""
        ...


class _WithoutStates(Law):
    """A signal that follows at once."""

    @property
    def names(self) -> tuple[str, ...]:
        """None."""
        return ()

    def rate(self, y: Array, traction: Array, strain: Array) -> Array:
        """Of no states."""
        return y


class TractionSignal(_WithoutStates):
    r"""Traction that saturates, :math:`H = \langle t_a - t_0 \rangle / (K + \langle t_a - t_0 \rangle)`.

    Guo, Mofrad & Buganza Tepole print constants in its place (Eqs 28-30) and say in words that production follows t_a; that it
    saturates, and is 0 without traction, is read into them. Cells pull at tissue that is not stretched, too: with the traction
    there as t_0 such tissue stays as it is; with 0 it grows.

    Parameters
    ----------
    K : float or (...) array [kPa]
        Traction beyond t_0 of half the effect.
    threshold : float or (...) array [kPa]
        t_0.
    """

    K: float | Array = param("kPa", "K_t", above=0.0, default=1.0)
    threshold: float | Array = param("kPa", "t_0", low=0.0, default=0.0)

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """H (...)."""
        return _saturated(traction - self.threshold, self.K)


class Unfelt(_WithoutStates):
    """No mechanosensing: H = 0."""

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """0 (...)."""
        return jnp.zeros_like(strain)


class LogisticSignal(_WithoutStates):
    r"""Elastic stretch of area, of volume in a solid, that switches cells on.

    .. math:: H = 1 / (1 + e^{-\gamma (\theta - \theta_{ref})})

    Source: docs/theory/wound.md. The sign in the exponent matters: one published code has a plus there and is always on. Below
    ``least`` it is 0.

    Parameters
    ----------
    theta_ref : float or (...) array [1]
        Area stretch at which H is one half; the strain felt is :math:`\theta - 1`.
    gamma : float or (...) array [1]
        How steep.
    least : float or (...) array [1]
        Smallest H that counts.
    """

    theta_ref: float | Array = param("1", "theta_ref", above=0.0, default=2.0)
    gamma: float | Array = param("1", "gamma", low=0.0, default=5.0)
    least: float | Array = param("1", "H_min", low=0.0, high=1.0, default=0.002)

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """H (...)."""
        H = sigmoid(self.gamma * (1.0 + strain - self.theta_ref))
        return jnp.where(self.least > H, 0.0, H)


class StrainSignal(_WithoutStates):
    r"""Moreo's stress of a cell, Eq. (19), that saturates, :math:`H = \langle p \rangle / (K + \langle p \rangle)`.

    Parameters
    ----------
    cell : Moreo
        What the cell feels at a strain.
    K : float or (...) array [kPa]
        Stress of half the effect.
    """

    cell: Moreo
    K: float | Array = param("kPa", "K_p", above=0.0, default=1.0)

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """H (...)."""
        return _saturated(self.cell.signal(strain), self.K)


class NetworkSignal(Law):
    """Activity of one species of a signalling network, one input of which is the traction that saturates.

    Parameters
    ----------
    network : HillNetwork
        Its activities are states.
    driven : str
        The input that the traction drives; the others keep the weights of the network.
    output : str
        The species whose activity, over its largest one, is the signal.
    traction : TractionSignal
        How the traction saturates.

    Raises
    ------
    InputError
        If the network has no such input or species, naming those it has.
    """

    network: HillNetwork
    traction: TractionSignal
    driven: str = eqx.field(static=True)
    output: str = eqx.field(static=True)

    def __check_init__(self):
        super().__check_init__()
        for what, name, known in (
            ("input", self.driven, self.network.input_names),
            ("output", self.output, self.network.species),
        ):
            if name not in known:
                raise InputError(f"{what} {unknown_species(name, known, what)}")
        if isinstance(self.network.y_max, np.ndarray) and not np.all(self.network.y_max[..., self._row] > 0.0):
            raise InputError(f'output names "{self.output}", whose y_max must be above 0; got 0')

    @property
    def names(self) -> tuple[str, ...]:
        """Species of the network."""
        return self.network.species

    @property
    def _row(self) -> int:
        return self.network.species.index(self.output)

    def rate(self, y: Array, traction: Array, strain: Array) -> Array:
        """Of the network's activities (..., n_species)."""
        own = jnp.asarray(self.network.weight)[..., self.network.wiring.input_reactions]
        felt = self.traction.value(y, traction, strain)
        inputs = jnp.broadcast_to(own, (*felt.shape, own.shape[-1]))
        return self.network.rate(y, inputs.at[..., self.network.input_names.index(self.driven)].set(felt))

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """H (...)."""
        return jnp.clip(y[..., self._row] / jnp.asarray(self.network.y_max)[..., self._row], 0.0, 1.0)


def _saturated(x: Array, half: Array | float) -> Array:
    x = jnp.maximum(x, 0.0)
    return x / (half + x)
