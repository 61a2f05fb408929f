"""Neo-Hookean law of breast tissue."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.tensors import IDENTITY, cofactor, det, first_invariant, product
from .material import EnergyMaterial, Response, State


class NeoHookean(EnergyMaterial):
    r"""Nearly incompressible neo-Hookean energy used for breast tissue.

    .. math:: \Psi = \frac{\mu}{2} (\bar I_1 - 3) + \frac{\kappa}{2} (J - 1)^2, \qquad \bar I_1 = J^{-2/3} \, \mathrm{tr}\, F^T F

    Source: Garbey et al., Multi-scale modeling and computational surgery, Eq. (1).

    Parameters
    ----------
    mu : float or (...) array [kPa]
        Initial shear modulus.
    kappa : float or (...) array [kPa]
        Bulk modulus; 0 if the volume is controlled elsewhere (another law, or incompressibility).
    """

    mu: float | Array = param("kPa", "mu", low=0.0)
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        J = det(F)
        I1_bar = J ** (-2.0 / 3.0) * first_invariant(F)
        return 0.5 * self.mu * (I1_bar - 3.0) + 0.5 * self.kappa * (J - 1.0) ** 2

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and tangent in closed form, for speed; ``EnergyMaterial.response`` gives the same."""
        C, J = cofactor(F), det(F)
        G, I1 = C / J[..., None, None], first_invariant(F)  # F^-T
        shear, pressure = self.mu * J ** (-2.0 / 3.0), self.kappa * (J - 1.0)
        P = shear[..., None, None] * F + (pressure * J - shear * I1 / 3.0)[..., None, None] * G
        one_way, both_ways = (a[..., :, :, None, None] * b[..., None, None, :, :] for a, b in ((G, G), (G, F)))
        turned = jnp.swapaxes(one_way, -4, -2)  # G_kJ G_iL
        parts = (
            (2.0 / 9.0 * shear * I1 + self.kappa * J * (2.0 * J - 1.0), one_way),
            (shear * I1 / 3.0 - pressure * J, turned),
            (-2.0 / 3.0 * shear, both_ways + F[..., :, :, None, None] * G[..., None, None, :, :]),
            (shear, IDENTITY[:, None, :, None] * IDENTITY[None, :, None, :]),
        )
        return Response(P, sum(factor[..., None, None, None, None] * part for factor, part in parts), state)

    def energy_of_many(self, F: Array, mass: Array, moment: Array) -> Array:
        """Return the sum of m Psi(F N) over cohorts of mass m and natural state N, det N = 1, from their moments.

        F (..., 3, 3) [1], sum of m (...) [1] and of m N N^T (..., 3, 3) [1] -> (...) [kPa].
        """
        J = det(F)
        I1_bar = J ** (-2.0 / 3.0) * jnp.sum(product(F, moment) * F, axis=(-2, -1))
        return 0.5 * self.mu * (I1_bar - 3.0 * mass) + 0.5 * self.kappa * mass * (J - 1.0) ** 2


def moduli_from_young(E, nu):
    """Return the shear and bulk modulus of the linear limit: mu = E / (2 (1 + nu)), kappa = E / (3 (1 - 2 nu)).

    Source: Garbey et al., Eq. (2). E [kPa] and nu [1] broadcast; returns (mu, kappa) [kPa].
    """
    return E / (2.0 * (1.0 + nu)), E / (3.0 * (1.0 - 2.0 * nu))


def young_from_moduli(mu, kappa):
    """Return Young's modulus and Poisson's ratio: E = 9 kappa mu / (3 kappa + mu), nu = (3 kappa - 2 mu) / (6 kappa + 2 mu).

    mu and kappa [kPa] broadcast; returns (E [kPa], nu [1]).
    """
    return 9.0 * kappa * mu / (3.0 * kappa + mu), (3.0 * kappa - 2.0 * mu) / (6.0 * kappa + 2.0 * mu)
