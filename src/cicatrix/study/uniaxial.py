"""Any law of a material point as a curve of tension: stretched along x, free of stress across, faster than it flows or grows."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..biology.substrate import TabulatedCurve
from ..core.errors import ConvergenceError
from ..core.units import pn_um2_from_kpa
from ..materials.material import EnergyMaterial
from ..mechanics.point import Control, Instant, Point, control, history, step
from .laws import has_bulk_modulus

NODES = 513  # of a table; every other one of them tells its error


class Tension:
    """Tension of a law along x; compiled once.

    Parameters
    ----------
    law : EnergyMaterial
        Incompressible unless a part of it has a bulk modulus, as in cases of kind "material-point".
    """

    def __init__(self, law: EnergyMaterial):
        self._law = law
        self._control = control("stretch", "stress", "stress", incompressible=not has_bulk_modulus(law))
        self._nodes = jax.jit(_nodes)

    def table(self, low: float, high: float) -> tuple[TabulatedCurve, float]:
        """Curve between two stretches on both sides of 1, and its error as a share of the largest stress.

        Raises
        ------
        ConvergenceError
            If the law has no state at a stretch.
        """
        stretch = np.linspace(low, high, NODES)
        stress, slope, converged = (np.asarray(a) for a in self._nodes(self._law, self._control, stretch))
        if not converged.all():
            at = stretch[int(np.argmin(converged))]
            raise ConvergenceError(f"No state of the substrate's law was found at a stretch of {at:.6g}.")
        stress, slope = pn_um2_from_kpa(stress), pn_um2_from_kpa(slope)
        coarse = TabulatedCurve(low, high, stress[::2], slope[::2]).stress(stretch)
        error = float(np.max(np.abs(np.asarray(coarse) - stress)) / max(np.max(np.abs(stress)), 1e-300))
        return TabulatedCurve(low, high, stress, slope), error


def _nodes(law: EnergyMaterial, control: Control, stretch: Array) -> tuple[Array, Array, Array]:
    """Nominal stress and its slope [kPa] at stretches (n,) that lead away from 1, and whether they were found."""
    zero = jnp.zeros_like(stretch)
    points = history(law, control, Instant(zero, jnp.stack([stretch, zero, zero], axis=-1), zero))

    def nominal(x: Array, before: Point) -> tuple[Array, Array]:
        after = step(law, control, before, Instant(before.time, jnp.stack([x, 0.0, 0.0]), before.shear))
        return after.stress[0, 0] * after.stretch[1] * after.stretch[2], after.converged

    def at(x: Array, before: Point) -> tuple[Array, Array, Array]:
        value, slope, converged = jax.jvp(lambda y: nominal(y, before), (x,), (jnp.ones_like(x),), has_aux=True)
        return value, slope, converged

    value, slope, converged = jax.vmap(at)(stretch, points)
    return value, slope, converged & points.converged
