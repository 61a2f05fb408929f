"""Contractile force of a cell on one bond, and its dependence on the stiffness of the substrate."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, param


class LinearContraction(NamedTuple):
    """Linear relation of force f [pN] and substrate displacement u [um]: ``share`` f + ``give`` u = ``drive``."""

    drive: Array | float
    """Right-hand side of the relation [pN]."""
    share: Array | float
    """Coefficient of the force [1]."""
    give: Array | float
    """Coefficient of the displacement [pN/um]."""


class CellContraction(Protocol):
    """Interface of the contractile force of a cell."""

    def force(self, stiffness: Array) -> Array:
        """Return the force at a substrate stiffness (...) [pN/um] -> (...) [pN]."""
        ...

    def linear_form(self) -> LinearContraction:
        """Return this law as a linear relation between force and displacement."""
        ...

    def check(self, stiffness: np.ndarray) -> None:
        """Raise an error for stiffnesses [pN/um] at which the law is not valid."""
        ...


class ConstantForce(Law):
    """Constant force at every bond, independent of the substrate.

    Parameters
    ----------
    f : float or (...) array [pN]
        Force; 5 to 12 pN in the tables of Buganza Tepole's group, with a middle value of 7 pN.
    """

    f: float | Array = param("pN", "f", low=0.0)

    def force(self, stiffness: Array) -> Array:
        """Return f for every stiffness (...) [pN/um] -> (...) [pN]."""
        return self.f + jnp.zeros_like(stiffness)

    def linear_form(self) -> LinearContraction:
        """Return the relation force = f, independent of the displacement."""
        return LinearContraction(self.f, 1.0, 0.0)

    def check(self, stiffness: np.ndarray) -> None:
        """Accept every stiffness: the law is always valid."""


class Feedback(Law):
    r"""Contractile force that increases with the stiffness of the substrate.

    .. math:: f = \frac{f_0}{1 - \beta + k_a / k_{eff} + k_a / k_N}

    Source: Guo, Mofrad & Buganza Tepole, Eq. (25), after Cao et al. It is valid only while the denominator is positive, which
    the paper does not state: elsewhere the force is NaN, and ``check`` raises an error with the values. Limits:
    f0 / (1 - beta + k_a / k_N) on a rigid substrate, f0 k_eff / k_a on a soft one.

    Parameters
    ----------
    f0 : float or (...) array [pN]
        Force without feedback.
    beta : float or (...) array [1]
        Strength of the feedback.
    k_a, k_N : float or (...) array [pN/um]
        Stiffness of actin and of the nucleus.
    """

    f0: float | Array = param("pN", "f_0", low=0.0)
    beta: float | Array = param("1", "beta", low=0.0)
    k_a: float | Array = param("pN/um", "k_a", low=1e-12)
    k_N: float | Array = param("pN/um", "k_N", low=1e-12)

    def force(self, stiffness: Array) -> Array:
        """Return the force at a stiffness k_eff (...) [pN/um] -> (...) [pN]; NaN where the feedback is not valid."""
        below = (1.0 - self.beta + self.k_a / self.k_N) * stiffness + self.k_a
        return jnp.where(below > 0.0, self.f0 * stiffness / below, jnp.nan)

    def linear_form(self) -> LinearContraction:
        """Return the relation (1 - beta + k_a / k_N) f + k_a u = f0, which follows from k_eff = f / u."""
        return LinearContraction(self.f0, 1.0 - self.beta + self.k_a / self.k_N, self.k_a)

    def check(self, stiffness: np.ndarray) -> None:
        """Raise an error for stiffnesses k_eff [pN/um] at which the denominator of Eq. (25) is not positive.

        Raises
        ------
        InputError
            If there is such a stiffness; the message gives the values.
        """
        below = 1.0 - np.asarray(self.beta) + np.asarray(self.k_a) * (1.0 / stiffness + 1.0 / np.asarray(self.k_N))
        if not np.all(below > 0.0):
            k = np.broadcast_to(stiffness, below.shape)[~(below > 0.0)].flat[0]
            raise InputError(
                f"feedback is not valid: 1 - beta + k_a / k_eff + k_a / k_N must be positive; got {np.min(below):.4g} at "
                f"k_eff = {k:.4g} pN/um (beta {np.max(self.beta):g}, k_a {np.min(self.k_a):g}, k_N {np.max(self.k_N):g} pN/um)"
            )
