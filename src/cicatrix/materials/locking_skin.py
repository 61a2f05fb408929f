"""Law of skin whose tension rises steeply beyond a locking stretch."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.spectral import invariant
from ..numerics.tensors import det, first_invariant, right_cauchy_green
from .exponential import CAP
from .material import EnergyMaterial, State


class LockingSkin(EnergyMaterial):
    r"""Isotropic skin with a J-shaped curve: soft while its collagen is wavy, stiff beyond the locking stretch.

    .. math:: \Psi = \frac{\mu}{2} (\bar I_1 - 3) + \sum_i \frac{1}{2 w} \int_{\lambda_s - w}^{\lambda_s + w}
        g(\bar\lambda_i - l) \, dl + \frac{\kappa}{2} (J - 1)^2, \qquad
        g'(x) = \mu_2 \left( e^{d \langle x \rangle} - 1 \right)

    :math:`\bar\lambda_i = J^{-1/3} \lambda_i` are the isochoric principal stretches, :math:`\langle x \rangle = \max(x, 0)`.
    Fibres lock at stretches spread evenly over :math:`\lambda_s \pm w`, which makes the tangent continuous: with one stretch for
    all it would jump by :math:`\mu_2 d`, a hundred times the modulus at rest. Beyond an exponent of 12 the stress goes on along
    its tangent, so that trial shapes far off stay finite. Sources: the three regions of the curve of skin are those of Brown
    (1973), British Journal of Dermatology 89, 383-393; this form of them is ours.

    Values, uncertain by a factor of three in :math:`\mu_2` and two in d: :math:`\mu_2 d` = 344 (88) kPa is the modulus of
    breast skin under suction in 23 women (Sutradhar & Miller 2013); d = 8 from excised skin of the back, whose slope grows from
    1.2 to 83 MPa up to a strain of 0.54 (Ni Annaidh et al. 2012), ln(83 / 1.2) / 0.54. Skin on the breast is stretched by up to
    1.25-1.60 from supine to upright (Khatam et al. 2015). The spread is chosen.

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
    spread : float or (...) array [1]
        w, half of the range of stretches over which the fibres lock.
    kappa : float or (...) array [kPa]
        Bulk modulus; 0 if the volume is controlled elsewhere (another law, or incompressibility).
    """

    mu: float | Array = param("kPa", "mu", low=0.0)
    stiff: float | Array = param("kPa", "mu_2", low=0.0, default=43.0)
    steepness: float | Array = param("1", "d", low=0.01, high=200.0, default=8.0)
    locking_stretch: float | Array = param("1", "lambda_s", low=1.0, high=10.0, default=1.25)
    spread: float | Array = param("1", "w", low=0.001, high=1.0, default=0.05)
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        J = det(F)
        scale = J ** (-2.0 / 3.0)
        where = (self.steepness, self.locking_stretch, self.spread)
        where = (jnp.broadcast_to(jnp.asarray(x, float), J.shape) for x in where)
        locked = invariant(_locked, scale[..., None, None] * right_cauchy_green(F), *where)
        shape = 0.5 * self.mu * (scale * first_invariant(F) - 3.0) + self.stiff * locked
        return shape + 0.5 * self.kappa * (J - 1.0) ** 2


def _locked(c: Array, d: Array, locking: Array, spread: Array) -> Array:
    """Return the sum of the mean of g / mu_2 over the principal stretches, whose squares are c: (..., 3), 3 x (...) -> (...)."""
    d, locking, spread = (x[..., None] for x in (d, locking, spread))
    beyond = jnp.sqrt(c) - locking
    first, last = (_twice_integrated(d * jnp.maximum(beyond + w, 0.0)) for w in (spread, -spread))
    return jnp.sum((first - last) / (2.0 * spread * d * d), axis=-1)


def _twice_integrated(q: Array) -> Array:
    """Return e^q - 1 - q - q^2/2, the second integral of e^q - 1 from 0, or beyond q = 12 of its tangent: (...) -> (...) [1]."""
    above = jnp.maximum(q - CAP, 0.0)
    end = jnp.exp(CAP) * above * (1.0 + above * (0.5 + above / 6.0))
    return jnp.expm1(jnp.minimum(q, CAP)) + end - q * (1.0 + 0.5 * q)
