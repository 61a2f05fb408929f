"""Substrate of a bond, a spring or a column of material: displacement and energy under the force of a cell."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, param
from ..numerics.roots import rising_root
from .contraction import CellContraction

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)  # Gauss points for the stored energy along the displacement


class Pull(NamedTuple):
    """Response of the substrate to the force of a cell, each of shape (...)."""

    force: Array
    """Force f [pN]."""
    stiffness: Array
    """Effective stiffness k_eff [pN/um]."""
    displacement: Array
    """Displacement of the substrate [um]."""
    work: Array
    """Force times displacement [pN um]."""
    stored: Array
    """Energy stored in the substrate, without the work of its prestress [pN um]."""


class Substrate(Protocol):
    """Interface of the substrate that a bond pulls on."""

    def pulled(self, contraction: CellContraction, stretch: Array, time: Array) -> Pull:
        """Return the substrate's response to the cell's force at a stretch (...) [1], after pulling for a time (...) [s]."""
        ...


class LinearSubstrate(Law):
    r"""Linear spring: stored energy :math:`f^2 / 2k` as printed in Guo, Mofrad & Buganza Tepole, Eq. (23), work :math:`f^2 / k`.

    Parameters
    ----------
    k : float or (...) array [pN/um]
        Stiffness, the same at every stretch.
    """

    k: float | Array = param("pN/um", "k", low=1e-12)

    def pulled(self, contraction: CellContraction, stretch: Array, time: Array) -> Pull:
        """Return the spring's response to the cell's force, which does not depend on stretch and time (...)."""
        k = self.k + jnp.zeros_like(stretch)
        f = contraction.force(k)
        return Pull(f, k, f / k, f**2 / k, 0.5 * f**2 / k)


class Curve(Protocol):
    """Interface of the uniaxial stress-stretch curve of a material."""

    def stress(self, stretch: Array) -> Array:
        """Return the first Piola-Kirchhoff stress at a stretch (...) [1] -> (...) [pN/um^2]; it must increase."""
        ...


class ExponentialFibre(Law):
    r"""Fibre that stiffens exponentially.

    .. math:: P = k_1 \lambda \left( e^{k_2 (\lambda^2 - 1)} - 1 \right)

    Buganza Tepole's group uses this law for collagen and fibrin; section 4 of PHYSICS (notes of this project) lists the values.

    Parameters
    ----------
    k1 : float or (...) array [pN/um^2]
        Stiffness; 1 MPa is 1e6 pN/um^2.
    k2 : float or (...) array [1]
        Exponent.
    """

    k1: float | Array = param("pN/um^2", "k_1", low=1e-12, typed="MPa")
    k2: float | Array = param("1", "k_2", low=1e-12)

    def stress(self, stretch: Array) -> Array:
        """Return P (...) [pN/um^2] at a stretch (...) [1]."""
        return self.k1 * stretch * jnp.expm1(self.k2 * (stretch**2 - 1.0))

    def energy(self, stretch: Array) -> Array:
        """Return the energy Psi (...) [pN/um^2], with derivative P, at a stretch (...) [1]."""
        strain = self.k2 * (stretch**2 - 1.0)
        return self.k1 / (2.0 * self.k2) * (jnp.expm1(strain) - strain)


class TabulatedCurve(Law):
    """Tabulated stress-stretch curve: cubic Hermite interpolation between equally spaced points, linear beyond them.

    Parameters
    ----------
    stresses : (n,) array [pN/um^2]
        First Piola-Kirchhoff stress at n equally spaced stretches.
    slopes : (n,) array [pN/um^2]
        Derivatives of the stress at these stretches.
    low, high : float [1]
        First and last stretch.

    Raises
    ------
    InputError
        If there are fewer than two stretches, if the numbers of stresses and slopes differ, or if ``low`` is not below
        ``high``.
    """

    stresses: Array = eqx.field(converter=jnp.asarray)
    slopes: Array = eqx.field(converter=jnp.asarray)
    low: float = param("1", "lambda_1", low=0.0)
    high: float = param("1", "lambda_n", low=0.0)

    def __check_init__(self):
        super().__check_init__()
        if len(self.stresses) < 2 or len(self.stresses) != len(self.slopes) or not self.low < self.high:
            raise InputError("TabulatedCurve: needs two stretches or more, as many slopes as stresses, and low < high.")

    def stress(self, stretch: Array) -> Array:
        """Return P (...) [pN/um^2] at a stretch (...) [1]."""
        last = len(self.stresses) - 1
        step = (self.high - self.low) / last
        inside = jnp.clip(stretch, self.low, self.high)
        place = (inside - self.low) / step
        i = jnp.clip(place.astype(int), 0, last - 1)
        t = place - i
        rise = self.stresses[i + 1] - self.stresses[i]
        left, right = step * self.slopes[i] - rise, rise - step * self.slopes[i + 1]
        value = self.stresses[i] + t * (rise + (1.0 - t) * (left * (1.0 - t) + right * t))
        slope = jnp.where(stretch <= self.low, self.slopes[0], self.slopes[-1])
        return value + slope * (stretch - inside)


class Column(Law):
    r"""Column of material under one bond; the force of the bond stretches the column beyond its current stretch.

    .. math:: A_0 \left[ P(\bar\lambda) - P(\lambda) \right] = f, \qquad
              W = f \, l_0 (\bar\lambda - \lambda), \qquad
              E = A_0 l_0 \left[ \Psi(\bar\lambda) - \Psi(\lambda) - P(\lambda) (\bar\lambda - \lambda) \right]

    with :math:`k_{eff} = A_0 P'(\lambda) / l_0`. Source: the nonlinear energy of Guo, Mofrad & Buganza Tepole, section IV C.
    The printed form, :math:`[\Psi(\bar\lambda) - \Psi(\lambda)] A_0 l_0`, includes the work of the prestress, which the cell
    does not do; that work is subtracted here (docs/decisions/0020). For a linear curve W and E are f^2/k and f^2/2k.

    Parameters
    ----------
    curve : Curve
        Stress-stretch curve of the material along the axis of the column.
    area : float or (...) array [um^2]
        Cross-section A_0 of the column.
    length : float or (...) array [um]
        Length l_0 of the column.
    """

    curve: Curve
    area: float | Array = param("um^2", "A_0", low=1e-12)
    length: float | Array = param("um", "l_0", low=1e-12)

    def stiffness(self, stretch: Array) -> Array:
        """Return the tangent stiffness k_eff at a stretch (...) [1] -> (...) [pN/um]."""
        _, slope = jax.jvp(self.curve.stress, (stretch,), (jnp.ones_like(stretch),))
        return self.area * slope / self.length

    def pulled(self, contraction: CellContraction, stretch: Array, time: Array) -> Pull:
        """Return the column's response to the cell's force at a stretch (...) [1]; NaN where stress cannot balance the force."""
        stretch = jnp.asarray(stretch, float)
        k = self.stiffness(stretch)
        f = contraction.force(k)
        before = self.curve.stress(stretch)
        linear = stretch + f / (k * self.length)
        pulled = rising_root(lambda x: self.area * (self.curve.stress(x) - before) - f, stretch, linear)
        way = pulled - stretch
        shares = sum(
            0.5 * weight * (self.curve.stress(stretch + 0.5 * (1.0 + node) * way) - before)
            for node, weight in zip(NODES.tolist(), WEIGHTS.tolist())
        )
        return Pull(f, k, self.length * way, f * self.length * way, self.area * self.length * way * shares)
