"""Mechanosensing law of a cell by Moreo, Garcia-Aznar and Doblare."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, param


class Moreo(Law):
    r"""Stress that a cell senses at a strain of its surroundings: a passive part, and within a range a contractile part.

    .. math:: p = K_{pass} \, \theta + \begin{cases}
        \dfrac{K_{act} \, p_{max}}{K_{act} \theta_1 - p_{max}} (\theta_1 - \theta), & \theta_1 < \theta \le \theta^* \\
        \dfrac{K_{act} \, p_{max}}{K_{act} \theta_2 - p_{max}} (\theta_2 - \theta), & \theta^* < \theta < \theta_2 \end{cases}

    with :math:`\theta^* = p_{max} / K_{act}`, at which the contractile part is :math:`p_{max}`. Source: Guo, Mofrad &
    Buganza Tepole, Eq. (19), after Moreo et al. (2008). The law is continuous only where
    :math:`\theta_1 < \theta^* < \theta_2`, which the paper does not require; other values raise an error.

    Parameters
    ----------
    K_pass, K_act : float or (...) array [kPa]
        Passive stiffness of the cell, and stiffness of its contractile machinery.
    p_max : float or (...) array [kPa]
        Maximum contractile stress.
    theta_1, theta_2 : float or (...) array [1]
        Strains between which the cell contracts.

    Raises
    ------
    InputError
        If one of the inequalities is violated; the message says which.
    """

    K_pass: float | Array = param("kPa", "K_pass", low=0.0)
    K_act: float | Array = param("kPa", "K_act", above=0.0)
    p_max: float | Array = param("kPa", "p_max", low=0.0)
    theta_1: float | Array = param("1", "theta_1")
    theta_2: float | Array = param("1", "theta_2")

    def __check_init__(self):
        super().__check_init__()
        values = (self.theta_1, self.p_max, self.K_act, self.theta_2)
        if not all(isinstance(value, (int, float, np.ndarray)) for value in values):
            return  # traced values inside a JAX transformation; the law was checked when it was created
        peak = np.divide(self.p_max, self.K_act)
        for name, low, high in (
            ("theta_1 < p_max / K_act", self.theta_1, peak),
            ("p_max / K_act < theta_2", peak, self.theta_2),
        ):
            if not np.all(np.less(low, high)):
                raise InputError(f"Moreo: {name} must hold; got {low} and {high}.")

    def signal(self, strain: Array) -> Array:
        """Return the sensed stress p at a strain theta (...) [1] -> (...) [kPa]."""
        peak = self.p_max / self.K_act
        rising = (self.theta_1 - strain) / (self.theta_1 - peak)
        falling = (self.theta_2 - strain) / (self.theta_2 - peak)
        return self.K_pass * strain + self.p_max * jnp.maximum(jnp.minimum(rising, falling), 0.0)
