"""Law of skin whose tension rises steeply beyond a locking stretch."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.spectral import invariant
from ..numerics.tensors import det, first_invariant, right_cauchy_green
from .exponential import capped_expm1
from .material import EnergyMaterial, State


class LockingSkin(EnergyMaterial):
    r"""Isotropic skin with a J-shaped curve: soft while its collagen is wavy, stiff beyond the locking stretch.

    .. math:: \Psi = \frac{\mu}{2} (\bar I_1 - 3) + \sum_i g(\bar\lambda_i) + \frac{\kappa}{2} (J - 1)^2, \qquad
        g'(\lambda) = \mu_2 \left( e^{d \langle \lambda - \lambda_s \rangle} - 1 \right)

    :math:`\bar\lambda_i = J^{-1/3} \lambda_i` are the isochoric principal stretches, :math:`\langle x \rangle = \max(x, 0)`.
    The stress is continuous; the tangent jumps by :math:`\mu_2 d` at the locking stretch. Beyond an exponent of 12 the
    exponential goes on as its second-order polynomial, as in the exponential law. Sources: the three regions of the curve of skin
    are those of Brown (1973), British Journal of Dermatology 89, 383-393; this form of them is ours.

    Values, uncertain by a factor of three in :math:`\mu_2` and two in d: :math:`\mu_2 d` = 344 (88) kPa is the modulus of
    breast skin under suction in 23 women (Sutradhar & Miller 2013); d = 8 from excised skin of the back, whose slope grows from
    1.2 to 83 MPa up to a strain of 0.54 (Ni Annaidh et al. 2012), ln(83 / 1.2) / 0.54. Skin on the breast is stretched by up to
    1.25-1.60 from supine to upright (Khatam et al. 2015).

    Parameters
    ----------
    mu : float or (...) array [kPa]
        Shear modulus at rest.
    stiff : float or (...) array [kPa]
        mu_2: scale of the stress beyond the locking stretch; 0 is neo-Hookean.
    steepness : float or (...) array [1]
        d: growth of that stress with stretch.
    locking_stretch : float or (...) array [1]
        lambda_s, principal stretch beyond which the skin stiffens.
    kappa : float or (...) array [kPa]
        Bulk modulus; 0 if the volume is controlled elsewhere (another law, or incompressibility).
    """

    mu: float | Array = param("kPa", "mu", low=0.0)
    stiff: float | Array = param("kPa", "mu_2", low=0.0, default=43.0)
    steepness: float | Array = param("1", "d", low=0.01, high=200.0, default=8.0)
    locking_stretch: float | Array = param("1", "lambda_s", low=1.0, high=10.0, default=1.25)
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        J = det(F)
        scale = J ** (-2.0 / 3.0)
        d, locking = (jnp.broadcast_to(jnp.asarray(x, float), J.shape) for x in (self.steepness, self.locking_stretch))
        locked = invariant(_locked, scale[..., None, None] * right_cauchy_green(F), d, locking)
        shape = 0.5 * self.mu * (scale * first_invariant(F) - 3.0) + self.stiff * locked
        return shape + 0.5 * self.kappa * (J - 1.0) ** 2


def _locked(c: Array, d: Array, locking: Array) -> Array:
    """Return the sum of g / mu_2 over the principal stretches, whose squares are c: (..., 3), (...), (...) -> (...) [1]."""
    d = d[..., None]
    q = d * jnp.maximum(jnp.sqrt(c) - locking[..., None], 0.0)
    return jnp.sum((capped_expm1(q) - q) / d, axis=-1)
