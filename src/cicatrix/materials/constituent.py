"""Constituent of a constrained mixture, which cells deposit and remove."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, param
from ..numerics.tensors import IDENTITY
from .material import EnergyMaterial, has_bulk_modulus


class Constituent(Law):
    r"""One constituent of a mixture: its strain energy, its deposition and its lifetime.

    .. math:: m = k \, \varphi_0 \left\langle 1 + K_\sigma (\sigma / \sigma_h - 1) \right\rangle, \qquad
        q(s, \tau) = e^{-k (s - \tau)}, \qquad G = g \, a \otimes a + g^{-1/2} (I - a \otimes a)

    Production m per time, surviving fraction q since deposition and isochoric deposition stretch G are those of Humphrey &
    Rajagopal (2002), whom Guo, Mofrad & Buganza Tepole follow in their Eqs (8)-(11); :math:`k = 1 / T`, :math:`\langle x \rangle
    = \max(x, 0)`. An equibiaxial prestretch g in a plane is the same as a prestretch :math:`g^{-2}` along its normal.

    Parameters
    ----------
    law : EnergyMaterial
        Energy per reference volume of the pure constituent, measured from its stress-free configuration. The law must
        resist changes of shape only (the mixture's volume follows its mass) and have no history.
    fraction : float or (...) array [1]
        phi_0, initial mass of the constituent relative to the initial mass of the mixture.
    lifetime : float or (...) array [s], optional
        Mean lifetime T (half-life over ln 2); if omitted, the constituent is neither replaced nor lost, like elastin.
    prestretch : float or (...) array [1]
        g, stretch along a with which the constituent is deposited.
    angle, elevation : float or (...) array [rad]
        Direction a: angle from the first axis in the plane of the first two axes, and elevation out of that plane.
    gain : float or (...) array [1]
        K_sigma: sensitivity of production to sigma, the mean stress of the constituent along R a, the current deposition
        direction; sigma is per mass of the constituent and excludes the mixture's volumetric pressure.
    homeostatic_stress : float or (...) array [kPa], optional
        sigma_h, stress at which production is basal; if omitted, the stress at deposition.

    Raises
    ------
    InputError
        If a parameter is out of range, if the law has a history or a bulk modulus, or if production depends on stress but its
        reference, the stress at deposition, is not tensile.
    """

    law: EnergyMaterial
    fraction: float | Array = param("1", "phi_0", low=0.0, high=1.0)
    lifetime: float | Array | None = param("s", "T", low=1.0, default=None, typed="h")
    prestretch: float | Array = param("1", "g", low=0.1, high=10.0, default=1.0)
    angle: float | Array = param("rad", "gamma", low=-np.pi, high=np.pi, default=0.0, typed="deg")
    elevation: float | Array = param("rad", "theta", low=-np.pi / 2, high=np.pi / 2, default=0.0, typed="deg")
    gain: float | Array = param("1", "K_sigma", low=0.0, default=0.0)
    homeostatic_stress: float | Array | None = param("kPa", "sigma_h", above=0.0, default=None)

    def __check_init__(self):
        if jax.tree.leaves(self.law.initial_state((1,))):
            raise InputError("Constituent.law must be elastic: each cohort would need its own history.")
        if has_bulk_modulus(self.law):
            raise InputError(
                "Constituent.law must have kappa = 0 kPa: give kappa to the mixture, whose volume follows its mass."
            )
        if self.homeostatic_stress is None and _refers_to_nothing(self.gain, self.deposition_stress()):
            raise InputError(
                "Constituent.homeostatic_stress (sigma_h) is needed where gain > 0 and the constituent is deposited without "
                "tension; give sigma_h, or a prestretch above 1."
            )

    def direction(self) -> Array:
        """Return the unit vector a of the deposition direction: (..., 3)."""
        a, e = jnp.broadcast_arrays(jnp.asarray(self.angle), jnp.asarray(self.elevation))
        return jnp.stack([jnp.cos(e) * jnp.cos(a), jnp.cos(e) * jnp.sin(a), jnp.sin(e)], axis=-1)

    def deposition_stretch(self) -> Array:
        """Return the deposition stretch G, from the stress-free to the deposited state, det G = 1: (..., 3, 3)."""
        a = self.direction()
        g = jnp.asarray(self.prestretch)[..., None, None]
        along = a[..., :, None] * a[..., None, :]
        return g * along + (IDENTITY - along) / jnp.sqrt(g)

    def deposition_stress(self) -> Array:
        """Return the Kirchhoff stress along a at deposition, that is at the elastic deformation G (...) [kPa]."""
        return kirchhoff_stress_along(self.law.energy, self.deposition_stretch(), self.direction())

    def deposited(self, survived: Array, stress: Array, lost: Array) -> Array:
        r"""Return the mass deposited in a step that survives to its end (...) [1], relative to the mixture's initial mass.

        Production depends on the mean stress of the whole constituent at the end of the step, the new mass included. This
        implicit equation is quadratic, and its solution stays bounded for any step size. It is exact if that stress does not
        change during the step.

        Parameters
        ----------
        survived : (...) array [1]
            Mass that survives the step.
        stress : (...) array [kPa]
            Mean stress of the surviving mass at the end of the step.
        lost : (...) array [1]
            Lost fraction 1 - q over the step.
        """
        basal = lost * self.fraction
        fresh = self.deposition_stress()
        target = fresh if self.homeostatic_stress is None else self.homeostatic_stress
        target = jnp.where(self.gain > 0.0, target, 1.0)
        old = jnp.maximum(1.0 + self.gain * (stress / target - 1.0), 0.0)
        gap = basal * (1.0 + self.gain * (fresh / target - 1.0)) - survived
        return jnp.where(old > 0.0, 0.5 * (gap + _root(gap * gap + 4.0 * basal * survived * old)), 0.0)


def kirchhoff_stress_along(energy, F: Array, n: Array) -> Array:
    """Return the Kirchhoff stress n . (dPsi/dF F^T) n along a unit vector n (..., 3) at F (..., 3, 3) -> (...) [kPa]."""
    stretching = n[..., :, None] * jnp.sum(n[..., :, None] * F, axis=-2)[..., None, :]  # n n^T F
    return jax.jvp(energy, (F,), (jnp.broadcast_to(stretching, F.shape),))[1]


def _root(x: Array) -> Array:
    """Return the square root of x, with value and derivative 0 where x <= 0."""
    return jnp.where(x > 0.0, jnp.sqrt(jnp.where(x > 0.0, x, 1.0)), 0.0)


def _refers_to_nothing(gain, stress) -> bool:
    known = not any(isinstance(x, jax.core.Tracer) for x in (gain, stress))
    return known and bool(np.any((np.asarray(gain) > 0.0) & (np.asarray(stress) < 1e-9)))
