"""Tissue whose stress-free state is not the reference configuration."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..numerics.tensors import det, inv, product
from .material import EnergyMaterial, Material, Response, State


class NaturalConfiguration(EnergyMaterial):
    r"""Any law with a natural (stress-free) configuration that differs from the reference configuration.

    .. math:: F_e = F F_n^{-1}, \qquad \Psi(F) = \det F_n \, \Psi_{law}(F_e)

    Tissue deposited at a deformation F(tau) with deposition stretch G is stress-free at F_n = G^-1 F(tau):
    Guo, Mofrad & Buganza Tepole, Eq. (11), with the inverse that is missing in print. Growth (their Eqs 12-15) is
    the same split with F_n = F_g.

    Parameters
    ----------
    law : Material
        Law, with its energy per volume of the natural configuration.
    F_n : (..., 3, 3) array [1]
        Map from the reference to the natural configuration.
    """

    law: Material
    F_n: Array

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        return det(self.F_n) * self.law.energy(product(F, inv(self.F_n)), state)

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the stress-free volume ratio (...) [1]: det F_n times that of the law."""
        return det(self.F_n) * self.law.volume_at_rest(state)

    def has_potential(self) -> bool:
        """Return whether a step of the law has a potential, so that the tangent is symmetric."""
        return self.law.has_potential()

    def growth_tensor(self, state: State = ()) -> Array:
        """Return F_g F_n, with F_g the growth tensor of the law after its natural configuration: F = F_e F_g F_n."""
        return product(self.law.growth_tensor(state), self.F_n)

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return the initial history of the law at points of a given shape."""
        return self.law.initial_state(shape)

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Return the history of the law after a step dt [s] that ends at F (elastic deformation F_e)."""
        return self.law.advance(product(F, inv(self.F_n)), state, dt)

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress, tangent and new history, transformed from the law's response at its elastic deformation."""
        back, volume = inv(self.F_n), det(self.F_n)[..., None, None]
        answer = self.law.response(product(F, back), state, dt)
        half = sum(answer.A[..., n, None] * back[..., None, None, None, :, n] for n in range(3))
        whole = sum(half[..., :, None, m, :, :] * back[..., None, :, m, None, None] for m in range(3))  # pyright: ignore[reportIndexIssue]
        P = product(answer.P, jnp.swapaxes(back, -1, -2))
        return Response(volume * P, volume[..., None, None] * whole, answer.state)

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Return the dissipation per reference volume: det F_n times that of the law."""
        return det(self.F_n) * self.law.dissipated(product(F, inv(self.F_n)), before, after, dt)
