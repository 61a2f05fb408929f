"""Tissue that grows: a growth tensor around any law, and what drives it."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import Law, choice, param
from ..numerics.implicit import solve
from ..numerics.tensors import IDENTITY, along, cofactor, det, inv, product
from .fibres import ORIENTATIONS, stretches
from .material import EnergyMaterial, State
from .orientation import Orientation, VonMises

SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
FULL = jnp.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])  # which of the six each entry of a symmetric tensor is


class Growth(Law):
    r"""How tissue grows, and how fast: :math:`\dot g = s / \tau_g`, a stimulus over a time.

    The stimulus is the elastic stretch less 1, along fibres, of an area or of the volume; where ``homeostatic`` is given it is
    the stress over that one, less 1, and drives the logarithm of g: tissue under pressure would else shrink to less than nothing.

    Parameters
    ----------
    tau : float or (...) array [s]
        Time of growth at a stimulus of 1.
    homeostatic : float or (...) array [kPa], optional
        Cauchy stress at which stress-driven tissue neither grows nor shrinks.
    """

    tau: float | Array = param("s", "tau_g", above=0.0, typed="h")
    homeostatic: float | Array | None = param("kPa", "sigma_h", above=0.0, default=None)

    def initial_state(self, shape: tuple[int, ...]) -> Array:
        """Growth of tissue that has not grown, 1: (*shape, n)."""
        return jnp.ones((*shape, 1))

    def coordinates(self, g: Array) -> Array:
        """The few numbers that the growth tensor follows from: (..., n) -> (..., m)."""
        return g

    def tensor(self, coordinates: Array) -> Array:
        """F_g of them: (..., m) -> (..., 3, 3) [1]."""
        raise NotImplementedError

    def stretched(self, F_e: Array) -> Array:
        """Elastic stretches that drive growth: (..., 3, 3) -> (..., n) [1]."""
        raise NotImplementedError

    def stressed(self, F_e: Array, sigma: Array) -> Array:
        """Stresses that drive growth: (..., 3, 3), (..., 3, 3) [kPa] -> (..., n) [kPa]."""
        raise NotImplementedError


class FibreGrowth(Growth):
    r"""Growth into every fibre direction.

    .. math:: F_g = I + \int \rho \, (\lambda_g - 1) \, V \otimes V \, d\theta, \qquad \dot\lambda_g = (\lambda_s - 1) / \tau_g

    Source: Guo, Mofrad & Buganza Tepole, Eqs (14)-(15); as printed, Eq. (14) is not the identity where nothing has grown.
    Stress-driven, it is the Cauchy stress along the deformed fibre less that along the normal of the first two axes: the
    whole stress of a sheet, which is free along its normal, whatever pressure keeps its volume.

    Parameters
    ----------
    orientation : Orientation
        Directions; their weights are rho.
    """

    orientation: Orientation = choice(ORIENTATIONS, default=VonMises(0.0))

    def initial_state(self, shape: tuple[int, ...]) -> Array:
        """Growth stretch of every direction (*shape, n)."""
        return jnp.ones((*shape, self.orientation.n_directions))

    def coordinates(self, g: Array) -> Array:
        """Entries of F_g (..., 6)."""
        V, weight = self.orientation.directions()
        grown = weight * (g - 1.0)
        return jnp.stack([float(i == j) + jnp.sum(grown * V[..., i] * V[..., j], axis=-1) for i, j in SIX], axis=-1)

    def tensor(self, coordinates: Array) -> Array:
        """(..., 6) -> (..., 3, 3)."""
        return coordinates[..., FULL]

    def stretched(self, F_e: Array) -> Array:
        """lambda_s of every direction (..., n)."""
        return stretches(F_e, self.orientation)[0]

    def stressed(self, F_e: Array, sigma: Array) -> Array:
        """Along every deformed direction (..., n)."""
        V, _ = self.orientation.directions()
        v = along(F_e[..., None, :, :], V)
        pull = jnp.sum(v * along(sigma[..., None, :, :], v), axis=-1) / jnp.sum(v * v, axis=-1)
        return pull - _normal_stress(F_e, sigma)[..., None]


class AreaGrowth(Growth):
    r"""Growth of a sheet in its plane, that of the first two axes.

    .. math:: F_g = \sqrt{g} \, (I - n \otimes n) + n \otimes n, \qquad \dot g = (\theta_e - 1) / \tau_g

    :math:`\theta_e` is the elastic area stretch. Source: Buganza Tepole et al. (2011), of skin. Stress-driven, it is the mean
    Cauchy stress in the plane less that along its normal.
    """

    def tensor(self, coordinates: Array) -> Array:
        """(..., 1) -> (..., 3, 3)."""
        side = jnp.sqrt(coordinates[..., 0])
        return jnp.stack([side, side, jnp.ones_like(side)], axis=-1)[..., None] * IDENTITY

    def stretched(self, F_e: Array) -> Array:
        """(..., 1)."""
        return jnp.linalg.norm(cofactor(F_e)[..., 2], axis=-1)[..., None]

    def stressed(self, F_e: Array, sigma: Array) -> Array:
        """(..., 1)."""
        return (0.5 * (jnp.trace(sigma, axis1=-2, axis2=-1) - 3.0 * _normal_stress(F_e, sigma)))[..., None]


class VolumeGrowth(Growth):
    r"""Growth alike in all directions.

    .. math:: F_g = g^{1/3} I, \qquad \dot g = (J_e - 1) / \tau_g

    Source: Lubarda & Hoger (2002), with this drive. Stress-driven, it is the mean Cauchy stress, which only a law with a bulk
    modulus knows.
    """

    def tensor(self, coordinates: Array) -> Array:
        """(..., 1) -> (..., 3, 3)."""
        return jnp.cbrt(coordinates)[..., None] * IDENTITY

    def stretched(self, F_e: Array) -> Array:
        """(..., 1)."""
        return det(F_e)[..., None]

    def stressed(self, F_e: Array, sigma: Array) -> Array:
        """(..., 1)."""
        return (jnp.trace(sigma, axis1=-2, axis2=-1) / 3.0)[..., None]


class Growing(EnergyMaterial):
    r"""Any law around which tissue grows.

    .. math:: F = F_s F_g, \qquad \Psi = \det F_g \, \Psi_{law}(F_s)

    Source: Guo, Mofrad & Buganza Tepole, Eqs (12)-(13). The step is backward Euler, growth and the law's own history together:
    stable however long it is. Growth adds mass, and energy with it: none of that counts as dissipated.

    Parameters
    ----------
    law : EnergyMaterial
        Per volume of grown tissue, with or without history.
    growth : Growth
        How it grows.
    """

    law: EnergyMaterial
    growth: Growth

    def energy(self, F: Array, state: State = ()) -> Array:
        """Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        F_g = self.growth_tensor(state)
        return det(F_g) * self.law.energy(product(F, inv(F_g)), state[1] if state else ())

    def volume_at_rest(self, state: State = ()) -> Array:
        """Volume ratio of grown tissue, and of its law at rest (...) [1]."""
        return det(self.growth_tensor(state)) * self.law.volume_at_rest(state[1] if state else ())

    def growth_tensor(self, state: State = ()) -> Array:
        """F_g (..., 3, 3)."""
        return self.growth.tensor(self.growth.coordinates(state[0])) if state else IDENTITY

    def has_potential(self) -> bool:
        """No: what drives growth is not what its work would be done by."""
        return False

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Growth and the law's own history."""
        return self.growth.initial_state(shape), self.law.initial_state(shape)

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Grow for dt [s], implicitly: the unknowns are the few numbers that F_g follows from."""
        before, history = state

        def grown(coordinates: Array) -> Array:
            share = self._rate(product(F, inv(self.growth.tensor(coordinates))), history, dt)
            return before + share if self.growth.homeostatic is None else before * jnp.exp(share)

        start = self.growth.coordinates(before)
        g = grown(solve(lambda y: y - self.growth.coordinates(grown(y)), start))
        F_s = product(F, inv(self.growth.tensor(self.growth.coordinates(g))))
        return g, self.law.advance(F_s, history, dt)

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """That of the law, per reference volume."""
        F_g = self.growth_tensor(after)
        return det(F_g) * self.law.dissipated(product(F, inv(F_g)), before[1], after[1], dt)

    def _rate(self, F_s: Array, history: State, dt: float) -> Array:
        """Growth in dt at this elastic deformation (..., n)."""
        growth = self.growth
        share = dt / jnp.asarray(growth.tau)[..., None]
        if growth.homeostatic is None:
            return share * (growth.stretched(F_s) - 1.0)
        P = self.law.stress(F_s, self.law.advance(F_s, history, dt))
        sigma = product(P, jnp.swapaxes(F_s, -1, -2)) / det(F_s)[..., None, None]
        return share * (growth.stressed(F_s, sigma) / jnp.asarray(growth.homeostatic)[..., None] - 1.0)


def _normal_stress(F_e: Array, sigma: Array) -> Array:
    """Cauchy stress along the deformed normal of the first two axes (...) [kPa]."""
    n = cofactor(F_e)[..., 2]
    return jnp.sum(n * along(sigma, n), axis=-1) / jnp.sum(n * n, axis=-1)
