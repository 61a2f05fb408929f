"""Mooney-Rivlin law."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.tensors import cofactor, det, first_invariant
from .material import EnergyMaterial, State


class MooneyRivlin(EnergyMaterial):
    r"""Nearly incompressible Mooney-Rivlin energy.

    .. math:: \Psi = c_{10} (\bar I_1 - 3) + c_{01} (\bar I_2 - 3) + \frac{\kappa}{2} (J - 1)^2

    with :math:`\bar I_2 = J^{-4/3} \, \mathrm{tr}(\mathrm{cof}\, C)`. Source: Mooney (1940), Rivlin (1948); the volumetric part
    is that of Garbey et al., Eq. (1). Its shear modulus at rest is :math:`2 (c_{10} + c_{01})`.

    Parameters
    ----------
    c10, c01 : float or (...) array [kPa]
        Coefficients of the first and second invariant.
    kappa : float or (...) array [kPa]
        Bulk modulus; 0 if the volume is controlled elsewhere (another law, or incompressibility).
    """

    c10: float | Array = param("kPa", "c_10", low=0.0)
    c01: float | Array = param("kPa", "c_01", low=0.0)
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        J, areas = det(F), cofactor(F)
        I1_bar = J ** (-2.0 / 3.0) * first_invariant(F)
        I2_bar = J ** (-4.0 / 3.0) * jnp.sum(areas * areas, axis=(-2, -1))
        return self.c10 * (I1_bar - 3.0) + self.c01 * (I2_bar - 3.0) + 0.5 * self.kappa * (J - 1.0) ** 2
