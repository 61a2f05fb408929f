"""The force with which a cell pulls at one bond, and how it follows the stiffness of what it pulls at."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, param


class Pulling(NamedTuple):
    """A contraction as a straight line: ``share`` f + ``give`` u = ``drive``, u the displacement of the site [um]."""

    drive: Array | float
    """[pN]."""
    share: Array | float
    """[1]."""
    give: Array | float
    """[pN/um]."""


class Contraction(Protocol):
    """What pulls."""

    def force(self, stiffness: Array) -> Array:
        """Force at a stiffness of the site (...) [pN/um] -> (...) [pN]."""
        ...

    def pulling(self) -> Pulling:
        """The same as a line between force and displacement."""
        ...

    def check(self, stiffness: np.ndarray) -> None:
        """Refuse stiffnesses [pN/um] at which it does not hold."""
        ...


class ConstantForce(Law):
    """The same force at every bond, whatever it pulls at.

    Parameters
    ----------
    f : float or (...) array [pN]
        The force; 5 to 12 pN with 7 in the middle in this group's tables.
    """

    f: float | Array = param("pN", "f", low=0.0)

    def force(self, stiffness: Array) -> Array:
        """f, of the shape of a stiffness (...) [pN/um] -> (...) [pN]."""
        return self.f + jnp.zeros_like(stiffness)

    def pulling(self) -> Pulling:
        """The line of a constant force."""
        return Pulling(self.f, 1.0, 0.0)

    def check(self, stiffness: np.ndarray) -> None:
        """Holds everywhere."""


class Feedback(Law):
    r"""A cell that pulls harder at what is stiffer.

    .. math:: f = \frac{f_0}{1 - \beta + k_a / k_{eff} + k_a / k_N}

    Source: Guo, Mofrad & Buganza Tepole, Eq. (25), after Cao et al. It holds only while the denominator is positive, which the
    print does not say: elsewhere the answer is NaN, and ``check`` says the numbers. Limits: f0 / (1 - beta + k_a / k_N) on what
    is rigid, f0 k_eff / k_a on what is soft.

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
        """Force at a stiffness k_eff (...) [pN/um] -> (...) [pN]; NaN where the feedback does not hold."""
        below = (1.0 - self.beta + self.k_a / self.k_N) * stiffness + self.k_a
        return jnp.where(below > 0.0, self.f0 * stiffness / below, jnp.nan)

    def pulling(self) -> Pulling:
        """(1 - beta + k_a / k_N) f + k_a u = f0, with k_eff = f / u."""
        return Pulling(self.f0, 1.0 - self.beta + self.k_a / self.k_N, self.k_a)

    def check(self, stiffness: np.ndarray) -> None:
        """Refuse stiffnesses k_eff [pN/um] at which the denominator of Eq. (25) is not positive.

        Raises
        ------
        InputError
            With the numbers.
        """
        below = 1.0 - np.asarray(self.beta) + np.asarray(self.k_a) * (1.0 / stiffness + 1.0 / np.asarray(self.k_N))
        if not np.all(below > 0.0):
            k = np.broadcast_to(stiffness, below.shape)[~(below > 0.0)].flat[0]
            raise InputError(
                f"feedback does not hold: 1 - beta + k_a / k_eff + k_a / k_N must be positive; got {np.min(below):.4g} at "
                f"k_eff = {k:.4g} pN/um (beta {np.max(self.beta):g}, k_a {np.min(self.k_a):g}, k_N {np.max(self.k_N):g} pN/um)"
            )
