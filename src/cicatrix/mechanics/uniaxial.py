r"""Uniaxial tension curve of a material law: stretch along x, no lateral stress, too fast for viscous flow or growth.

.. math:: P(\lambda) = \frac{d}{d\lambda} \min_y \Psi(\lambda, y), \qquad
          P' = \Psi_{\lambda\lambda} - \Psi_{\lambda y} \Psi_{yy}^{-1} \Psi_{y\lambda}

Here y are the logarithms of the lateral stretches: one unknown if the tissue is incompressible, otherwise two.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..biology.substrate import TabulatedCurve
from ..core.errors import ConvergenceError
from ..core.units import pn_um2_from_kpa
from ..materials.material import Material, has_bulk_modulus
from ..numerics.host import own_exceptions

NODES = 513  # number of stretches in a table; its error is estimated by using only every other one
MAX_ITERATIONS = 200  # maximum number of Newton iterations
MAX_STEP = 0.3  # largest Newton step of a logarithmic stretch
ROUNDING = 1e-13  # round-off error of the energy, relative to the stiffness
STEP_TOLERANCE = 1e-10  # Newton step of a logarithmic stretch below which only one more step is taken


class Tension:
    """Uniaxial tension test of a material law along x; the functions that compute it are compiled once.

    Parameters
    ----------
    law : Material
        Material law, evaluated with its initial history, so without viscous flow or growth. It counts as incompressible unless a
        part of it has a bulk modulus, as in cases of kind "material-point".
    """

    def __init__(self, law: Material):
        self._law = law
        self._across = 2 if has_bulk_modulus(law) else 1
        self._derivatives = jax.jit(jax.vmap(_derivatives, in_axes=(None, 0)))

    def table(self, low: float, high: float) -> tuple[TabulatedCurve, float]:
        """Tabulate the stress between two stretches; also return the error of the table relative to the largest stress.

        Raises
        ------
        ConvergenceError
            If no state without lateral stress is found at some stretch.
        """
        stretch = np.linspace(low, high, NODES)
        stress, slope = (pn_um2_from_kpa(values) for values in self.nominal(stretch))
        coarse = TabulatedCurve(stress[::2], slope[::2], low, high).stress(stretch)
        error = float(np.max(np.abs(np.asarray(coarse) - stress)) / max(np.max(np.abs(stress)), 1e-300))
        return TabulatedCurve(stress, slope, low, high), error

    def nominal(self, stretch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the first Piola-Kirchhoff stress and its slope [kPa] at stretches (n,); raises as ``table``."""
        x = np.column_stack([stretch, *[-0.5 * np.log(stretch)] * self._across])
        energy, g, H = self._at(x)
        size, done = np.full(len(x), MAX_STEP), np.zeros(len(x), bool)
        for _ in range(MAX_ITERATIONS):
            step = _step(g, H)
            length = np.max(np.abs(step), axis=1)
            last = done
            done = done | (length <= STEP_TOLERANCE)
            step *= np.minimum(1.0, size / np.maximum(length, 1e-300))[:, None]
            trial = x.copy()
            trial[:, 1:] += np.where(last[:, None], 0.0, step)
            new = self._at(trial)
            lower = done | (new[0] <= energy + ROUNDING * np.max(np.abs(H), axis=(1, 2)))  # False if it is NaN
            x[lower] = trial[lower]
            energy, g, H = (np.where(_like(lower, old), now, old) for now, old in zip(new, (energy, g, H)))
            size = np.where(lower, np.minimum(2.0 * size, MAX_STEP), 0.5 * np.minimum(size, length))
            if last.all():
                break
        if not (last & np.isfinite(g).all(axis=1)).all():
            at = stretch[int(np.argmin(last & np.isfinite(g).all(axis=1)))]
            raise ConvergenceError(f"No state of the substrate's law was found at a stretch of {at:.6g}.")
        along = np.linalg.solve(H[:, 1:, 1:], H[:, 1:, :1])[..., 0]
        return g[:, 0], H[:, 0, 0] - np.sum(H[:, 0, 1:] * along, axis=1)

    @own_exceptions()
    def _at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        energy, g, H = self._derivatives(self._law, x)
        return np.asarray(energy), np.asarray(g), np.asarray(H)


def _step(g: np.ndarray, H: np.ndarray) -> np.ndarray:
    """Return the Newton step of the lateral log-stretches (n, m), or a descent direction where the energy is not convex.

    g (n, 1 + m) and H (n, 1 + m, 1 + m) are gradient and Hessian of the energy.
    """
    eigenvalues, vectors = np.linalg.eigh(np.where(np.isfinite(H[:, 1:, 1:]), H[:, 1:, 1:], 1.0))
    along = np.einsum("nij,ni->nj", vectors, g[:, 1:])
    return -np.einsum("nij,nj->ni", vectors, along / np.maximum(np.abs(eigenvalues), 1e-300))


def _like(which: np.ndarray, values: np.ndarray) -> np.ndarray:
    return which.reshape(-1, *(1,) * (values.ndim - 1))


def _derivatives(law: Material, x: Array) -> tuple[Array, Array, Array]:
    """Return energy [kPa], gradient and Hessian of a law at x: the stretch, then one or two lateral log-stretches."""

    def energy(x: Array) -> Array:
        stretch = x[0]
        y = jnp.exp(x[1])
        z = jnp.exp(x[2]) if len(x) == 3 else 1.0 / (stretch * y)
        return law.energy(jnp.diag(jnp.stack([stretch, y, z])), law.initial_state(()))

    def gradient(x: Array) -> tuple[Array, tuple[Array, Array]]:
        value, slope = jax.value_and_grad(energy)(x)
        return slope, (value, slope)

    H, (value, slope) = jax.jacfwd(gradient, has_aux=True)(x)
    return value, slope, H
