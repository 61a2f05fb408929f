"""Bonds between integrins and their ligands: how fast one closes, and how fast it opens under what it bears."""

from __future__ import annotations

from typing import Protocol

import jax.numpy as jnp
from jax import Array

from ..core.law import Law, param


class Bond(Protocol):
    """A bond's rates; the adhesion that it is part of says what it bears."""

    k_on: float | Array

    def k_off(self, force: Array, energy: Array) -> Array:
        """Rate of opening at a force (...) [pN] and an energy (...) [pN um] -> (...) [1/s]."""
        ...


class Bell(Law):
    r"""Bond that a load opens the sooner: its rate follows the energy at the adhesion.

    .. math:: k_{off} = \hat k_{off} \, e^{\Delta E / k_B T}

    Source: Guo, Mofrad & Buganza Tepole, Eq. (22), after Bell (1978). What counts as the energy says
    :class:`.adhesion.Adhesion`.

    Parameters
    ----------
    k_on, k_off0 : float or (...) array [1/s]
        Rates of closing, and of opening without load.
    kT : float or (...) array [pN um]
        Thermal energy; the default is that of 310 K.
    """

    k_on: float | Array = param("1/s", "k_on", low=1e-12)
    k_off0: float | Array = param("1/s", "k_off0", low=1e-12)
    kT: float | Array = param("pN um", "kT", low=1e-12, default=4.28317e-3)

    def k_off(self, force: Array, energy: Array) -> Array:
        """Rate of opening at a force (...) [pN], which it does not heed, and an energy (...) [pN um] -> (...) [1/s]."""
        return self.k_off0 * jnp.exp(energy / self.kT)


class CatchBond(Law):
    r"""Bond that lasts longest under some force: one way to open is closed by force, the other one opened.

    .. math:: k_{off} = k_c \, e^{-f / f_c} + k_s \, e^{f / f_s}

    Source: the two-pathway model of Pereverzev, Prezhdo, Forero, Sokurenko & Thomas, Biophys. J. 89 (2005), Eq. (1), with
    :math:`f_i = k_B T / x_i`; Guo, Mofrad & Buganza Tepole name catch bonds and give no form. It heeds the force alone: the
    substrate's energy is not the coordinate of either way.

    Parameters
    ----------
    k_on : float or (...) array [1/s]
        Rate of closing.
    k_catch, k_slip : float or (...) array [1/s]
        Rates of opening without load on either way.
    f_catch, f_slip : float or (...) array [pN]
        Forces that change them by a factor of e.
    """

    k_on: float | Array = param("1/s", "k_on", low=1e-12)
    k_catch: float | Array = param("1/s", "k_c", low=0.0)
    k_slip: float | Array = param("1/s", "k_s", low=1e-12)
    f_catch: float | Array = param("pN", "f_c", low=1e-12)
    f_slip: float | Array = param("pN", "f_s", low=1e-12)

    def k_off(self, force: Array, energy: Array) -> Array:
        """Rate of opening at a force (...) [pN] and an energy (...) [pN um], which it does not heed -> (...) [1/s]."""
        return self.k_catch * jnp.exp(-force / self.f_catch) + self.k_slip * jnp.exp(force / self.f_slip)

    def strongest(self) -> Array:
        """Force (...) [pN] under which it lasts longest: where both ways' slopes cancel; 0 where it is a slip bond throughout."""
        at = jnp.log(self.k_catch * self.f_slip / (self.k_slip * self.f_catch))
        return jnp.maximum(at, 0.0) / (1.0 / self.f_catch + 1.0 / self.f_slip)
