"""Tissue that is laid down and taken away while it carries load."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import choice, param
from ..numerics.polar import right_stretch
from ..numerics.tensors import IDENTITY, det, inv, product
from .cohorts import Exact, Form, Recursive
from .constituent import Constituent, pull
from .homogenised import Homogenised
from .material import EnergyMaterial, State

FORMS = {"recursive": Recursive, "exact": Exact, "homogenised": Homogenised}


class ConstrainedMixture(EnergyMaterial):
    r"""Constituents that deform together, each replaced at its own rate and prestretched as it is laid down.

    .. math:: \Psi = \sum_i \Big[ \varphi_{0i} \, q_i(s, 0) \, \Psi_i(F(s) \, G_i)
        + \int_0^s m_i(\tau) \, q_i(s, \tau) \, \Psi_i(F_i) \, d\tau \Big] + v \, \frac{\kappa}{2} \Big( \frac{J}{v} - 1 \Big)^2

    .. math:: F_i(s, \tau) = F(s) \, F(\tau)^{-1} R(\tau) \, G_i = F(s) \, U(\tau)^{-1} G_i, \qquad
        v = 1 + \sum_i (\varphi_i - \varphi_{0i}), \qquad \dot\varphi_i = m_i - k_i \varphi_i

    Source: Guo, Mofrad & Buganza Tepole, Eqs (8), (9) and (11), the heredity integral after Humphrey & Rajagopal (2002).
    Departures: Eq. (11) lost an inverse in print; the rotation R of F = R U goes with G, which cells lay down in the tissue's own
    frame (without it the law would feel a rotation of the body); Eq. (8) is homogeneous. The reference configuration is
    that in which the tissue was at home: what is there at first was laid down at F = I, so stress there is that of
    deposition and constant stretch I changes nothing.

    Volume follows mass at constant density: v is the mass over that at first; what is not among the constituents stays as
    it is. kappa keeps J near v; with kappa = 0 a driver keeps J = v, the determinant of ``growth_tensor``, v^(1/3) I.
    Constituents resist changes of shape only, so nothing else minds how much there is; yet where a mixture grows in one
    direction, that strains what was there before, by Eq. (11).

    Everything new in a step is laid down at the stretch at its end: exact where stretch is constant, of first order in dt
    where it is not. Stress is the derivative of the energy at held history.

    Parameters
    ----------
    constituents : tuple of Constituent
        Their fractions add up to 1 or less; the rest is inert and bears no load.
    kappa : float or (...) array [kPa]
        Bulk modulus of the mixture; 0 where something else keeps the volume.
    form : Recursive, Exact or Homogenised
        How the past is remembered.

    Raises
    ------
    InputError
        If there is no constituent, or their fractions add up to more than 1.
    """

    constituents: tuple[Constituent, ...] = eqx.field(metadata={"key": "constituent"})
    kappa: float | Array = param("kPa", "kappa", low=0.0, default=0.0)
    form: Form = choice(FORMS, default=Recursive())

    def __check_init__(self):
        if not self.constituents:
            raise InputError("ConstrainedMixture.constituents is empty: give one at least.")
        total = sum(c.fraction for c in self.constituents)
        if not isinstance(total, jax.core.Tracer) and np.max(total) > 1.0 + 1e-9:
            raise InputError(
                f"ConstrainedMixture.constituents: fractions must add up to 1 or less; got {np.max(total):g}."
            )

    def has_potential(self) -> bool:
        """Where nothing is replaced."""
        return all(c.lifetime is None for c in self.constituents)

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """One cohort of every constituent, laid down at F = I."""
        return tuple(self._start(c, shape) for c in self.constituents)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        state = state or self.initial_state(F.shape[:-2])
        v = self.volume_at_rest(state)
        stored = sum(self.form.memory(c.law).energy(c.law, F, s) for c, s in zip(self.constituents, state, strict=True))
        return stored + 0.5 * self.kappa * v * (det(F) / v - 1.0) ** 2

    def masses(self, state: State) -> tuple[Array, ...]:
        """Mass of each constituent, per mass of the mixture at first: each (...) [1]."""
        return tuple(self.form.memory(c.law).mass(s) for c, s in zip(self.constituents, state, strict=True))

    def volume_at_rest(self, state: State = ()) -> Array:
        """Mass by that at first, v (...) [1]."""
        if not state:
            return jnp.ones(())
        return jnp.asarray(
            1.0 + sum(m - c.fraction for c, m in zip(self.constituents, self.masses(state), strict=True))
        )

    def growth_tensor(self, state: State = ()) -> Array:
        """F_g = v^(1/3) I (..., 3, 3) [1]: new mass makes room in all directions alike."""
        return jnp.cbrt(self.volume_at_rest(state))[..., None, None] * IDENTITY

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Let every constituent decay and lay down more of it, in a step dt [s] that ends at F (..., 3, 3)."""
        unstretched = inv(right_stretch(F))
        return tuple(self._turned_over(c, F, unstretched, s, dt) for c, s in zip(self.constituents, state, strict=True))

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Zero (...) [kPa]: what is taken away leaves with its energy, and cells pay for the prestretch of what is new."""
        return jnp.zeros(F.shape[:-2])

    def _start(self, c: Constituent, shape: tuple[int, ...]) -> State:
        mass = jnp.broadcast_to(jnp.asarray(c.fraction, float), shape)
        return self.form.memory(c.law).start(mass, jnp.broadcast_to(c.deposition_stretch(), (*shape, 3, 3)))

    def _turned_over(self, c: Constituent, F: Array, unstretched: Array, state: State, dt: float) -> State:
        if c.lifetime is None:
            return state
        memory, age = self.form.memory(c.law), jnp.asarray(dt / c.lifetime)
        mass = memory.mass(state)
        n = jnp.sum(product(F, unstretched) * c.direction()[..., None, :], axis=-1)  # R a
        stress = pull(lambda F: memory.energy(c.law, F, state), F, n) / jnp.where(mass > 0.0, mass, 1.0)
        survival = jnp.broadcast_to(jnp.exp(-age), mass.shape)
        deposit = c.deposited(survival * mass, stress, -jnp.expm1(-age))
        return memory.absorb(c.law, F, state, survival, deposit, product(unstretched, c.deposition_stretch()))
