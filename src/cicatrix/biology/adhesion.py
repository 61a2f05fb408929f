"""A cell's adhesion to what it pulls at: the fraction of its bonds that are closed, and the traction they pass on."""

from __future__ import annotations

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from ..core.errors import InputError
from ..core.law import Law, param
from ..core.units import kpa_from_pn_um2
from .bond import Bond
from .contraction import Contraction
from .substrate import Substrate

ENERGIES = ("work", "stored")


class Anchorage(NamedTuple):
    """Where an adhesion stands, each (...)."""

    force: Array
    """Of one bond [pN]."""
    stiffness: Array
    """k_eff that the cell feels [pN/um]."""
    energy: Array
    """At a bond [pN um]."""
    k_off: Array
    """[1/s]."""
    steady: Array
    """Bound fraction at which as many bonds close as open [1]."""
    traction: Array
    """t_a of the steady bound fraction [kPa]."""


class Adhesion(Law):
    r"""Bonds that close, and open the sooner the more energy their pull puts into the substrate.

    .. math:: \dot\phi = k_{on} (1 - \phi) - k_{off} \phi, \qquad t_a = f \phi \rho_i

    Source: Guo, Mofrad & Buganza Tepole, Eqs (20)-(26). Everything is batched over points and differentiable; NaN tells where
    feedback or substrate do not hold. The cell scale counts in pN, um and s; only traction leaves it, in kPa.

    Parameters
    ----------
    bond : Bond
        Rates of a bond.
    substrate : Substrate
        What it pulls at.
    contraction : Contraction
        How hard.
    density : float or (...) array [1/um^2]
        Integrins per area, rho_i.
    energy : "work" or "stored"
        Whether the energy at a bond is force times displacement, as in this group's published tables, or what the substrate
        stores, as printed in Eq. (23): docs/decisions/0020.
    """

    bond: Bond
    substrate: Substrate
    contraction: Contraction
    density: float | Array = param("1/um^2", "rho_i", low=0.0)
    energy: Literal["work", "stored"] = eqx.field(static=True, default="work")

    def __check_init__(self):
        super().__check_init__()
        if self.energy not in ENERGIES:
            raise InputError(f'Adhesion.energy must be "work" or "stored"; got "{self.energy}".')

    def anchored(self, stretch: Array, time: Array | float = 0.0) -> Anchorage:
        """Rates and steady state on a substrate of stretch (...) [1], pulled at for a time (...) [s]."""
        stretch, time = jnp.asarray(stretch, float), jnp.asarray(time, float)
        pull = self.substrate.pulled(self.contraction, stretch, time)
        energy = pull.work if self.energy == "work" else pull.stored
        k_off = self.bond.k_off(pull.force, energy)
        steady = self.bond.k_on / (self.bond.k_on + k_off)
        return Anchorage(pull.force, pull.stiffness, energy, k_off, steady, self.traction(pull.force, steady))

    def traction(self, force: Array, bound: Array) -> Array:
        """t_a = f phi rho_i, Eq. (26): force (...) [pN], bound fraction (...) [1] -> (...) [kPa]."""
        return kpa_from_pn_um2(force * bound * self.density)

    def rate(self, bound: Array, stretch: Array, time: Array | float = 0.0) -> Array:
        """Rate of the bound fraction, Eq. (24): (...) [1] -> (...) [1/s]."""
        return self.bond.k_on * (1.0 - bound) - self.anchored(stretch, time).k_off * bound

    def chances(self, dt: float, k_off: Array) -> tuple[Array, Array]:
        """P_on and P_off of a bond in a step dt [s], Eqs (20) and (21): rate of opening (...) [1/s] -> (...), (...) [1]."""
        return -jnp.expm1(-dt * self.bond.k_on) + jnp.zeros_like(k_off), -jnp.expm1(-dt * k_off)

    def most_k_off(self, stretch: Array, start: float, end: float) -> Array:
        """Upper bound of the rate of opening on a substrate that yields between two times [s]: stretch (...) -> (...) [1/s].

        Force falls, displacement rises, what is stored is half of their product at most; a catch bond's rate is convex in force.
        """
        first, last = (self.substrate.pulled(self.contraction, stretch, t) for t in (start, end))
        energy = first.force * last.displacement * (1.0 if self.energy == "work" else 0.5)
        return jnp.maximum(self.bond.k_off(first.force, energy), self.bond.k_off(last.force, energy))


@jax.jit
def anchored(law: Adhesion, stretch: Array, time: Array | float = 0.0) -> Anchorage:
    """:meth:`Adhesion.anchored`, compiled once for every kind of adhesion and shape of its points."""
    return law.anchored(stretch, time)


@jax.jit
def carried(law: Adhesion, bound: Array, stretch: Array, start: float, end: float, n_steps: int) -> Array:
    """Bound fraction (...) [1] led from a time to another [s] on a substrate that changes, in steps of second order.

    Every step is the solution for the rates at its middle, so none is too long to be stable. Derivatives are forward ones.
    """
    dt = (end - start) / n_steps

    def onward(i: Array, bound: Array) -> Array:
        return after(bound, law.bond.k_on, law.anchored(stretch, start + (i + 0.5) * dt).k_off, dt)

    return lax.fori_loop(0, n_steps, onward, bound)


def after(bound: Array, k_on: Array | float, k_off: Array, dt: Array | float) -> Array:
    """Bound fraction (...) [1] after a time dt [s] at constant rates [1/s]: the solution of Eq. (24)."""
    whole = k_on + k_off
    return bound + (k_on / whole - bound) * -jnp.expm1(-whole * dt)
