"""Law of May-Newman and Yin for a sheet with one family of fibres."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.tensors import along, det, first_invariant
from .material import EnergyMaterial, State


class MayNewman(EnergyMaterial):
    r"""Exponential energy of mitral valve tissue, transversely isotropic about its fibres.

    .. math:: \Psi = c_0 \left( e^{c_1 (\bar I_1 - 3)^2 + c_2 (\lambda - 1)^4} - 1 \right) + \frac{\kappa}{2} (J - 1)^2

    :math:`\lambda = \sqrt{I_4}` is the stretch along the fibres. Source: May-Newman & Yin (1998). It has no stiffness at
    rest, so a body needs an additional law for the ground substance.

    Parameters
    ----------
    c0 : float or (...) array [kPa]
        Scale of the stress.
    c1, c2 : float or (...) array [1]
        Exponents of the stiffening of the tissue and of its fibres.
    angle : float or (...) array [rad]
        Angle of the fibres from the first axis, in the plane of the first two.
    kappa : float or (...) array [kPa]
        Bulk modulus; 0 if the volume is controlled elsewhere (another law, or incompressibility).
    """

    c0: float | Array = param("kPa", "c_0", low=0.0)
    c1: float | Array = param("1", "c_1", low=0.0)
    c2: float | Array = param("1", "c_2", low=0.0)
    angle: float | Array = param("rad", "gamma", low=-jnp.pi, high=jnp.pi, default=0.0, typed="deg")
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        J, angle = det(F), jnp.asarray(self.angle)
        pulled = along(F, jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)], axis=-1))
        stretch = jnp.sqrt(jnp.sum(pulled * pulled, axis=-1))
        I1_bar = J ** (-2.0 / 3.0) * first_invariant(F)
        Q = self.c1 * (I1_bar - 3.0) ** 2 + self.c2 * (stretch - 1.0) ** 4
        return self.c0 * jnp.expm1(Q) + 0.5 * self.kappa * (J - 1.0) ** 2
