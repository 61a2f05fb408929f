"""Bonds between integrins and their ligands: closing rate, and opening rate under load."""

from __future__ import annotations

from typing import Protocol

import jax.numpy as jnp
from jax import Array

from ..core.law import Law, param


class Bond(Protocol):
    """Interface of a bond: its closing and opening rates. The adhesion supplies force and energy."""

    k_on: float | Array

    def k_off(self, force: Array, energy: Array) -> Array:
        """Return the opening rate at a force (...) [pN] and an energy (...) [pN um] -> (...) [1/s]."""
        ...


class Bell(Law):
    r"""Slip bond, whose opening rate increases exponentially with the energy at the adhesion.

    .. math:: k_{off} = \hat k_{off} \, e^{\Delta E / k_B T}

    Source: Guo, Mofrad & Buganza Tepole, Eq. (22), after Bell (1978). The energy is defined by
    :class:`.adhesion.Adhesion`.

    Parameters
    ----------
    k_on, k_off0 : float or (...) array [1/s]
        Closing rate, and opening rate without load.
    kT : float or (...) array [pN um]
        Thermal energy; the default is that at 310 K.
    """

    k_on: float | Array = param("1/s", "k_on", low=1e-12)
    k_off0: float | Array = param("1/s", "k_off0", low=1e-12)
    kT: float | Array = param("pN um", "kT", low=1e-12, default=4.28317e-3)

    def k_off(self, force: Array, energy: Array) -> Array:
        """Return the opening rate (...) [1/s] at an energy (...) [pN um]; this law ignores the force (...) [pN]."""
        return self.k_off0 * jnp.exp(energy / self.kT)


class CatchBond(Law):
    r"""Catch-slip bond, which lasts longest at a finite force: force slows one opening pathway and speeds up the other.

    .. math:: k_{off} = k_c \, e^{-f / f_c} + k_s \, e^{f / f_s}

    Source: the two-pathway model of Pereverzev, Prezhdo, Forero, Sokurenko & Thomas, Biophys. J. 89 (2005), Eq. (1), with
    :math:`f_i = k_B T / x_i`; Guo, Mofrad & Buganza Tepole mention catch bonds without an equation. The rate depends on
    the force only: the energy of the substrate is not the reaction coordinate of either pathway.

    Parameters
    ----------
    k_on : float or (...) array [1/s]
        Closing rate.
    k_catch, k_slip : float or (...) array [1/s]
        Opening rates of the two pathways without load.
    f_catch, f_slip : float or (...) array [pN]
        Forces that change these rates by a factor of e.
    """

    k_on: float | Array = param("1/s", "k_on", low=1e-12)
    k_catch: float | Array = param("1/s", "k_c", low=0.0)
    k_slip: float | Array = param("1/s", "k_s", low=1e-12)
    f_catch: float | Array = param("pN", "f_c", low=1e-12)
    f_slip: float | Array = param("pN", "f_s", low=1e-12)

    def k_off(self, force: Array, energy: Array) -> Array:
        """Return the opening rate at a force (...) [pN] and an energy (...) [pN um], which is not used -> (...) [1/s]."""
        return self.k_catch * jnp.exp(-force / self.f_catch) + self.k_slip * jnp.exp(force / self.f_slip)

    def strongest(self) -> Array:
        """Return the force (...) [pN] at which the opening rate is smallest; 0 if the rate increases from zero force on."""
        at = jnp.log(self.k_catch * self.f_slip / (self.k_slip * self.f_catch))
        return jnp.maximum(at, 0.0) / (1.0 / self.f_catch + 1.0 / self.f_slip)
