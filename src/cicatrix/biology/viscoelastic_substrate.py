"""A substrate that gives way with time under a cell's pull."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import Law, param
from .contraction import Contraction
from .substrate import Pull


class StandardLinearSolid(Law):
    r"""A spring beside a spring and dashpot in series: it yields from K_l + K_a to K_l; without K_l it is a Maxwell fluid.

    .. math:: f = K_l u + K_a (u - u_v), \qquad \eta \, \dot u_v = K_a (u - u_v), \qquad u_v(0) = 0

    The site is pulled from t = 0 on, and bonds that close later find it where it is then: what they share is the site. With
    feedback the stiffness that the cell feels is the apparent one, k_eff = f / u, so force and displacement lie on the line of
    :class:`.contraction.Pulling` and both are exponentials in time, written out here. Under a constant force that is creep,
    u = f / K_l (1 - K_a / (K_l + K_a) e^(-t / tau)), tau = eta (1 / K_l + 1 / K_a). Work is f u, stored what is in the springs.

    Source: a viscoelastic substrate under motor and clutch, PHYSICS section 4 of this project (K_l 8058, K_a 8482 pN/um,
    eta 93638 pN s/um); Guo, Mofrad & Buganza Tepole name substrate viscoelasticity and give no form.

    Parameters
    ----------
    K_long : float or (...) array [pN/um]
        What remains for good; 0 of a Maxwell fluid.
    K_added : float or (...) array [pN/um]
        What relaxes.
    viscosity : float or (...) array [pN s/um]
        eta.
    """

    K_long: float | Array = param("pN/um", "K_l", low=0.0)
    K_added: float | Array = param("pN/um", "K_a", low=1e-12)
    viscosity: float | Array = param("pN s/um", "eta", low=1e-12)

    def pulled(self, contraction: Contraction, stretch: Array, time: Array) -> Pull:
        """Pull at it for a time (...) [s]; stretch (...) [1], which it does not heed."""
        stretch, time = jnp.broadcast_arrays(jnp.asarray(stretch, float), jnp.asarray(time, float))
        drive, share, give = contraction.pulling()
        whole = share * (self.K_long + self.K_added) + give
        per_second = self.K_added / self.viscosity / whole
        u_v = per_second * drive * _yielded(per_second * (share * self.K_long + give), time)
        u = (drive + share * self.K_added * u_v) / whole
        pulling = jnp.where(jnp.equal(share, 0.0), 1.0, share)
        f = jnp.where(jnp.equal(share, 0.0), self.K_long * u + self.K_added * (u - u_v), (drive - give * u) / pulling)
        u, f = (jnp.where(whole > 0.0, value, jnp.nan) for value in (u, f))
        stored = 0.5 * (self.K_long * u**2 + self.K_added * (u - u_v) ** 2)
        return Pull(f, f / u, u, f * u, stored)


def _yielded(rate: Array, time: Array) -> Array:
    """(1 - exp(-rate t)) / rate (...) [s]; t where the rate is 0."""
    x = rate * time
    safe = jnp.where(jnp.abs(x) > 1e-8, x, 1.0)
    return time * jnp.where(jnp.abs(x) > 1e-8, -jnp.expm1(-safe) / safe, 1.0 - 0.5 * x)
