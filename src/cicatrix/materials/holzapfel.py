"""Holzapfel-Gasser-Ogden law, with dispersion of its fibres."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.tensors import along, det, first_invariant
from .material import EnergyMaterial, State


class HolzapfelGasserOgden(EnergyMaterial):
    r"""Two families of dispersed collagen fibres in a neo-Hookean ground substance.

    .. math:: \Psi = \frac{\mu}{2} (\bar I_1 - 3) + \frac{k_1}{2 k_2} \sum_{i=1,2}
        \left( e^{k_2 \langle E_i \rangle^2} - 1 \right)
        + \frac{\kappa}{2} (J - 1)^2, \qquad E_i = d \, (I_1 - 3) + (1 - 3 d) (I_{4i} - 1)

    The families lie at :math:`\pm` ``angle`` about the first axis in the plane of the first two, :math:`\langle E \rangle =
    \max(E, 0)`: they carry tension only. Source: Gasser, Ogden & Holzapfel (2006), Eqs (19)-(22). The source uses the
    isochoric invariants in :math:`E_i`, which lets stretched fibres swell slightly compressible tissue (Helfenstein et al.
    2010); the full invariants are used here (Nolan et al. 2014), which are equal for J = 1.

    Parameters
    ----------
    mu, kappa : float or (...) array [kPa]
        Shear and bulk modulus of the ground substance; kappa is 0 if the volume is controlled elsewhere (another law, or
        incompressibility).
    k1 : float or (...) array [kPa]
        Stiffness of the fibres.
    k2 : float or (...) array [1]
        Exponent of the stiffening of the fibres.
    dispersion : float or (...) array [1]
        d: 0 for fibres aligned with the direction of their family, 1/3 for an isotropic distribution.
    angle : float or (...) array [rad]
        Angle between the first axis and each family; the families lie on opposite sides of the axis.
    """

    mu: float | Array = param("kPa", "mu", low=0.0)
    k1: float | Array = param("kPa", "k_1", low=0.0)
    k2: float | Array = param("1", "k_2", low=1e-6)
    dispersion: float | Array = param("1", "d", low=0.0, high=1.0 / 3.0, default=0.0)
    angle: float | Array = param("rad", "gamma", low=-jnp.pi, high=jnp.pi, default=0.0, typed="deg")
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        J, I1 = det(F), first_invariant(F)
        ground = 0.5 * self.mu * (J ** (-2.0 / 3.0) * I1 - 3.0) + 0.5 * self.kappa * (J - 1.0) ** 2
        return ground + self._family(F, I1, 1.0) + self._family(F, I1, -1.0)

    def _family(self, F: Array, I1: Array, side: float) -> Array:
        angle = jnp.asarray(side * self.angle)
        direction = jnp.stack([jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle)], axis=-1)
        pulled = along(F, direction)
        I4 = jnp.sum(pulled * pulled, axis=-1)
        E = jnp.maximum(self.dispersion * (I1 - 3.0) + (1.0 - 3.0 * self.dispersion) * (I4 - 1.0), 0.0)
        return 0.5 * self.k1 / self.k2 * jnp.expm1(self.k2 * E * E)
