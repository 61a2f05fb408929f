"""What a bond pulls at, a spring or a column of a material: how far it gives way, and the energy of that."""

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
from .contraction import Contraction

NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)  # of the stored energy along the pull


class Pull(NamedTuple):
    """A site under a cell's force, each (...)."""

    force: Array
    """f [pN]."""
    stiffness: Array
    """k_eff [pN/um]."""
    displacement: Array
    """[um]."""
    work: Array
    """Force times displacement [pN um]."""
    stored: Array
    """What the substrate has taken up beyond the work of its prestress [pN um]."""


class Substrate(Protocol):
    """What a bond pulls at."""

    def pulled(self, contraction: Contraction, stretch: Array, time: Array) -> Pull:
        """Pull at a substrate of stretch (...) [1], for a time (...) [s]."""
        ...


class LinearSubstrate(Law):
    r"""A spring: stored energy :math:`f^2 / 2k` as printed in Guo, Mofrad & Buganza Tepole, Eq. (23), work :math:`f^2 / k`.

    Parameters
    ----------
    k : float or (...) array [pN/um]
        Stiffness, the same at every stretch.
    """

    k: float | Array = param("pN/um", "k", low=1e-12)

    def pulled(self, contraction: Contraction, stretch: Array, time: Array) -> Pull:
        """Pull at it: stretch and time (...), neither of which it heeds."""
        k = self.k + jnp.zeros_like(stretch)
        f = contraction.force(k)
        return Pull(f, k, f / k, f**2 / k, 0.5 * f**2 / k)


class Curve(Protocol):
    """Tension of a material along one axis."""

    def stress(self, stretch: Array) -> Array:
        """First Piola-Kirchhoff stress at a stretch (...) [1] -> (...) [pN/um^2], rising."""
        ...


class ExponentialFibre(Law):
    r"""Fibre that stiffens exponentially.

    .. math:: P = k_1 \lambda \left( e^{k_2 (\lambda^2 - 1)} - 1 \right)

    Collagen and fibrin in this group's tables: PHYSICS section 4 of this project has their numbers.

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
        """P (...) [pN/um^2] at a stretch (...) [1]."""
        return self.k1 * stretch * jnp.expm1(self.k2 * (stretch**2 - 1.0))

    def energy(self, stretch: Array) -> Array:
        """Psi (...) [pN/um^2], whose derivative P is, at a stretch (...) [1]."""
        strain = self.k2 * (stretch**2 - 1.0)
        return self.k1 / (2.0 * self.k2) * (jnp.expm1(strain) - strain)


class TabulatedCurve(Law):
    """Any material's tension along one axis: cubic pieces through values and slopes at equal steps, straight beyond them.

    Parameters
    ----------
    stresses : (n,) array [pN/um^2]
        First Piola-Kirchhoff stress at n equally spaced stretches.
    slopes : (n,) array [pN/um^2]
        Its derivatives there.
    low, high : float [1]
        First and last stretch.

    Raises
    ------
    InputError
        If there are less than two stretches, or slopes that are not of as many.
    """

    stresses: Array = eqx.field(converter=jnp.asarray)
    slopes: Array = eqx.field(converter=jnp.asarray)
    low: float = param("1", "lambda_1", low=0.0)
    high: float = param("1", "lambda_n", low=0.0)

    def __check_init__(self):
        super().__check_init__()
        if len(self.stresses) < 2 or len(self.stresses) != len(self.slopes) or not self.low < self.high:
            raise InputError("TabulatedCurve: must have two stretches or more, and as many stresses as slopes.")

    def stress(self, stretch: Array) -> Array:
        """P (...) [pN/um^2] at a stretch (...) [1]."""
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
    r"""A column of a material under one bond, which pulls it further from where it is stretched to.

    .. math:: A_0 \left[ P(\bar\lambda) - P(\lambda) \right] = f, \qquad
              W = f \, l_0 (\bar\lambda - \lambda), \qquad
              E = A_0 l_0 \left[ \Psi(\bar\lambda) - \Psi(\lambda) - P(\lambda) (\bar\lambda - \lambda) \right]

    with :math:`k_{eff} = A_0 P'(\lambda) / l_0`. Source: the nonlinear energy of Guo, Mofrad & Buganza Tepole, section IV C.
    As printed, :math:`[\Psi(\bar\lambda) - \Psi(\lambda)] A_0 l_0`, it holds the work of the prestress, which the cell does not
    do: the increment is taken instead (docs/decisions/0020). For a straight curve W and E are f^2/k and f^2/2k.

    Parameters
    ----------
    curve : Curve
        Tension of the material along its axis.
    area : float or (...) array [um^2]
        Cross-section A_0 of the column.
    length : float or (...) array [um]
        Its length l_0.
    """

    curve: Curve
    area: float | Array = param("um^2", "A_0", low=1e-12)
    length: float | Array = param("um", "l_0", low=1e-12)

    def stiffness(self, stretch: Array) -> Array:
        """Tangent stiffness k_eff at a stretch (...) [1] -> (...) [pN/um]."""
        _, slope = jax.jvp(self.curve.stress, (stretch,), (jnp.ones_like(stretch),))
        return self.area * slope / self.length

    def pulled(self, contraction: Contraction, stretch: Array, time: Array) -> Pull:
        """Pull at a column of stretch (...) [1]; NaN where its stress does not rise to what the force asks for."""
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
