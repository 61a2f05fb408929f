"""Mechanotransduction: signal in [0, 1] of a cell from the traction at its adhesions and the strain around it."""

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
    """Interface of a mechanical signal, which may have states of its own."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states of the signal (n_states,)."""
        ...

    def rate(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return rates of states (..., n_states) at a traction (...) [kPa] and a strain (...) [1] -> (..., n_states) [1/s]."""
        ...

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return H (...) in [0, 1] at states (..., n_states), traction (...) [kPa] and strain (...) [1]; 0 without stimulus."""
        ...


class _WithoutStates(Law):
    """Base class of signals without states, which respond instantaneously."""

    @property
    def names(self) -> tuple[str, ...]:
        """Empty tuple, since there are no states."""
        return ()

    def rate(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return the empty array of rates, since there are no states."""
        return y


class TractionSignal(_WithoutStates):
    r"""Signal that saturates with traction, :math:`H = \langle t_a - t_0 \rangle / (K + \langle t_a - t_0 \rangle)`.

    In place of H, Guo, Mofrad & Buganza Tepole print constants (Eqs 28-30), but their text says that production depends on t_a;
    that H saturates, and is 0 without traction, is an interpretation. Cells also pull on unstretched tissue: if t_0 is their
    traction there, such tissue does not change; with t_0 = 0 it grows.

    Parameters
    ----------
    K : float or (...) array [kPa]
        Traction above t_0 at which H is one half.
    threshold : float or (...) array [kPa]
        Traction t_0 below which H is 0.
    """

    K: float | Array = param("kPa", "K_t", above=0.0, default=1.0)
    threshold: float | Array = param("kPa", "t_0", low=0.0, default=0.0)

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return the signal H (...) in [0, 1] at a traction (...) [kPa]."""
        return _saturated(traction - self.threshold, self.K)


class NoMechanosensing(_WithoutStates):
    """No mechanosensing: H = 0."""

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return H = 0 at every point (...)."""
        return jnp.zeros_like(strain)


class LogisticSignal(_WithoutStates):
    r"""Logistic signal of the elastic area stretch, or of the volume stretch in a solid.

    .. math:: H = 1 / (1 + e^{-\gamma (\theta - \theta_{ref})})

    Source: docs/theory/wound.md. The sign in the exponent matters: one published code has a plus there and its signal is always
    on. H below ``least`` is set to 0.

    Parameters
    ----------
    theta_ref : float or (...) array [1]
        Area stretch at which H is one half; the strain argument is :math:`\theta - 1`.
    gamma : float or (...) array [1]
        Steepness.
    least : float or (...) array [1]
        Smallest H that is not set to 0.
    """

    theta_ref: float | Array = param("1", "theta_ref", above=0.0, default=2.0)
    gamma: float | Array = param("1", "gamma", low=0.0, default=5.0)
    least: float | Array = param("1", "H_min", low=0.0, high=1.0, default=0.002)

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return the signal H (...) in [0, 1] at an area or volume strain (...) [1]."""
        H = sigmoid(self.gamma * (1.0 + strain - self.theta_ref))
        return jnp.where(self.least > H, 0.0, H)


class StrainSignal(_WithoutStates):
    r"""Signal that saturates with Moreo's cell stress, Eq. (19), :math:`H = \langle p \rangle / (K + \langle p \rangle)`.

    Parameters
    ----------
    cell : Moreo
        Stress that the cell senses at a strain.
    K : float or (...) array [kPa]
        Stress at which H is one half.
    """

    cell: Moreo
    K: float | Array = param("kPa", "K_p", above=0.0, default=1.0)

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return the signal H (...) in [0, 1] at a strain (...) [1]."""
        return _saturated(self.cell.signal(strain), self.K)


class NetworkSignal(Law):
    """Activity of one species of a signalling network that has the saturating traction signal as an input.

    Parameters
    ----------
    network : HillNetwork
        Signalling network; its activities are the states.
    driven : str
        Input that the traction drives; the other inputs keep their weights in the network.
    output : str
        Species whose activity, divided by its maximum, is the signal.
    traction : TractionSignal
        Saturation law of the traction.

    Raises
    ------
    InputError
        If the network has no such input or species, or if y_max of the output is 0.
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
        """Names of the species of the network (n_species,)."""
        return self.network.species

    @property
    def _row(self) -> int:
        return self.network.species.index(self.output)

    def rate(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return rates of the network's activities (..., n_species) [1] at a traction (...) [kPa] -> (..., n_species) [1/s]."""
        own = jnp.asarray(self.network.weight)[..., self.network.wiring.input_reactions]
        stimulus = self.traction.value(y, traction, strain)
        inputs = jnp.broadcast_to(own, (*stimulus.shape, own.shape[-1]))
        return self.network.rate(y, inputs.at[..., self.network.input_names.index(self.driven)].set(stimulus))

    def value(self, y: Array, traction: Array, strain: Array) -> Array:
        """Return the signal H (...) in [0, 1] at activities y (..., n_species) [1]."""
        return jnp.clip(y[..., self._row] / jnp.asarray(self.network.y_max)[..., self._row], 0.0, 1.0)


def _saturated(x: Array, half: Array | float) -> Array:
    x = jnp.maximum(x, 0.0)
    return x / (half + x)
