"""Growth of tissue: a growth tensor combined with any law, and the stimuli that drive growth."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.law import Law, choice, param
from ..numerics.implicit import solve
from ..numerics.tensors import IDENTITY, along, cofactor, det, inv, product
from .fibres import ORIENTATIONS, stretches
from .material import EnergyMaterial, State
from .orientation import Orientation, VonMises

SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
FULL = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # index in SIX of each entry of a symmetric tensor


class Growth(Law):
    r"""Base class of growth laws with the rate :math:`\dot g = s / \tau_g`, a stimulus over a time constant.

    The stimulus s is the elastic stretch (along fibres, of an area or of the volume) minus 1. If ``homeostatic`` is given, s
    is the stress divided by ``homeostatic``, minus 1, and drives the logarithm of g, so that g stays positive in compression.

    Parameters
    ----------
    tau : float or (...) array [s]
        Time constant of growth: the rate is 1 / tau at a stimulus of 1.
    homeostatic : float or (...) array [kPa], optional
        Cauchy stress at which stress-driven tissue neither grows nor shrinks.
    """

    tau: float | Array = param("s", "tau_g", above=0.0, typed="h")
    homeostatic: float | Array | None = param("kPa", "sigma_h", above=0.0, default=None)

    def initial_state(self, shape: tuple[int, ...]) -> Array:
        """Return the growth variables g of tissue that has not grown, all 1: (*shape, n)."""
        return jnp.ones((*shape, 1))

    def coordinates(self, g: Array) -> Array:
        """Return the m independent numbers that determine the growth tensor, from the growth variables: (..., n) -> (..., m)."""
        return g

    def tensor(self, coordinates: Array) -> Array:
        """Return F_g from its coordinates: (..., m) -> (..., 3, 3) [1]."""
        raise NotImplementedError

    def stretched(self, F_e: Array) -> Array:
        """Return the elastic stretches that drive growth: (..., 3, 3) -> (..., n) [1]."""
        raise NotImplementedError

    def stressed(self, F_e: Array, sigma: Array) -> Array:
        """Return the stresses that drive growth: (..., 3, 3), (..., 3, 3) [kPa] -> (..., n) [kPa]."""
        raise NotImplementedError


class FibreGrowth(Growth):
    r"""Growth along every fibre direction.

    .. math:: F_g = I + \int \rho \, (\lambda_g - 1) \, V \otimes V \, d\theta, \qquad \dot\lambda_g = (\lambda_s - 1) / \tau_g

    Source: Guo, Mofrad & Buganza Tepole, Eqs (14)-(15); Eq. (14) is corrected here, since as printed it is not the
    identity without growth. The stress that drives growth is the Cauchy stress along the deformed fibre minus that along the
    normal of the plane of the first two axes. This difference does not depend on the pressure of incompressibility; in a
    sheet, which is stress-free along its normal, it is the full fibre stress.

    Parameters
    ----------
    orientation : Orientation
        Directions of the fibres; their weights are rho.
    """

    orientation: Orientation = choice(ORIENTATIONS, default=VonMises(0.0))

    def initial_state(self, shape: tuple[int, ...]) -> Array:
        """Return the growth stretches of tissue that has not grown, 1 in each of n directions: (*shape, n)."""
        return jnp.ones((*shape, self.orientation.n_directions))

    def coordinates(self, g: Array) -> Array:
        """Return the six independent entries of F_g (..., 6), in the order of ``SIX``."""
        V, weight = self.orientation.directions()
        grown = weight * (g - 1.0)
        return jnp.stack([float(i == j) + jnp.sum(grown * V[..., i] * V[..., j], axis=-1) for i, j in SIX], axis=-1)

    def tensor(self, coordinates: Array) -> Array:
        """Return F_g from its six entries: (..., 6) -> (..., 3, 3)."""
        return coordinates[..., FULL]

    def stretched(self, F_e: Array) -> Array:
        """Return the elastic stretch lambda_s along each of n directions: (..., 3, 3) -> (..., n) [1]."""
        return stretches(F_e, self.orientation)[0]

    def stressed(self, F_e: Array, sigma: Array) -> Array:
        """Return the Cauchy stress along each of n deformed directions minus that along the normal: (..., n) [kPa].

        The normal is that of the plane of the first two axes.
        """
        V, _ = self.orientation.directions()
        v = along(F_e[..., None, :, :], V)
        pull = jnp.sum(v * along(sigma[..., None, :, :], v), axis=-1) / jnp.sum(v * v, axis=-1)
        return pull - _normal_stress(F_e, sigma)[..., None]


class AreaGrowth(Growth):
    r"""Growth of a sheet in its plane, the plane of the first two axes.

    .. math:: F_g = \sqrt{g} \, (I - n \otimes n) + n \otimes n, \qquad \dot g = (\theta_e - 1) / \tau_g

    :math:`\theta_e` is the elastic area stretch. Source: Buganza Tepole et al. (2011), for skin. The stress that drives
    growth is the mean Cauchy stress in the plane minus the stress along its normal.
    """

    def tensor(self, coordinates: Array) -> Array:
        """Return F_g from g: (..., 1) -> (..., 3, 3)."""
        side = jnp.sqrt(coordinates[..., 0])
        return jnp.stack([side, side, jnp.ones_like(side)], axis=-1)[..., None] * IDENTITY

    def stretched(self, F_e: Array) -> Array:
        """Return the elastic area stretch theta_e of the plane of the first two axes: (..., 3, 3) -> (..., 1) [1]."""
        return jnp.linalg.norm(cofactor(F_e)[..., 2], axis=-1)[..., None]

    def stressed(self, F_e: Array, sigma: Array) -> Array:
        """Return the mean stress in the plane minus the stress along its normal (..., 1) [kPa]."""
        return (0.5 * (jnp.trace(sigma, axis1=-2, axis2=-1) - 3.0 * _normal_stress(F_e, sigma)))[..., None]


class VolumeGrowth(Growth):
    r"""Isotropic growth of the volume.

    .. math:: F_g = g^{1/3} I, \qquad \dot g = (J_e - 1) / \tau_g

    Source: Lubarda & Hoger (2002), with this stimulus. The stress that drives growth is the mean Cauchy stress, which only a
    law with a bulk modulus determines.
    """

    def tensor(self, coordinates: Array) -> Array:
        """Return F_g from g: (..., 1) -> (..., 3, 3)."""
        return jnp.cbrt(coordinates)[..., None] * IDENTITY

    def stretched(self, F_e: Array) -> Array:
        """Return the elastic volume ratio J_e = det F_e: (..., 3, 3) -> (..., 1) [1]."""
        return det(F_e)[..., None]

    def stressed(self, F_e: Array, sigma: Array) -> Array:
        """Return the mean Cauchy stress (..., 1) [kPa]."""
        return (jnp.trace(sigma, axis1=-2, axis2=-1) / 3.0)[..., None]


class Growing(EnergyMaterial):
    r"""Law of growing tissue: any law combined with a growth tensor.

    .. math:: F = F_s F_g, \qquad \Psi = \det F_g \, \Psi_{law}(F_s)

    Source: Guo, Mofrad & Buganza Tepole, Eqs (12)-(13). A step integrates growth and the law's own history together by
    backward Euler, stable for any step size. The energy of the mass that growth adds is not counted as dissipation.

    Parameters
    ----------
    law : EnergyMaterial
        Law per volume of grown tissue, with or without history.
    growth : Growth
        Growth law.
    """

    law: EnergyMaterial
    growth: Growth

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        F_g = self.growth_tensor(state)
        return det(F_g) * self.law.energy(product(F, inv(F_g)), state[1] if state else ())

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the stress-free volume ratio (...) [1]: det F_g times that of the law."""
        return det(self.growth_tensor(state)) * self.law.volume_at_rest(state[1] if state else ())

    def growth_tensor(self, state: State = ()) -> Array:
        """Return the growth tensor F_g (..., 3, 3)."""
        return self.growth.tensor(self.growth.coordinates(state[0])) if state else jnp.asarray(IDENTITY)

    def has_potential(self) -> bool:
        """Return False: the stimulus is not work-conjugate to growth, so a step has no potential."""
        return False

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return the initial growth variables and the initial history of the law."""
        return self.growth.initial_state(shape), self.law.initial_state(shape)

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Return growth variables and law history after a step dt [s] that ends at F (..., 3, 3) [1], by implicit integration.

        The unknowns of the equations are the independent numbers of F_g (``Growth.coordinates``).
        """
        before, history = state

        def grown(coordinates: Array) -> Array:
            share = self._rate(product(F, inv(self.growth.tensor(coordinates))), history, dt)
            return before + share if self.growth.homeostatic is None else before * jnp.exp(share)

        start = self.growth.coordinates(before)
        g = grown(solve(lambda y: y - self.growth.coordinates(grown(y)), start))
        F_s = product(F, inv(self.growth.tensor(self.growth.coordinates(g))))
        return g, self.law.advance(F_s, history, dt)

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Return the work that the law dissipates in a step, per reference volume (...) [kPa]."""
        F_g = self.growth_tensor(after)
        return det(F_g) * self.law.dissipated(product(F, inv(F_g)), before[1], after[1], dt)

    def _rate(self, F_s: Array, history: State, dt: float) -> Array:
        """Return the increment in dt of g, or of log g if stress drives growth, at elastic deformation F_s (..., n)."""
        growth = self.growth
        share = dt / jnp.asarray(growth.tau)[..., None]
        if growth.homeostatic is None:
            return share * (growth.stretched(F_s) - 1.0)
        P = self.law.stress(F_s, self.law.advance(F_s, history, dt))
        sigma = product(P, jnp.swapaxes(F_s, -1, -2)) / det(F_s)[..., None, None]
        return share * (growth.stressed(F_s, sigma) / jnp.asarray(growth.homeostatic)[..., None] - 1.0)


def _normal_stress(F_e: Array, sigma: Array) -> Array:
    """Return the Cauchy stress along the deformed normal of the plane of the first two axes (...) [kPa]."""
    n = cofactor(F_e)[..., 2]
    return jnp.sum(n * along(sigma, n), axis=-1) / jnp.sum(n * n, axis=-1)
