r"""Memory of what was laid down when: as cohorts, each with its mass and its natural state.

A cohort laid down at tau carries :math:`F_i = F(s) N`, :math:`N = U(\tau)^{-1} G`. One lifetime serves all cohorts of a
constituent, so nothing but N tells one from another and cohorts of equal N may be one.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from ..core.errors import InputError
from ..numerics.tensors import det, product
from .material import EnergyMaterial, State


class Memory(Protocol):
    """What a constituent remembers of its past."""

    def start(self, mass: Array, natural: Array) -> State:
        """One cohort: mass (...) [1], natural state N (..., 3, 3)."""
        ...

    def mass(self, state: State) -> Array:
        """Mass of all cohorts (...) [1]."""
        ...

    def energy(self, law: EnergyMaterial, F: Array, state: State) -> Array:
        """Energy of all cohorts at F (..., 3, 3) -> (...) [kPa]."""
        ...

    def absorb(
        self, law: EnergyMaterial, F: Array, state: State, survival: Array, mass: Array, natural: Array
    ) -> State:
        """Leave the share ``survival`` of every cohort and add one, in a step that ends at F."""
        ...


class Form(Protocol):
    """How a mixture remembers."""

    def memory(self, law: EnergyMaterial) -> Memory:
        """What suits a constituent of this law."""
        ...


class Cohorts(NamedTuple):
    """Cohorts of one constituent, in no order; empty places have no mass."""

    masses: Array
    """(..., n) [1], in masses of the mixture at first."""
    natural: Array
    """N of each (..., n, 3, 3)."""
    kept: Array
    """How many places are taken for good (...), not more than n; 0 where they are used again."""


class Places(eqx.Module):
    """Cohorts in a fixed number of places.

    Parameters
    ----------
    cohorts : int
        Places.
    """

    cohorts: int = eqx.field(static=True)

    def start(self, mass: Array, natural: Array) -> Cohorts:
        """One cohort of mass (...) and natural state (..., 3, 3), and empty places."""
        masses = jnp.zeros((*mass.shape, self.cohorts)).at[..., 0].set(mass)
        everywhere = jnp.broadcast_to(natural[..., None, :, :], (*mass.shape, self.cohorts, 3, 3))
        return Cohorts(masses, everywhere, jnp.zeros(mass.shape, int))

    def mass(self, state: Cohorts) -> Array:
        """Sum over the cohorts (...) [1]."""
        return jnp.sum(state.masses, axis=-1)

    def energy(self, law: EnergyMaterial, F: Array, state: Cohorts) -> Array:
        """Sum over the cohorts at F (..., 3, 3) -> (...) [kPa]."""
        each = jax.vmap(lambda N: law.energy(product(F, N)), in_axes=-3, out_axes=-1)(state.natural)
        return jnp.sum(state.masses * each, axis=-1)


def _put(state: Cohorts, survival: Array, place: Array, mass: Array, natural: Array) -> Cohorts:
    """Let every cohort decay and put another in one place (...)."""
    here = jnp.arange(state.masses.shape[-1]) == place[..., None]
    masses = jnp.where(here, mass[..., None], survival[..., None] * state.masses)
    return Cohorts(masses, jnp.where(here[..., None, None], natural[..., None, :, :], state.natural), state.kept)


class Exact(Places):
    """Every cohort kept, one per step: the heredity integral itself, for checking what is cheaper.

    Parameters
    ----------
    cohorts : int
        How many can be kept: one per step, and the first.

    Raises
    ------
    InputError
        By ``absorb``, when there is no place left. Compiled code cannot raise: masses become NaN, and :func:`used_up` tells.
    """

    cohorts: int = eqx.field(static=True, default=256)

    def memory(self, law: EnergyMaterial) -> Memory:
        """Itself."""
        return self

    def start(self, mass: Array, natural: Array) -> Cohorts:
        """One cohort, whose place is taken for good."""
        state = super().start(mass, natural)
        return state._replace(kept=state.kept + 1)

    def absorb(
        self, law: EnergyMaterial, F: Array, state: Cohorts, survival: Array, mass: Array, natural: Array
    ) -> Cohorts:
        """Take the next place."""
        is_full = state.kept >= self.cohorts
        if not isinstance(is_full, jax.core.Tracer) and bool(jnp.any(is_full)):
            raise InputError(
                f"Exact.cohorts ({self.cohorts}) is used up: give it one place per step and one more, or use Recursive."
            )
        survival = jnp.where(is_full, jnp.nan, survival)
        return _put(state, survival, state.kept, mass, natural)._replace(kept=state.kept + 1)


def used_up(state: State, more: int = 0) -> int:
    """Places of an exact memory in a law's state that so many more steps would overfill; 0 where there is none."""
    parts = jax.tree.leaves(state, is_leaf=lambda part: isinstance(part, Cohorts))
    memories = [part for part in parts if isinstance(part, Cohorts) and np.any(part.kept)]
    return next((m.masses.shape[-1] for m in memories if np.max(m.kept) + more > m.masses.shape[-1]), 0)


