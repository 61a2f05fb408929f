"""Constrained mixture: tissue whose constituents are deposited and removed under load."""

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
from .constituent import Constituent, kirchhoff_stress_along
from .homogenised import Homogenised
from .material import EnergyMaterial, State

FORMS = {"recursive": Recursive, "exact": Exact, "homogenised": Homogenised}


class ConstrainedMixture(EnergyMaterial):
    r"""Constituents that deform together; each is replaced at its own rate and prestretched at deposition.

    .. math:: \Psi = \sum_i \Big[ \varphi_{0i} \, q_i(s, 0) \, \Psi_i(F(s) \, G_i)
        + \int_0^s m_i(\tau) \, q_i(s, \tau) \, \Psi_i(F_i) \, d\tau \Big] + v \, \frac{\kappa}{2} \Big( \frac{J}{v} - 1 \Big)^2

    .. math:: F_i(s, \tau) = F(s) \, F(\tau)^{-1} R(\tau) \, G_i = F(s) \, U(\tau)^{-1} G_i, \qquad
        v = 1 + \sum_i (\varphi_i - \varphi_{0i}), \qquad \dot\varphi_i = m_i - k_i \varphi_i

    Source: Guo, Mofrad & Buganza Tepole, Eqs (8), (9) and (11), the heredity integral after Humphrey & Rajagopal (2002).
    Departures: the inverse in Eq. (11) is missing in print; G is rotated by R of F = R U, because cells deposit in the frame of
    the deformed tissue (otherwise the law would depend on rotations of the body); Eq. (8) is used without transport. The
    reference configuration is homeostatic: the initial mass was deposited at F = I, so the stress there is the deposition
    stress, and nothing changes while F = I.

    Volume follows mass at constant density: v is the mass relative to the initial mass; the part of the tissue that is not
    among the constituents does not change. kappa keeps J near v; with kappa = 0 the caller must enforce J = v, where v is the
    determinant of ``growth_tensor``, v^(1/3) I. Constituents resist changes of shape only, so added mass by itself causes no
    stress in them; but if a mixture grows in one direction only, the mass deposited before is strained, by Eq. (11).

    All mass produced in a step is deposited at the stretch at its end: exact for constant stretch, otherwise of first order
    in dt. The stress is the derivative of the energy at fixed history.

    Parameters
    ----------
    constituents : tuple of Constituent
        Their fractions add up to 1 or less; the rest of the tissue is inert and carries no load.
    kappa : float or (...) array [kPa]
        Bulk modulus of the mixture; 0 if the volume is controlled elsewhere (another law, or incompressibility).
    form : Recursive, Exact or Homogenised
        Method of storing the deposition history.

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
            raise InputError("ConstrainedMixture.constituents is empty: give at least one.")
        total = sum(c.fraction for c in self.constituents)
        if not isinstance(total, jax.core.Tracer) and np.max(total) > 1.0 + 1e-9:
            raise InputError(
                f"ConstrainedMixture.constituents: fractions must add up to 1 or less; got {np.max(total):g}."
            )

    def has_potential(self) -> bool:
        """Return True if no constituent is replaced, since turnover has no potential."""
        return all(c.lifetime is None for c in self.constituents)

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return the history of every constituent at points of a given shape: one cohort, deposited at F = I."""
        return tuple(self._start(c, shape) for c in self.constituents)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        state = state or self.initial_state(F.shape[:-2])
        v = self.volume_at_rest(state)
        stored = sum(self.form.memory(c.law).energy(c.law, F, s) for c, s in zip(self.constituents, state, strict=True))
        return stored + 0.5 * self.kappa * v * (det(F) / v - 1.0) ** 2

    def masses(self, state: State) -> tuple[Array, ...]:
        """Return the mass of each constituent relative to the initial mass of the mixture: each (...) [1]."""
        return tuple(self.form.memory(c.law).mass(s) for c, s in zip(self.constituents, state, strict=True))

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return v, the mass relative to the initial mass (...) [1]."""
        if not state:
            return jnp.ones(())
        return jnp.asarray(
            1.0 + sum(m - c.fraction for c, m in zip(self.constituents, self.masses(state), strict=True))
        )

    def growth_tensor(self, state: State = ()) -> Array:
        """Return F_g = v^(1/3) I (..., 3, 3) [1]: added mass increases the volume isotropically."""
        return jnp.cbrt(self.volume_at_rest(state))[..., None, None] * IDENTITY

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Return the histories after mass is removed and deposited in a step dt [s] that ends at F (..., 3, 3)."""
        unstretched = inv(right_stretch(F))
        return tuple(self._turned_over(c, F, unstretched, s, dt) for c, s in zip(self.constituents, state, strict=True))

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Return zero (...) [kPa]: removed mass takes its energy along, and cells supply the energy of the prestretch."""
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
        stress = kirchhoff_stress_along(lambda F: memory.energy(c.law, F, state), F, n) / jnp.where(
            mass > 0.0, mass, 1.0
        )
        survival = jnp.broadcast_to(jnp.exp(-age), mass.shape)
        deposit = c.deposited(survival * mass, stress, -jnp.expm1(-age))
        return memory.absorb(c.law, F, state, survival, deposit, product(unstretched, c.deposition_stretch()))
