"""Motor-clutch model: retrograde flow of actin stretches clutches, whose force on the substrate slows the motors."""

from __future__ import annotations

from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, param
from ..core.random import Phase, site_words
from .bond import Bond


@jax.jit
def _k_off(bond: Bond, force: Array, energy: Array) -> Array:
    return bond.k_off(force, energy)


class ClutchSubstrate(NamedTuple):
    """Substrate of each cell, fields of shape (g,): a spring in parallel with a spring and dashpot in series."""

    long: np.ndarray
    """Long-term stiffness K_l [pN/um]."""
    added: np.ndarray
    """Stiffness K_a of the spring in series with the dashpot [pN/um]; 0 for an elastic substrate."""
    viscosity: np.ndarray
    """Viscosity eta of the dashpot [pN s/um]."""


class Clutches(NamedTuple):
    """State of the clutches and the substrate of g cells, with n clutches per cell."""

    bound: np.ndarray
    """Whether each clutch is closed (g, n) bool."""
    end: np.ndarray
    """Position of the actin end of each clutch (g, n) [um]; meaningless for open clutches."""
    displacement: np.ndarray
    """Displacement of the substrate (g,) [um]."""
    dashpot: np.ndarray
    """Displacement of the substrate's dashpot (g,) [um]."""


class MotorClutch(Law):
    r"""Motor-clutch model of a cell: motors pull actin past the clutches, in force balance with the substrate at all times.

    .. math:: \sum_{closed} k_c (x_i - x_s) = K_l x_s + K_a (x_s - x_v), \qquad \eta \, \dot x_v = K_a (x_s - x_v), \qquad
              \dot x_i = v_u \left( 1 - \frac{F}{n_m F_m} \right)

    F is the force between cell and substrate, equal to either side of the first equation. A clutch closes at the rate k_on
    without tension and opens at the rate of its bond under its own force, at an energy of force times ``reach``.

    Source: Chan & Odde, Science 322, 1687 (2008). Time steps are fixed, as for the bonds of Guo, Mofrad & Buganza Tepole,
    Eqs (20) and (21), who mention the model without an equation.

    Parameters
    ----------
    bond : Bond
        Closing and opening rates of a clutch.
    stiffness : float [pN/um]
        Stiffness k_c of one clutch.
    reach : float [um]
        Distance to the transition state of a bond: kT over the force that raises its opening rate by a factor of e.
    motors : float [1]
        Number of motors n_m.
    motor_force : float [pN]
        Stall force F_m of one motor.
    velocity : float [um/s]
        Velocity v_u of actin without load.
    """

    bond: Bond
    stiffness: float = param("pN/um", "k_c", low=1e-12)
    reach: float = param("um", "x_b", low=0.0)
    motors: float = param("1", "n_m", low=1e-12)
    motor_force: float = param("pN", "F_m", low=1e-12)
    velocity: float = param("um/s", "v_u", low=0.0)

    def start(self, cells: int, n: int, closed: int = 0) -> Clutches:
        """Return the state in which the first ``closed`` of the ``n`` clutches of every cell are closed, without tension."""
        bound = np.tile(np.arange(n) < closed, (cells, 1))
        return Clutches(bound, np.zeros((cells, n)), np.zeros(cells), np.zeros(cells))

    def force(self, substrate: ClutchSubstrate, now: Clutches) -> np.ndarray:
        """Return the force between cell and substrate (g,) [pN]."""
        return substrate.long * now.displacement + substrate.added * (now.displacement - now.dashpot)

    def flow(self, substrate: ClutchSubstrate, now: Clutches) -> np.ndarray:
        """Return the velocity of actin at the present force (g,) [um/s]."""
        return self.velocity * (1.0 - self.force(substrate, now) / (self.motors * self.motor_force))

    def advance(self, substrate: ClutchSubstrate, now: Clutches, dt: float, seed: int, step: int) -> Clutches:
        """Return the state after a step dt [s]; random numbers depend only on seed, clutch and step."""
        tension = np.where(now.bound, self.stiffness * (now.end - now.displacement[:, None]), 0.0)
        k_off = np.asarray(_k_off(self.bond, tension, tension * self.reach))
        chance = -np.expm1(-dt * np.where(now.bound, k_off, self.bond.k_on))
        word = site_words(seed, np.arange(now.bound.size), step, Phase.CLUTCH)[:, 0].reshape(now.bound.shape)
        bound = now.bound ^ ((word + 0.5) / 2.0**32 < chance)
        end = np.where(now.bound, now.end, now.displacement[:, None])
        stall = self.motors * self.motor_force
        flow = _slowed(stall, self.velocity, self.stiffness, substrate, now.dashpot, bound, end, dt)
        drawn = np.where(bound, end + dt * flow[:, None], 0.0)
        place, dashpot = _balanced(self.stiffness, substrate, now.dashpot, bound, drawn, dt)
        return Clutches(bound, drawn, place, dashpot)


def elastic_substrate(stiffness: np.ndarray) -> ClutchSubstrate:
    """Return an elastic substrate of stiffness (g,) [pN/um].

    Raises
    ------
    InputError
        If a stiffness is not positive.
    """
    if not np.all(stiffness > 0.0):
        raise InputError(f"the substrate's stiffness must be positive; got {np.min(stiffness):g} pN/um")
    return ClutchSubstrate(stiffness, np.zeros_like(stiffness), np.ones_like(stiffness))


def _slowed(
    stall: float,
    velocity: float,
    k_c: float,
    substrate: ClutchSubstrate,
    dashpot: np.ndarray,
    bound: np.ndarray,
    end: np.ndarray,
    dt: float,
) -> np.ndarray:
    """Return the actin velocity (g,) [um/s] under the force at the end of a step dt [s]: implicit, so stable at any dt."""
    still = _force_after(k_c, substrate, dashpot, bound, end, dt)
    stiffness = _force_after(k_c, substrate, dashpot, bound, end + bound, dt) - still  # per um of all closed clutches
    return velocity * (1.0 - still / stall) / (1.0 + velocity / stall * dt * stiffness)


def _force_after(
    k_c: float, substrate: ClutchSubstrate, dashpot: np.ndarray, bound: np.ndarray, end: np.ndarray, dt: float
) -> np.ndarray:
    place, after = _balanced(k_c, substrate, dashpot, bound, end, dt)
    return substrate.long * place + substrate.added * (place - after)


def _balanced(
    k_c: float, substrate: ClutchSubstrate, dashpot: np.ndarray, bound: np.ndarray, end: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement of the substrate and of its dashpot at the end of a step (g,) [um], by backward Euler."""
    give = substrate.added * dt / substrate.viscosity
    series = substrate.added / (1.0 + give)  # force of the added spring: series * (x_s - dashpot)
    pull = k_c * np.sum(np.where(bound, end, 0.0), axis=1)
    place = (pull + series * dashpot) / (substrate.long + series + k_c * bound.sum(axis=1))
    return place, (dashpot + give * place) / (1.0 + give)
