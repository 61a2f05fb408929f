"""Cooper's ligaments: slack fibres along a given direction."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import param
from .fibres import FibreDistribution
from .material import EnergyMaterial, Response, State
from .orientation import Along
from .waviness import Uniform


class Ligaments(EnergyMaterial):
    r"""Suspensory ligaments of the breast (Cooper's): fibres that carry load once they are pulled straight.

    .. math:: \Psi = \varphi \frac{\mu_f}{2} \int \rho_w \left[ \bar\lambda^2 + \frac{2}{\bar\lambda} - 3 \right] d\lambda_w,
        \qquad \bar\lambda = \max(\lambda / \lambda_w, 1), \qquad \lambda = |F a_0|

    The fibres are those of Guo, Mofrad & Buganza Tepole, Eqs (4)-(5), along one direction, times their share :math:`\varphi` of
    the volume. They become straight at stretches spread evenly over the slack stretch :math:`\pm w`, but not below 1, which
    makes the tangent continuous.

    Values, uncertain by one to two orders of magnitude: :math:`3 \mu_f` = 120 kPa is the equivalent modulus of pectoral fascia in
    a model of one woman in three positions (Mira et al. 2018); excised ligaments have J-shaped curves (Briot et al. 2022). The
    spread is chosen.

    Parameters
    ----------
    share : float or (...) array [1]
        phi, share of the volume that is ligament.
    stiffness : float or (...) array [kPa]
        mu_f: a straight ligament has the modulus 3 mu_f at small strain.
    slack_stretch : float or (...) array [1]
        Stretch up to which the ligaments are slack.
    spread : float or (...) array [1]
        w, half of the range of stretches over which they become straight.
    direction : 3 floats or (...) arrays [1]
        Components of a vector along a_0, of any length but 0.
    """

    share: float | Array = param("1", "phi", low=0.0, high=0.02)
    stiffness: float | Array = param("kPa", "mu_f", low=0.0, default=40.0)
    slack_stretch: float | Array = param("1", "lambda_w", low=1.0, high=10.0, default=1.225)
    spread: float | Array = param("1", "w", low=0.001, high=1.0, default=0.05)
    direction: tuple[float | Array, ...] = param("1", "a_0", default=(1.0, 0.0, 0.0))

    def __check_init__(self):
        super().__check_init__()
        Along(self.direction)  # refuses what is no direction

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        return self._fibres().energy(F)

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and tangent from moments of the direction, as of other elastic fibres."""
        return self._fibres().response(F)

    def _fibres(self) -> FibreDistribution:
        low = jnp.maximum(jnp.asarray(self.slack_stretch, float) - self.spread, 1.0)
        straight = Uniform(low, self.slack_stretch + self.spread)
        return FibreDistribution(self.share * self.stiffness, Along(self.direction), straight)
