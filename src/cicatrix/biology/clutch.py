"""Motor and clutch: actin flows back, bonds that grip it stretch, and what they pull at slows the motors down."""

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


class Ground(NamedTuple):
    """What a cell's clutches pull at together, each (g,): a spring, beside a spring and dashpot in series."""

    long: np.ndarray
    """[pN/um]."""
    added: np.ndarray
    """[pN/um]; 0 of a mere spring."""
    viscosity: np.ndarray
    """[pN s/um]."""


class Clutches(NamedTuple):
    """Clutches of g cells, n in each."""

    bound: np.ndarray
    """(g, n) bool."""
    end: np.ndarray
    """Where actin has taken the clutch's far end (g, n) [um]; of closed ones alone."""
    ground: np.ndarray
    """Displacement of the substrate (g,) [um]."""
    flowed: np.ndarray
    """Of its dashpot (g,) [um]."""


class MotorClutch(Law):
    r"""Motors that draw actin over clutches, in balance with the substrate at every instant.

    .. math:: \sum_{closed} k_c (x_i - x_s) = K_l x_s + K_a (x_s - x_v), \qquad \eta \, \dot x_v = K_a (x_s - x_v), \qquad
              \dot x_i = v_u \left( 1 - \frac{F}{n_m F_m} \right)

    F is either side of the balance. A clutch closes at the rate k_on without tension and opens at that of its bond under its own
    force, with the energy of that force over ``reach``. Source: Chan & Odde, Science 322, 1687 (2008), in fixed steps as the
    bonds of Guo, Mofrad & Buganza Tepole, Eqs (20) and (21), who name the model and give no form.

    Parameters
    ----------
    bond : Bond
        Rates of a clutch.
    stiffness : float [pN/um]
        k_c of one clutch.
    reach : float [um]
        Distance to the top of a bond's barrier: kT over the force that makes it open e times as fast.
    motors : float [1]
        How many motors pull, n_m.
    motor_force : float [pN]
        At which one stalls, F_m.
    velocity : float [um/s]
        Of actin without load, v_u.
    """

    bond: Bond
    stiffness: float = param("pN/um", "k_c", low=1e-12)
    reach: float = param("um", "x_b", low=0.0)
    motors: float = param("1", "n_m", low=1e-12)
    motor_force: float = param("pN", "F_m", low=1e-12)
    velocity: float = param("um/s", "v_u", low=0.0)

    def start(self, cells: int, n: int, closed: int = 0) -> Clutches:
        """The first clutches of every cell closed, without tension."""
        bound = np.tile(np.arange(n) < closed, (cells, 1))
        return Clutches(bound, np.zeros((cells, n)), np.zeros(cells), np.zeros(cells))

    def force(self, ground: Ground, now: Clutches) -> np.ndarray:
        """Force between cell and substrate (g,) [pN]."""
        return ground.long * now.ground + ground.added * (now.ground - now.flowed)

    def flow(self, ground: Ground, now: Clutches) -> np.ndarray:
        """Velocity of actin (g,) [um/s]."""
        return self.velocity * (1.0 - self.force(ground, now) / (self.motors * self.motor_force))

    def advance(self, ground: Ground, now: Clutches, dt: float, seed: int, step: int) -> Clutches:
        """Clutches after a step dt [s]; a draw belongs to seed, clutch and step."""
        tension = np.where(now.bound, self.stiffness * (now.end - now.ground[:, None]), 0.0)
        k_off = np.asarray(_k_off(self.bond, tension, tension * self.reach))
        chance = -np.expm1(-dt * np.where(now.bound, k_off, self.bond.k_on))
        word = site_words(seed, np.arange(now.bound.size), step, Phase.CLUTCH)[:, 0].reshape(now.bound.shape)
        bound = now.bound ^ ((word + 0.5) / 2.0**32 < chance)
        end = np.where(now.bound, now.end, now.ground[:, None])
        stall = self.motors * self.motor_force
        flow = _slowed(stall, self.velocity, self.stiffness, ground, now.flowed, bound, end, dt)
        drawn = np.where(bound, end + dt * flow[:, None], 0.0)
        place, flowed = _balanced(self.stiffness, ground, now.flowed, bound, drawn, dt)
        return Clutches(bound, drawn, place, flowed)


def ground_of(stiffness: np.ndarray) -> Ground:
    """A mere spring of a stiffness (g,) [pN/um].

    Raises
    ------
    InputError
        If it is not positive.
    """
    if not np.all(stiffness > 0.0):
        raise InputError(f"the substrate's stiffness must be positive; got {np.min(stiffness):g} pN/um")
    return Ground(stiffness, np.zeros_like(stiffness), np.ones_like(stiffness))


def _slowed(
    stall: float,
    velocity: float,
    k_c: float,
    ground: Ground,
    flowed: np.ndarray,
    bound: np.ndarray,
    end: np.ndarray,
    dt: float,
) -> np.ndarray:
    """Velocity (g,) [um/s] whose force at the end of the step is the one that slows it: stable for steps of any length."""
    still = _force_after(k_c, ground, flowed, bound, end, dt)
    stiffness = _force_after(k_c, ground, flowed, bound, end + bound, dt) - still  # for 1 um of all closed ones
    return velocity * (1.0 - still / stall) / (1.0 + velocity / stall * dt * stiffness)


def _force_after(
    k_c: float, ground: Ground, flowed: np.ndarray, bound: np.ndarray, end: np.ndarray, dt: float
) -> np.ndarray:
    place, after = _balanced(k_c, ground, flowed, bound, end, dt)
    return ground.long * place + ground.added * (place - after)


def _balanced(
    k_c: float, ground: Ground, flowed: np.ndarray, bound: np.ndarray, end: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the substrate and of its dashpot at the end of a step (g,) [um]: backward Euler."""
    give = ground.added * dt / ground.viscosity
    series = ground.added / (1.0 + give)  # force of the added spring: series * (x_s - flowed)
    pull = k_c * np.sum(np.where(bound, end, 0.0), axis=1)
    place = (pull + series * flowed) / (ground.long + series + k_c * bound.sum(axis=1))
    return place, (flowed + give * place) / (1.0 + give)
