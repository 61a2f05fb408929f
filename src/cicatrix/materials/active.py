"""Active stress: contraction of tissue by its cells, isotropic or along fibres."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import choice, param
from ..numerics.tensors import IDENTITY, first_invariant
from .fibres import ORIENTATIONS, by_moments, stretches
from .material import EnergyMaterial, Response, State
from .orientation import Orientation


class Contraction(EnergyMaterial):
    r"""Isotropic contraction: a constant second Piola-Kirchhoff tension S = T I.

    .. math:: \Psi = \frac{T}{2} (\mathrm{tr}\, F^T F - 3), \qquad P = T F

    The law is deliberately not stress-free at rest: it models the isotropic pull of contractile cells, the isotropic case
    of the active stress of Guo, Mofrad & Buganza Tepole, Eq. (17), written as an energy so that it can be added to other laws.

    Parameters
    ----------
    tension : float or (...) array [kPa]
        T; 0 where no cells contract.
    """

    tension: float | Array = param("kPa", "T", low=0.0)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa].

        It increases with stretch, since stretching does work against the cells' contraction.
        """
        return 0.5 * self.tension * (first_invariant(F) - 3.0)

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and tangent in closed form, without history; ``EnergyMaterial.response`` gives the same."""
        tension = jnp.broadcast_to(self.tension, F.shape[:-2])[..., None, None]
        alike = IDENTITY[:, None, :, None] * IDENTITY[None, :, None, :]
        return Response(tension * F, tension[..., None, None] * alike, state)


class ActiveFibres(EnergyMaterial):
    r"""Active tension of cells along fibres.

    .. math:: \sigma_a = \rho \, t_a \, v \otimes v, \qquad \Psi = T \int \rho_\theta \ln \lambda \, d\theta

    Source: Guo, Mofrad & Buganza Tepole, Eq. (17), v the deformed unit direction of the fibres. With the cell
    density per reference volume, :math:`T = J \rho \, t_a`, this stress is the derivative of the energy for every fibre, so the
    law can be added to others.

    Parameters
    ----------
    tension : float or (...) array [kPa]
        T: cells per reference volume times the traction of one cell.
    orientation : Orientation
        Directions of the fibres.
    """

    tension: float | Array = param("kPa", "rho t_a", low=0.0)
    orientation: Orientation = choice(ORIENTATIONS)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa].

        It increases with stretch, since stretching does work against the cells' contraction.
        """
        stretch, weight = stretches(F, self.orientation)
        return self.tension * jnp.sum(weight * jnp.log(stretch), axis=-1)

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and tangent from moments of the directions; ``EnergyMaterial.response`` gives the same."""
        return Response(*by_moments(F, self.orientation, self.tension, lambda x: 0.5 * jnp.log(x)), state)
