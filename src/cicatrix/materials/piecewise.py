"""Material of a body with a healing cavity: scar in the cavity, the original tissue elsewhere."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from .growth import NaturalConfiguration
from .material import EnergyMaterial, Response, State
from .scar import Scar


class PiecewiseMaterial(EnergyMaterial):
    r"""One law for a body with a healing cavity.

    .. math:: \Psi = \begin{cases} \Psi_{scar} & \text{in the cavity} \\ \Psi_{old} + \Psi_{pull} & \text{elsewhere} \end{cases}

    The active stress of cells acts everywhere, so the scar law is evaluated everywhere. Where the original tissue remains, its
    own law describes matrix and collagen, and only the last (active) term of the scar law contributes.

    Parameters
    ----------
    old : EnergyMaterial
        Law of the original tissue; it has no history.
    scar : NaturalConfiguration
        :class:`Scar` law with its natural configuration. In the original tissue this is the
        configuration in which cells sense no strain.
    is_new : (...) bool array
        True where the original tissue has been removed.
    """

    old: EnergyMaterial
    scar: NaturalConfiguration
    is_new: Array

    @classmethod
    def of(cls, old: EnergyMaterial, scar: Scar, F_n: Array, is_new: Array) -> PiecewiseMaterial:
        """Combine both laws, with scar collagen only where ``is_new``; F_n (..., 3, 3) is that of ``NaturalConfiguration``."""
        pulling = Scar(
            *(scar.F_p, scar.A_0, scar.k_0, scar.k_f, scar.k_2, scar.k_v),
            jnp.where(is_new, scar.phi, 0.0),
            scar.tension,
        )
        return cls(old, NaturalConfiguration(pulling, F_n), is_new)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        return jnp.where(self.is_new, 0.0, self.old.energy(F)) + self.scar.energy(F)

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and tangent from the responses of both laws; there is no history."""
        old, scar = self.old.response(F), self.scar.response(F)
        is_new = jnp.asarray(self.is_new)[..., None, None]
        A = jnp.where(is_new[..., None, None], 0.0, old.A) + scar.A
        return Response(jnp.where(is_new, 0.0, old.P) + scar.P, A, state)

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the stress-free volume ratio of the tissue at each point (...) [1]."""
        return jnp.where(self.is_new, self.scar.volume_at_rest(), self.old.volume_at_rest())

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Return shear and bulk modulus of the tissue at each point [kPa]; those of scar are in its natural configuration."""
        pairs = zip(self.scar.law.moduli_at_rest(shape), self.old.moduli_at_rest(shape))
        shear, bulk = (jnp.where(self.is_new, new, old) for new, old in pairs)
        return shear, bulk
