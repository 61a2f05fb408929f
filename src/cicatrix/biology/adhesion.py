"""Adhesion of a cell to its substrate: the fraction of closed bonds, and the traction that they transmit."""

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
from .contraction import CellContraction
from .substrate import Substrate

ENERGIES = ("work", "stored")


class AdhesionState(NamedTuple):
    """Load, rates and steady state of an adhesion, each of shape (...)."""

    force: Array
    """Force of one bond [pN]."""
    stiffness: Array
    """Effective stiffness k_eff of the substrate [pN/um]."""
    energy: Array
    """Energy at a bond [pN um]."""
    k_off: Array
    """Opening rate of a bond [1/s]."""
    steady: Array
    """Steady bound fraction, at which as many bonds close as open [1]."""
    traction: Array
    """Traction t_a at the steady bound fraction [kPa]."""


class Adhesion(Law):
    r"""Kinetics of the bonds between a cell and its substrate, and the traction that they transmit.

    .. math:: \dot\phi = k_{on} (1 - \phi) - k_{off} \phi, \qquad t_a = f \phi \rho_i

    Source: Guo, Mofrad & Buganza Tepole, Eqs (20)-(26). All methods are batched over points and differentiable; they return NaN
    where feedback or substrate are not valid. Units are pN, um and s, except for the traction, which is in kPa.

    Parameters
    ----------
    bond : Bond
        Closing and opening rates of a bond.
    substrate : Substrate
        Substrate that the bonds pull on.
    contraction : CellContraction
        Force with which the cell pulls on a bond.
    density : float or (...) array [1/um^2]
        rho_i, number of integrins per area.
    energy : "work" or "stored"
        Energy at a bond: "work" is force times displacement, as in the published tables of Buganza Tepole's group;
        "stored" is the energy stored in the substrate, as printed in Eq. (23). See docs/decisions/0020.
    """

    bond: Bond
    substrate: Substrate
    contraction: CellContraction
    density: float | Array = param("1/um^2", "rho_i", low=0.0)
    energy: Literal["work", "stored"] = eqx.field(static=True, default="work")

    def __check_init__(self):
        super().__check_init__()
        if self.energy not in ENERGIES:
            raise InputError(f'Adhesion.energy must be "work" or "stored"; got "{self.energy}".')

    def steady_state(self, stretch: Array, time: Array | float = 0.0) -> AdhesionState:
        """Return load, rates and steady state on a substrate at a stretch (...) [1], after a time (...) [s] under load."""
        stretch, time = jnp.asarray(stretch, float), jnp.asarray(time, float)
        pull = self.substrate.pulled(self.contraction, stretch, time)
        energy = pull.work if self.energy == "work" else pull.stored
        k_off = self.bond.k_off(pull.force, energy)
        steady = self.bond.k_on / (self.bond.k_on + k_off)
        return AdhesionState(pull.force, pull.stiffness, energy, k_off, steady, self.traction(pull.force, steady))

    def traction(self, force: Array, bound: Array) -> Array:
        """Return t_a = f phi rho_i, Eq. (26): force (...) [pN], bound fraction (...) [1] -> (...) [kPa]."""
        return kpa_from_pn_um2(force * bound * self.density)

    def rate(self, bound: Array, stretch: Array, time: Array | float = 0.0) -> Array:
        """Return the rate of a bound fraction (...) [1], Eq. (24), at a stretch (...) [1] and a time [s] -> (...) [1/s]."""
        return self.bond.k_on * (1.0 - bound) - self.steady_state(stretch, time).k_off * bound

    def step_probabilities(self, dt: float, k_off: Array) -> tuple[Array, Array]:
        """Return the probabilities P_on, P_off that a bond closes or opens in a step dt [s], at an opening rate (...) [1/s].

        Both (...) [1]; Eqs (20), (21).
        """
        return -jnp.expm1(-dt * self.bond.k_on) + jnp.zeros_like(k_off), -jnp.expm1(-dt * k_off)

    def max_k_off(self, stretch: Array, start: float, end: float) -> Array:
        """Return an upper bound of the opening rate between two times [s] on a creeping substrate: stretch (...) -> (...) [1/s].

        While the substrate creeps, force falls and displacement rises; the stored energy is at most half of their product, and
        the rate of a catch bond is convex in force.
        """
        first, last = (self.substrate.pulled(self.contraction, stretch, t) for t in (start, end))
        energy = first.force * last.displacement * (1.0 if self.energy == "work" else 0.5)
        return jnp.maximum(self.bond.k_off(first.force, energy), self.bond.k_off(last.force, energy))


@jax.jit
def steady_state(law: Adhesion, stretch: Array, time: Array | float = 0.0) -> AdhesionState:
    """Evaluate :meth:`Adhesion.steady_state`, compiled once for each type of adhesion and each array shape."""
    return law.steady_state(stretch, time)


@jax.jit
def integrate_bound_fraction(
    law: Adhesion, bound: Array, stretch: Array, start: float, end: float, n_steps: int
) -> Array:
    """Integrate the bound fraction (...) [1] from ``start`` to ``end`` [s] on a time-dependent substrate, in second-order steps.

    Every step is the exact solution for the rates at its midpoint, so any step size is stable. Only forward-mode
    differentiation is supported.
    """
    dt = (end - start) / n_steps

    def step(i: Array, bound: Array) -> Array:
        return relax_bound_fraction(bound, law.bond.k_on, law.steady_state(stretch, start + (i + 0.5) * dt).k_off, dt)

    return lax.fori_loop(0, n_steps, step, bound)


def relax_bound_fraction(bound: Array, k_on: Array | float, k_off: Array, dt: Array | float) -> Array:
    """Return the bound fraction (...) [1] after a time dt [s] at constant rates [1/s]: the solution of Eq. (24)."""
    whole = k_on + k_off
    return bound + (k_on / whole - bound) * -jnp.expm1(-whole * dt)
