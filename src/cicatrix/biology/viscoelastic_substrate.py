"""Viscoelastic substrate, which creeps under the pull of a cell."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from ..core.law import Law, param
from .contraction import CellContraction
from .substrate import Pull


class StandardLinearSolid(Law):
    r"""Standard linear solid: a spring in parallel with a spring and dashpot in series; a Maxwell fluid if K_l = 0.

    .. math:: f = K_l u + K_a (u - u_v), \qquad \eta \, \dot u_v = K_a (u - u_v), \qquad u_v(0) = 0

    The stiffness relaxes from K_l + K_a to K_l. The substrate is pulled from t = 0 on; bonds that close later share the same
    site, which has then already been displaced. With feedback the cell senses the apparent stiffness k_eff = f / u, so
    force and displacement satisfy the relation of :class:`.contraction.LinearContraction`, and both are exponentials in time in
    closed form. Under a constant force this is creep, u = f / K_l (1 - K_a / (K_l + K_a) e^(-t / tau)) with
    tau = eta (1 / K_l + 1 / K_a). The work is f u; the stored energy is that of the springs.

    Source: the viscoelastic substrate of a motor-clutch model, section 4 of PHYSICS (notes of this project; K_l 8058, K_a 8482
    pN/um, eta 93638 pN s/um); Guo, Mofrad & Buganza Tepole mention substrate viscoelasticity without an equation.

    Parameters
    ----------
    K_long : float or (...) array [pN/um]
        Long-term stiffness K_l; 0 for a Maxwell fluid.
    K_added : float or (...) array [pN/um]
        Stiffness K_a that relaxes.
    viscosity : float or (...) array [pN s/um]
        Viscosity eta of the dashpot.
    """

    K_long: float | Array = param("pN/um", "K_l", low=0.0)
    K_added: float | Array = param("pN/um", "K_a", low=1e-12)
    viscosity: float | Array = param("pN s/um", "eta", low=1e-12)

    def pulled(self, contraction: CellContraction, stretch: Array, time: Array) -> Pull:
        """Return the response to the cell's force after pulling for a time (...) [s]; the stretch (...) [1] is not used."""
        stretch, time = jnp.broadcast_arrays(jnp.asarray(stretch, float), jnp.asarray(time, float))
        drive, share, give = contraction.linear_form()
        whole = share * (self.K_long + self.K_added) + give
        per_second = self.K_added / self.viscosity / whole
        u_v = per_second * drive * _yielded(per_second * (share * self.K_long + give), time)
        u = (drive + share * self.K_added * u_v) / whole
        safe_share = jnp.where(jnp.equal(share, 0.0), 1.0, share)
        f = jnp.where(
            jnp.equal(share, 0.0), self.K_long * u + self.K_added * (u - u_v), (drive - give * u) / safe_share
        )
        u, f = (jnp.where(whole > 0.0, value, jnp.nan) for value in (u, f))
        stored = 0.5 * (self.K_long * u**2 + self.K_added * (u - u_v) ** 2)
        return Pull(f, f / u, u, f * u, stored)


def _yielded(rate: Array, time: Array) -> Array:
    """Return (1 - exp(-rate t)) / rate (...) [s]; t where the rate is 0."""
    x = rate * time
    safe = jnp.where(jnp.abs(x) > 1e-8, x, 1.0)
    return time * jnp.where(jnp.abs(x) > 1e-8, -jnp.expm1(-safe) / safe, 1.0 - 0.5 * x)
