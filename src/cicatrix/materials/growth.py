"""Tissue whose stress-free state is not the reference configuration."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..numerics.tensors import det, inv, product
from .material import EnergyMaterial, Response, State


class NaturalConfiguration(EnergyMaterial):
    r"""Any law, measured from its own natural (stress-free) configuration.

    .. math:: F_e = F F_n^{-1}, \qquad \Psi(F) = \det F_n \, \Psi_{law}(F_e)

    Tissue laid down at a deformation F(tau) with deposition stretch G is stress-free at F_n = G^-1 F(tau):
    Guo, Mofrad & Buganza Tepole, Eq. (11) with the inverse that its print lost; growth (their Eqs 12-15) is the
    same split with F_n = F_g.

    Parameters
    ----------
    law : EnergyMaterial
        The law per volume of its natural configuration.
    F_n : (..., 3, 3) array [1]
        Reference -> natural configuration.
    """

    law: EnergyMaterial
    F_n: Array

    def energy(self, F: Array, state: State = ()) -> Array:
        """Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        return det(self.F_n) * self.law.energy(product(F, inv(self.F_n)), state)

    def volume_at_rest(self, state: State = ()) -> Array:
        """Volume ratio of the natural configuration (...) [1]."""
        return det(self.F_n) * self.law.volume_at_rest(state)

    def has_potential(self) -> bool:
        """As the law has."""
        return self.law.has_potential()

    def growth_tensor(self, state: State = ()) -> Array:
        """What the law has grown to from its natural configuration, after that: F = F_e F_g F_n."""
        return product(self.law.growth_tensor(state), self.F_n)

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """The law's own history."""
        return self.law.initial_state(shape)

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Advance the law at its elastic deformation."""
        return self.law.advance(product(F, inv(self.F_n)), state, dt)

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Stress, tangent and new history from the law's own answer at its elastic deformation."""
        back, volume = inv(self.F_n), det(self.F_n)[..., None, None]
        answer = self.law.response(product(F, back), state, dt)
        half = sum(answer.A[..., n, None] * back[..., None, None, None, :, n] for n in range(3))
        whole = sum(half[..., :, None, m, :, :] * back[..., None, :, m, None, None] for m in range(3))  # pyright: ignore[reportIndexIssue]
        P = product(answer.P, jnp.swapaxes(back, -1, -2))
        return Response(volume * P, volume[..., None, None] * whole, answer.state)

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """That of the law per volume of its natural configuration, times how much of that there is."""
        return det(self.F_n) * self.law.dissipated(product(F, inv(self.F_n)), before, after, dt)
