"""Ogden's law."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import param
from ..numerics.spectral import invariant
from ..numerics.tensors import det, right_cauchy_green
from .material import EnergyMaterial, State

SMALLEST = 1e-3  # smallest absolute value of the exponent; with smaller values the energy is lost in round-off


class Ogden(EnergyMaterial):
    r"""One term of Ogden's energy; the full law is a sum of several terms.

    .. math:: \Psi = \frac{2 \mu}{\alpha^2} (\bar\lambda_1^\alpha + \bar\lambda_2^\alpha + \bar\lambda_3^\alpha - 3)
        + \frac{\kappa}{2} (J - 1)^2

    :math:`\bar\lambda_i = J^{-1/3} \lambda_i` are the isochoric principal stretches. Source: Ogden (1972), with his
    :math:`\mu_p \alpha_p / 2` written as the shear modulus :math:`\mu` that the term has at rest, which must not be negative: a
    sum of such terms is stable (Ogden's inequality). :math:`\alpha = 2` is neo-Hookean.

    Parameters
    ----------
    mu : float or (...) array [kPa]
        Shear modulus at rest.
    alpha : float or (...) array [1]
        Exponent of the stretches, of either sign, not 0.
    kappa : float or (...) array [kPa]
        Bulk modulus; 0 if the volume is controlled elsewhere (another law, or incompressibility).
    """

    mu: float | Array = param("kPa", "mu", low=0.0)
    alpha: float | Array = param("1", "alpha", low=-50.0, high=50.0)
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)

    def __check_init__(self):
        super().__check_init__()
        if isinstance(self.alpha, (int, float, np.ndarray)) and np.any(np.abs(self.alpha) < SMALLEST):
            raise InputError(f"Ogden.alpha (alpha) must not be within {SMALLEST:g} of 0; got {self.alpha}.")

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        J = det(F)
        alpha = jnp.broadcast_to(jnp.asarray(self.alpha, float), J.shape)
        total = invariant(_powers, right_cauchy_green(F), 0.5 * alpha)
        shape = 2.0 * self.mu / alpha**2 * (J ** (-alpha / 3.0) * total - 3.0)
        return shape + 0.5 * self.kappa * (J - 1.0) ** 2


def _powers(c: Array, exponent: Array) -> Array:
    return jnp.sum(c ** exponent[..., None], axis=-1)
