"""What a tissue is made of, as far as cells lay it down and take it away."""

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
    r"""One constituent of a mixture: how it carries load, how it is laid down, how long it lasts.

    .. math:: m = k \, \varphi_0 \left\langle 1 + K_\sigma (\sigma / \sigma_h - 1) \right\rangle, \qquad
        q(s, \tau) = e^{-k (s - \tau)}, \qquad G = g \, a \otimes a + g^{-1/2} (I - a \otimes a)

    Production m per time, survival q since deposition and deposition stretch G, which keeps volume: Humphrey & Rajagopal
    (2002), whom Guo, Mofrad & Buganza Tepole follow in their Eqs (8)-(11); :math:`k = 1 / T`, :math:`\langle x \rangle =
    \max(x, 0)`. Equal prestretch g across a plane is the one of :math:`g^{-2}` along its normal.

    Parameters
    ----------
    law : EnergyMaterial
        Energy per reference volume of the pure constituent, about the configuration in which it is free of stress. It
        resists changes of shape only (the mixture's volume follows its mass) and has no history of its own.
    fraction : float or (...) array [1]
        phi_0, its mass at first per mass of the mixture.
    lifetime : float or (...) array [s], optional
        Mean life T (half-life over ln 2); left out: it is neither replaced nor lost, as elastin.
    prestretch : float or (...) array [1]
        g, the stretch along a at which it is laid down.
    angle, elevation : float or (...) array [rad]
        Of a about the first axis in the plane of the first two, and out of that plane.
    gain : float or (...) array [1]
        K_sigma: how much production heeds sigma, the constituent's mean stress along R a, the direction in which it is laid
        down now: per its own mass, without the pressure that keeps volume.
    homeostatic_stress : float or (...) array [kPa], optional
        sigma_h, at which production is basal; left out: the stress with which it is laid down.

    Raises
    ------
    InputError
        If a parameter is out of range; if the law has a history or a bulk modulus; if production is to heed stress, but the
        stress at deposition, to which it is to be compared, is not tensile.
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
            raise InputError("Constituent.law must be elastic; each cohort would need a history of its own.")
        if has_bulk_modulus(self.law):
            raise InputError(
                "Constituent.law must have kappa = 0 kPa: give kappa to the mixture, whose volume follows its mass."
            )
        if self.homeostatic_stress is None and _refers_to_nothing(self.gain, self.deposition_stress()):
            raise InputError(
                "Constituent.homeostatic_stress (sigma_h) is needed where gain > 0 and the constituent is laid down without "
                "tension; or give it a prestretch above 1."
            )

    def direction(self) -> Array:
        """Unit vector a along which it is laid down: (..., 3)."""
        a, e = jnp.broadcast_arrays(jnp.asarray(self.angle), jnp.asarray(self.elevation))
        return jnp.stack([jnp.cos(e) * jnp.cos(a), jnp.cos(e) * jnp.sin(a), jnp.sin(e)], axis=-1)

    def deposition_stretch(self) -> Array:
        """G, from free of stress to as laid down, det G = 1: (..., 3, 3)."""
        a = self.direction()
        g = jnp.asarray(self.prestretch)[..., None, None]
        along = a[..., :, None] * a[..., None, :]
        return g * along + (IDENTITY - along) / jnp.sqrt(g)

    def deposition_stress(self) -> Array:
        """Kirchhoff stress along a with which it is laid down (...) [kPa], where nothing of the mixture is strained."""
        return pull(self.law.energy, self.deposition_stretch(), self.direction())

    def deposited(self, survived: Array, stress: Array, lost: Array) -> Array:
        r"""Mass laid down in a step and still there at its end (...) [1], in masses of the mixture.

        Production heeds the mean stress of all that is there at the end of the step, itself included: a quadratic equation,
        which keeps any step bounded. Exact where that stress does not change in the step.

        Parameters
        ----------
        survived : (...) array [1]
            Mass that outlives the step.
        stress : (...) array [kPa]
            Mean stress in it, at the end of the step.
        lost : (...) array [1]
            1 - q over the step.
        """
        basal = lost * self.fraction
        fresh = self.deposition_stress()
        target = fresh if self.homeostatic_stress is None else self.homeostatic_stress
        target = jnp.where(self.gain > 0.0, target, 1.0)
        old = jnp.maximum(1.0 + self.gain * (stress / target - 1.0), 0.0)
        gap = basal * (1.0 + self.gain * (fresh / target - 1.0)) - survived
        return jnp.where(old > 0.0, 0.5 * (gap + _root(gap * gap + 4.0 * basal * survived * old)), 0.0)


def pull(energy, F: Array, n: Array) -> Array:
    """Kirchhoff stress n . (dPsi/dF F^T) n along a unit vector n (..., 3) at F (..., 3, 3) -> (...) [kPa]."""
    stretching = n[..., :, None] * jnp.sum(n[..., :, None] * F, axis=-2)[..., None, :]  # n n^T F
    return jax.jvp(energy, (F,), (jnp.broadcast_to(stretching, F.shape),))[1]


def _root(x: Array) -> Array:
    """Square root with derivative 0 at 0."""
    return jnp.where(x > 0.0, jnp.sqrt(jnp.where(x > 0.0, x, 1.0)), 0.0)


def _refers_to_nothing(gain, stress) -> bool:
    known = not any(isinstance(x, jax.core.Tracer) for x in (gain, stress))
    return known and bool(np.any((np.asarray(gain) > 0.0) & (np.asarray(stress) < 1e-9)))