class MergedCohorts(Places):
    """A fixed number of cohorts: before another is added, the two that differ least become one.

    The merged one has their mass and their mean N by mass. Least is the mass-weighted scatter lost, m_1 m_2 / (m_1 + m_2)
    |N_1 - N_2|^2 (Ward 1963): an empty place costs nothing, nor do equal cohorts, so as long as a history has not more
    different natural states than places nothing is lost. Which two is settled before the new one is known, so stress
    stays smooth in F.

    Parameters
    ----------
    cohorts : int
        Places, 2 at least.
    """

    cohorts: int = eqx.field(static=True, default=16)

    def absorb(
        self, law: EnergyMaterial, F: Array, state: Cohorts, survival: Array, mass: Array, natural: Array
    ) -> Cohorts:
        """Merge two, and take the place of the second."""
        n = self.cohorts
        cheapest = jnp.argmin(lax.stop_gradient(_scatter(state)).reshape(*mass.shape, n * n), axis=-1)
        first, second = cheapest // n, cheapest % n
        m_1, N_1 = _taken(state, first)
        m_2, N_2 = _taken(state, second)
        share = m_2 / jnp.where(m_1 + m_2 > 0.0, m_1 + m_2, 1.0)
        merged = _put(state, jnp.ones_like(survival), first, m_1 + m_2, N_1 + share[..., None, None] * (N_2 - N_1))
        decayed = merged._replace(masses=survival[..., None] * merged.masses)
        return _put(decayed, jnp.ones_like(survival), second, mass, natural)


def _scatter(state: Cohorts) -> Array:
    """What merging i and j loses (..., n, n); infinite where not i < j."""
    m, n = state.masses, state.masses.shape[-1]
    apart = state.natural[..., :, None, :, :] - state.natural[..., None, :, :, :]
    both = m[..., :, None] + m[..., None, :]
    weight = m[..., :, None] * m[..., None, :] / jnp.where(both > 0.0, both, 1.0)
    lost = weight * jnp.sum(apart * apart, axis=(-2, -1))
    return jnp.where(jnp.triu(jnp.ones((n, n), bool), 1), lost, jnp.inf)


def _taken(state: Cohorts, place: Array) -> tuple[Array, Array]:
    here = jnp.arange(state.masses.shape[-1]) == place[..., None]
    natural = jnp.where(here[..., None, None], state.natural, 0.0)
    return jnp.sum(jnp.where(here, state.masses, 0.0), axis=-1), jnp.sum(natural, axis=-3)


class Moment(NamedTuple):
    """Mass and second moment of all cohorts of one constituent."""

    total: Array
    """(...) [1]."""
    second: Array
    """Sum of m N N^T, every N scaled to det N = 1 (..., 3, 3) [1]."""


@runtime_checkable
class LinearInShape(Protocol):
    """A law whose energy is linear in J^(-2/3) F^T F, so that of many cohorts follows from their second moment."""

    def energy_of_many(self, F: Array, mass: Array, moment: Array) -> Array:
        """Sum of m Psi(F N): F (..., 3, 3), sum of m (...) and of m N N^T (..., 3, 3), det N = 1 -> (...) [kPa]."""
        ...


class SecondMoment(eqx.Module):
    """The heredity integral without loss, of a law that is linear in J^(-2/3) F^T F."""

    def start(self, mass: Array, natural: Array) -> Moment:
        """The moment of one cohort."""
        shape = natural / jnp.cbrt(det(natural))[..., None, None]
        return Moment(mass, mass[..., None, None] * product(shape, jnp.swapaxes(shape, -1, -2)))

    def mass(self, state: Moment) -> Array:
        """Mass of all cohorts (...) [1]."""
        return state.total

    def energy(self, law: Any, F: Array, state: Moment) -> Array:
        """Energy of all cohorts at F (..., 3, 3) -> (...) [kPa]."""
        return law.energy_of_many(F, state.total, state.second)

    def absorb(self, law: Any, F: Array, state: Moment, survival: Array, mass: Array, natural: Array) -> Moment:
        """Moments decay and add up."""
        fresh = self.start(mass, natural)
        return Moment(survival * state.total + fresh.total, survival[..., None, None] * state.second + fresh.second)


class Recursive(eqx.Module):
    """Fixed memory per point: the second moment where the law allows it, else merged cohorts.

    Parameters
    ----------
    cohorts : int
        Of each constituent whose law is not linear in J^(-2/3) F^T F; 2 at least.
    """

    cohorts: int = eqx.field(static=True, default=16)

    def __check_init__(self):
        if self.cohorts < 2:
            raise InputError(f"Recursive.cohorts must be 2 or more; got {self.cohorts}.")

    def memory(self, law: EnergyMaterial) -> Memory:
        """What loses least."""
        return SecondMoment() if isinstance(law, LinearInShape) else MergedCohorts(self.cohorts)
