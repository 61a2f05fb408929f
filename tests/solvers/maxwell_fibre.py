"""A law with history that can be integrated by hand, for tests of code that advances laws."""

import jax.numpy as jnp
from jax import Array

from cicatrix.core.law import param
from cicatrix.materials.material import EnergyMaterial


class MaxwellFibre(EnergyMaterial):
    """Maxwell branch along x, in logarithmic strain: Psi = E/2 ln(lambda / lambda_v)^2, (ln lambda_v)' = ln(lambda_e) / tau."""

    E: float | Array = param("kPa", "E", low=0.0)
    tau: float | Array = param("s", "tau", low=0.0)

    def energy(self, F, state=()):
        return 0.5 * self.E * (self._strain(F) - state) ** 2

    def initial_state(self, shape):
        return jnp.zeros(shape)

    def advance(self, F, state, dt):
        return (state + dt / self.tau * self._strain(F)) / (1.0 + dt / self.tau)

    def dissipated(self, F, before, after, dt):
        return self.E * (self._strain(F) - after) * (after - before)

    def _strain(self, F):
        return 0.5 * jnp.log(jnp.sum(F[..., :, 0] ** 2, axis=-1))
