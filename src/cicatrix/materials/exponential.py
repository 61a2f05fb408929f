"""Exponential law of soft tissue: neo-Hookean at small strain, stiffer with every further stretch."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.tensors import cofactor, det, first_invariant
from .material import EnergyMaterial, Response, State
from .neo_hookean import NeoHookean

CAP = 12.0  # exponent up to which a law is exponential; e^12 = 163 000
SMALL = 0.3  # exponent below which the series is as exact as the quotient, and has exact derivatives
TERMS = 14  # of the series; the next one is 0.3^14 / 15! < 1e-19


class Exponential(EnergyMaterial):
    r"""Isotropic exponential energy of fat and glandular tissue.

    .. math:: \Psi = \frac{\mu}{2 b} \left( e^{b (\bar I_1 - 3)} - 1 \right) + \frac{\kappa}{2} (J - 1)^2, \qquad
        \bar I_1 = J^{-2/3} \, \mathrm{tr}\, F^T F

    Source: Demiray (1972), A note on the elasticity of soft biological tissues, J. Biomech. 5, 309-311, for an
    incompressible tissue; the volumetric part is that of Garbey et al., Eq. (1). :math:`b = 0` is neo-Hookean, also at some
    points only. Departure: beyond an exponent :math:`q = b (\bar I_1 - 3)` of 12 the exponential goes on as its own
    second-order polynomial, :math:`e^{12} [1 + (q - 12) + (q - 12)^2 / 2]`, so that trial shapes far off have a finite
    energy and a definite tangent; with b = 2 that is a stretch of 2.9.

    Parameters
    ----------
    mu : float or (...) array [kPa]
        Shear modulus at rest.
    b : float or (...) array [1]
        Stiffening: the shear modulus grows by the factor e with every 1/b of :math:`\bar I_1`; 0 is neo-Hookean.
    kappa : float or (...) array [kPa]
        Bulk modulus; 0 if the volume is controlled elsewhere (another law, or incompressibility).
    """

    mu: float | Array = param("kPa", "mu", low=0.0)
    b: float | Array = param("1", "b", low=0.0, high=100.0)
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        J = det(F)
        beyond = J ** (-2.0 / 3.0) * first_invariant(F) - 3.0
        return 0.5 * self.mu * beyond * growth_ratio(self.b * beyond) + 0.5 * self.kappa * (J - 1.0) ** 2

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and tangent in closed form, for speed; ``EnergyMaterial.response`` gives the same.

        They are those of neo-Hookean tissue with the present shear modulus, and the rate of that modulus with F.
        """
        J, I1 = det(F), first_invariant(F)
        scale = J ** (-2.0 / 3.0)
        first, second = growth_rates(self.b * (scale * I1 - 3.0))
        P, A, _ = NeoHookean(self.mu * first, self.kappa).response(F)
        D = scale[..., None, None] * (F - (I1 / (3.0 * J))[..., None, None] * cofactor(F))  # half of dI1_bar/dF
        rate = 2.0 * self.mu * self.b * second
        stiffer = D[..., :, :, None, None] * (rate[..., None, None] * D)[..., None, None, :, :]
        return Response(P, A + stiffer, state)


def capped_expm1(q: Array) -> Array:
    """Return e^q - 1 up to q = 12, and beyond that its second-order polynomial there: (...) [1] -> (...) [1].

    The first two derivatives (:func:`growth_rates`) are continuous and positive for all q.
    """
    below, above = jnp.minimum(q, CAP), jnp.maximum(q - CAP, 0.0)
    return jnp.expm1(below) + jnp.exp(CAP) * above * (1.0 + 0.5 * above)


def growth_rates(q: Array) -> tuple[Array, Array]:
    """Return the first and second derivative of :func:`capped_expm1`: (...) [1] -> (...), (...) [1]."""
    second = jnp.exp(jnp.minimum(q, CAP))
    return second * (1.0 + jnp.maximum(q - CAP, 0.0)), second


def growth_ratio(q: Array) -> Array:
    """Return :func:`capped_expm1` divided by q, which is 1 at q = 0, with exact derivatives everywhere: (...) -> (...) [1]."""
    is_small = jnp.abs(q) < SMALL
    small, large = jnp.where(is_small, q, 0.0), jnp.where(is_small, 1.0, q)
    series = jnp.ones_like(q)
    for n in range(TERMS, 1, -1):  # 1 + q/2 (1 + q/3 (1 + ...))
        series = 1.0 + small / n * series
    return jnp.where(is_small, series, capped_expm1(large) / large)
