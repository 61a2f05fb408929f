"""Cooper's ligaments: slack fibres along a given direction."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from .fibres import at_least_one, by_moments, straight_fibre, stretches
from .material import EnergyMaterial, Response, State
from .orientation import Along


class Ligaments(EnergyMaterial):
    r"""Suspensory ligaments of the breast (Cooper's): fibres that carry load once they are pulled straight.

    .. math:: \Psi = \varphi \frac{\mu_f}{2} \left[ \bar\lambda^2 + \frac{2}{\bar\lambda} - 3 \right], \qquad
        \bar\lambda = \max(\lambda / \lambda_w, 1), \qquad \lambda = |F a_0|

    The fibre is that of Guo, Mofrad & Buganza Tepole, Eqs (4)-(5), with one waviness :math:`\lambda_w` for all fibres, times
    their share :math:`\varphi` of the volume. The stress is continuous; the tangent jumps where the fibres become straight.

    Values, uncertain by one to two orders of magnitude: :math:`3 \mu_f` = 120 kPa is the equivalent modulus of pectoral fascia in
    a model of one woman in three positions (Mira et al. 2018); excised ligaments have J-shaped curves (Briot et al. 2022).

    Parameters
    ----------
    share : float or (...) array [1]
        phi, share of the volume that is ligament.
    stiffness : float or (...) array [kPa]
        mu_f: a straight ligament has the modulus 3 mu_f at small strain.
    slack_stretch : float or (...) array [1]
        lambda_w, stretch up to which the ligaments are slack.
    direction : 3 floats or (...) arrays [1]
        Components of a vector along a_0, of any length but 0.
    """

    share: float | Array = param("1", "phi", low=0.0, high=0.02)
    stiffness: float | Array = param("kPa", "mu_f", low=0.0, default=40.0)
    slack_stretch: float | Array = param("1", "lambda_w", low=1.0, high=10.0, default=1.2)
    direction: tuple[float | Array, ...] = param("1", "a_0", default=(1.0, 0.0, 0.0))

    def __check_init__(self):
        super().__check_init__()
        Along(self.direction)  # refuses what is no direction

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        stretch, _ = stretches(F, Along(self.direction))
        return self.share * self.stiffness * self._straightened(stretch**2)[..., 0]

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and tangent by :func:`.fibres.by_moments`, which is cheap."""
        return Response(*by_moments(F, Along(self.direction), self.share * self.stiffness, self._straightened), state)

    def _straightened(self, squared: Array) -> Array:
        """Return the energy of a ligament divided by mu_f, from its squared stretch: (..., 1) -> (..., 1) [1]."""
        slack = jnp.asarray(self.slack_stretch, float)[..., None]
        return straight_fibre(at_least_one(jnp.sqrt(squared) / slack))
