r"""Deposition history of a constituent, stored as cohorts, each with a mass and a natural (stress-free) state.

A cohort deposited at time tau has the elastic deformation :math:`F_i = F(s) N`, :math:`N = U(\tau)^{-1} G`. All cohorts of a
constituent have the same mean lifetime, so they differ only in N, and cohorts of equal N can be merged.
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
    """Interface of the methods that store the deposition history of one constituent."""

    def start(self, mass: Array, natural: Array) -> State:
        """Return the history that consists of one cohort of mass (...) [1] and natural state N (..., 3, 3)."""
        ...

    def mass(self, state: State) -> Array:
        """Return the total mass of all cohorts (...) [1]."""
        ...

    def energy(self, law: EnergyMaterial, F: Array, state: State) -> Array:
        """Return the total energy of all cohorts at F (..., 3, 3) -> (...) [kPa]."""
        ...

    def absorb(
        self, law: EnergyMaterial, F: Array, state: State, survival: Array, mass: Array, natural: Array
    ) -> State:
        """Return the history after a step that ends at F: every cohort is multiplied by ``survival``, and a new one is added.

        ``survival`` (...) [1] is the fraction that survives the step; the new cohort has ``mass`` (...) [1] and natural state
        ``natural`` (..., 3, 3).
        """
        ...


class Form(Protocol):
    """Method by which a mixture stores its deposition history."""

    def memory(self, law: EnergyMaterial) -> Memory:
        """Return the object that stores the history (:class:`Memory`) of a constituent with this law."""
        ...


class Cohorts(NamedTuple):
    """Cohorts of one constituent, in arbitrary order; empty slots have zero mass."""

    masses: Array
    """Mass of each cohort relative to the initial mass of the mixture (..., n) [1]."""
    natural: Array
    """Natural state N of each cohort (..., n, 3, 3)."""
    n_permanent: Array
    """Number of slots that are filled and never reused (...), at most n; 0 if slots are reused."""


class CohortSlots(eqx.Module):
    """Base class of deposition histories that store cohorts in a fixed number of slots.

    Parameters
    ----------
    cohorts : int
        Number of slots.
    """

    cohorts: int = eqx.field(static=True)

    def start(self, mass: Array, natural: Array) -> Cohorts:
        """Return the history with one cohort of mass (...) and natural state (..., 3, 3); all other slots are empty."""
        masses = jnp.zeros((*mass.shape, self.cohorts)).at[..., 0].set(mass)
        everywhere = jnp.broadcast_to(natural[..., None, :, :], (*mass.shape, self.cohorts, 3, 3))
        return Cohorts(masses, everywhere, jnp.zeros(mass.shape, int))

    def mass(self, state: Cohorts) -> Array:
        """Return the total mass of the cohorts (...) [1]."""
        return jnp.sum(state.masses, axis=-1)

    def energy(self, law: EnergyMaterial, F: Array, state: Cohorts) -> Array:
        """Return the total energy of the cohorts at F (..., 3, 3) -> (...) [kPa]."""
        each = jax.vmap(lambda N: law.energy(product(F, N)), in_axes=-3, out_axes=-1)(state.natural)
        return jnp.sum(state.masses * each, axis=-1)


def _put(state: Cohorts, survival: Array, place: Array, mass: Array, natural: Array) -> Cohorts:
    """Multiply all masses by ``survival`` (...), and store a new cohort in slot number ``place`` (...)."""
    here = jnp.arange(state.masses.shape[-1]) == place[..., None]
    masses = jnp.where(here, mass[..., None], survival[..., None] * state.masses)
    return Cohorts(masses, jnp.where(here[..., None, None], natural[..., None, :, :], state.natural), state.n_permanent)


class Exact(CohortSlots):
    """Exact heredity integral that stores one cohort per step; a reference for the cheaper forms.

    Parameters
    ----------
    cohorts : int
        Number of slots: one per step, plus one for the initial cohort.

    Raises
    ------
    InputError
        From ``absorb``, if no slot is free. Compiled code cannot raise: the masses become NaN instead, and :func:`exceeded_slots`
        detects it.
    """

    cohorts: int = eqx.field(static=True, default=256)

    def memory(self, law: EnergyMaterial) -> Memory:
        """Return this object, which implements :class:`Memory` for any law."""
        return self

    def start(self, mass: Array, natural: Array) -> Cohorts:
        """Return the history with one cohort of mass (...) and natural state (..., 3, 3), whose slot is never reused."""
        state = super().start(mass, natural)
        return state._replace(n_permanent=state.n_permanent + 1)

    def absorb(
        self, law: EnergyMaterial, F: Array, state: Cohorts, survival: Array, mass: Array, natural: Array
    ) -> Cohorts:
        """Return the history with all masses multiplied by ``survival`` and the new cohort in the next free slot."""
        is_full = state.n_permanent >= self.cohorts
        if not isinstance(is_full, jax.core.Tracer) and bool(jnp.any(is_full)):
            raise InputError(
                f"Exact.cohorts ({self.cohorts}) is used up: set it to the number of steps plus one, or use Recursive."
            )
        survival = jnp.where(is_full, jnp.nan, survival)
        return _put(state, survival, state.n_permanent, mass, natural)._replace(n_permanent=state.n_permanent + 1)


def exceeded_slots(state: State, more: int = 0) -> int:
    """Return the number of slots of an :class:`Exact` history if ``more`` further steps would need more slots, otherwise 0.

    ``state`` is the history of a law, of which the Exact history may be a part.
    """
    parts = jax.tree.leaves(state, is_leaf=lambda part: isinstance(part, Cohorts))
    memories = [part for part in parts if isinstance(part, Cohorts) and np.any(part.n_permanent)]
    return next((m.masses.shape[-1] for m in memories if np.max(m.n_permanent) + more > m.masses.shape[-1]), 0)


class MergedCohorts(CohortSlots):
    """Deposition history as a fixed number of cohorts: the two most similar ones are merged before a new one is added.

    The merged cohort has the total mass and the mass-weighted mean N of both. The pair with the smallest loss of
    mass-weighted scatter is chosen, m_1 m_2 / (m_1 + m_2) |N_1 - N_2|^2 (Ward 1963). Merging equal cohorts or using an empty
    slot loses nothing, so the method is exact while there are no more distinct natural states than slots. The pair is chosen
    before the new cohort is known, so the stress stays smooth in F.

    Parameters
    ----------
    cohorts : int
        Number of slots, at least 2.
    """

    cohorts: int = eqx.field(static=True, default=16)

    def absorb(
        self, law: EnergyMaterial, F: Array, state: Cohorts, survival: Array, mass: Array, natural: Array
    ) -> Cohorts:
        """Return the history with the two most similar cohorts merged, and the new cohort in the slot that this frees."""
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
    """Return the scatter that is lost if cohorts i and j are merged (..., n, n); infinite unless i < j."""
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


class CohortMoments(NamedTuple):
    """Mass and second moment of all cohorts of one constituent."""

    total: Array
    """Total mass (...) [1]."""
    second: Array
    """Sum of m N N^T, with every N scaled to det N = 1 (..., 3, 3) [1]."""


@runtime_checkable
class LinearInShape(Protocol):
    """Interface of laws whose energy is linear in J^(-2/3) F^T F: the energy of many cohorts follows from their second moment."""

    def energy_of_many(self, F: Array, mass: Array, moment: Array) -> Array:
        """Return the sum of m Psi(F N): F (..., 3, 3), sums of m (...) and of m N N^T (..., 3, 3), det N = 1 -> (...) [kPa]."""
        ...


class SecondMoment(eqx.Module):
    """Exact heredity integral of a law that is linear in J^(-2/3) F^T F, stored as the second moment of its cohorts."""

    def start(self, mass: Array, natural: Array) -> CohortMoments:
        """Return the moments of one cohort of mass (...) [1] and natural state (..., 3, 3)."""
        shape = natural / jnp.cbrt(det(natural))[..., None, None]
        return CohortMoments(mass, mass[..., None, None] * product(shape, jnp.swapaxes(shape, -1, -2)))

    def mass(self, state: CohortMoments) -> Array:
        """Return the total mass of all cohorts (...) [1]."""
        return state.total

    def energy(self, law: Any, F: Array, state: CohortMoments) -> Array:
        """Return the total energy of all cohorts at F (..., 3, 3) -> (...) [kPa]."""
        return law.energy_of_many(F, state.total, state.second)

    def absorb(
        self, law: Any, F: Array, state: CohortMoments, survival: Array, mass: Array, natural: Array
    ) -> CohortMoments:
        """Return the moments multiplied by ``survival`` (...), plus those of the new cohort."""
        fresh = self.start(mass, natural)
        return CohortMoments(
            survival * state.total + fresh.total, survival[..., None, None] * state.second + fresh.second
        )


class Recursive(eqx.Module):
    """Deposition history of fixed size per point: the second moment if the law allows it, otherwise merged cohorts.

    Parameters
    ----------
    cohorts : int
        Number of cohorts of each constituent whose law is not linear in J^(-2/3) F^T F; at least 2.
    """

    cohorts: int = eqx.field(static=True, default=16)

    def __check_init__(self):
        if self.cohorts < 2:
            raise InputError(f"Recursive.cohorts must be 2 or more; got {self.cohorts}.")

    def memory(self, law: EnergyMaterial) -> Memory:
        """Return a :class:`SecondMoment` for a law linear in J^(-2/3) F^T F, otherwise :class:`MergedCohorts`."""
        return SecondMoment() if isinstance(law, LinearInShape) else MergedCohorts(self.cohorts)
