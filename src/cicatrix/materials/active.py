"""Contraction of tissue by its cells."""

from __future__ import annotations

from jax import Array

from ..core.law import param
from ..core.tensors import first_invariant
from .material import EnergyMaterial, State


class Contraction(EnergyMaterial):
    r"""Isotropic contraction: a constant second Piola-Kirchhoff tension S = T I.

    .. math:: \Psi = \frac{T}{2} (\mathrm{tr}\, F^T F - 3), \qquad P = T F

    Not stress-free at rest, on purpose: it is the pull of contractile cells in all directions, the isotropic case of
    the active stress of Guo, Mofrad & Buganza Tepole, Eq. (17), written as an energy so that it composes.

    Parameters
    ----------
    tension : float or (...) array [kPa]
        T; 0 where nothing contracts.
    """

    tension: float | Array = param("kPa", "T", low=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Psi at points: F (..., 3, 3) [1] -> (...) [kPa]; grows when the tissue is stretched against the pull."""
        return 0.5 * self.tension * (first_invariant(F) - 3.0)
