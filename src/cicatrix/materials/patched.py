"""Old tissue, and new tissue where the old was taken out."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from .growth import NaturalConfiguration
from .material import EnergyMaterial, Response, State
from .scar import Scar


class Patched(EnergyMaterial):
    r"""One law for a body with a healing cavity.

    .. math:: \Psi = \begin{cases} \Psi_{scar} & \text{in the cavity} \\ \Psi_{old} + \Psi_{pull} & \text{elsewhere} \end{cases}

    The pull of cells is everywhere, so the scar's law is evaluated everywhere; where the old tissue is left, its matrix and
    collagen are that tissue's, and of the scar's law only the last term counts.

    Parameters
    ----------
    old : EnergyMaterial
        Tissue that was there before; it has no history.
    scar : NaturalConfiguration
        Of a :class:`Scar`; where there is old tissue, from the shape in which its cells felt nothing.
    is_new : (...) bool array
        Where the old tissue is gone.
    """

    old: EnergyMaterial
    scar: NaturalConfiguration
    is_new: Array

    @classmethod
    def of(cls, old: EnergyMaterial, scar: Scar, F_n: Array, is_new: Array) -> Patched:
        """Lay the scar into its places; F_n (..., 3, 3) [1] is its natural configuration."""
        pulling = Scar(
            *(scar.F_p, scar.A_0, scar.k_0, scar.k_f, scar.k_2, scar.k_v),
            jnp.where(is_new, scar.phi, 0.0),
            scar.tension,
        )
        return cls(old, NaturalConfiguration(pulling, F_n), is_new)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        return jnp.where(self.is_new, 0.0, self.old.energy(F)) + self.scar.energy(F)

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Stress and tangent from both laws' own answers; no history."""
        old, scar = self.old.response(F), self.scar.response(F)
        is_new = jnp.asarray(self.is_new)[..., None, None]
        A = jnp.where(is_new[..., None, None], 0.0, old.A) + scar.A
        return Response(jnp.where(is_new, 0.0, old.P) + scar.P, A, state)

    def volume_at_rest(self, state: State = ()) -> Array:
        """Of the tissue that is there (...) [1]."""
        return jnp.where(self.is_new, self.scar.volume_at_rest(), self.old.volume_at_rest())

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Of the tissue that is there [kPa]; a scar's in its natural configuration."""
        pairs = zip(self.scar.law.moduli_at_rest(shape), self.old.moduli_at_rest(shape))
        shear, bulk = (jnp.where(self.is_new, new, old) for new, old in pairs)
        return shear, bulk
