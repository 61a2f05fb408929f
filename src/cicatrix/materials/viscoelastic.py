"""Finite viscoelasticity of isotropic laws: Maxwell branches in parallel with the law, a Prony series at small strain."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array, lax

from ..core.errors import InputError
from ..core.law import param
from ..numerics.implicit import solve
from ..numerics.spectral import isotropic
from ..numerics.tensors import IDENTITY, det, product, right_cauchy_green
from .material import EnergyMaterial, State


class Viscoelastic(EnergyMaterial):
    r"""An isotropic law in parallel with Maxwell branches whose springs are scaled copies of it.

    .. math:: \Psi = \Psi_{law}(F) + \sum_i \beta_i \Psi_{law}(\bar F_e^i), \qquad
        -\tfrac12 \mathcal{L}_v b_e^i \, (b_e^i)^{-1} = \frac{1}{2 \eta_i} \mathrm{dev} \, \tau^i,
        \qquad \eta_i = \beta_i \mu \, t_i

    Source: Guo, Mofrad & Buganza Tepole, Eq. (2), after Reese & Govindjee (1998), with several branches. The springs
    depend on :math:`\bar F_e = J_e^{-1/3} F_e` only, so the branches have no bulk stress and need no volumetric dashpot as in
    Eq. (2). With mu the law's shear modulus at rest, :math:`t_i` is the relaxation time at small strain, where the modulus
    relaxes as :math:`1 + \sum \beta_i e^{-t / t_i}`. A step is backward Euler in the logarithms of the principal elastic
    stretches: it is stable for any step size, preserves det F_v = 1 and has a symmetric tangent.

    Parameters
    ----------
    law : EnergyMaterial
        Isotropic law without history that is stress-free at rest.
    beta : n floats or (...) arrays [1]
        Stiffness of the branches relative to that of the law.
    relaxation : n floats or (...) arrays [s]
        Relaxation times of the branches.

    Raises
    ------
    InputError
        If there is no branch, or the numbers of ``beta`` and ``relaxation`` differ.
    """

    law: EnergyMaterial
    beta: tuple[float | Array, ...] = param("1", "beta", low=0.0)
    relaxation: tuple[float | Array, ...] = param("s", "t_r", above=0.0)

    def __check_init__(self):
        super().__check_init__()
        if not self.beta:
            raise InputError("Viscoelastic.beta is empty: give at least one branch.")
        if len(self.beta) != len(self.relaxation):
            raise InputError(
                f"Viscoelastic.relaxation must have one time per branch: {len(self.beta)}; got {len(self.relaxation)}."
            )

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        back = self.initial_state(()) if isinstance(state, tuple) else state
        springs = jax.vmap(lambda back, beta: beta * _spring(self.law, product(F, back)), in_axes=(-3, 0))
        return self.law.energy(F) + springs(back, self._branches(self.beta)).sum(axis=0)

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the stress-free volume ratio of the law."""
        return self.law.volume_at_rest()

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return the inverse viscous deformation of each branch, the identity (*shape, n, 3, 3)."""
        return jnp.broadcast_to(IDENTITY, (*shape, len(self.beta), 3, 3))

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Return the inverse viscous deformations after a step dt [s] that ends at F (..., 3, 3) [1].

        Each branch flows along the principal axes of its elastic deformation.
        """
        mu = _shear_modulus(self.law, F.shape[:-2])

        def flowed(back: Array, relaxation: Array) -> Array:
            C = right_cauchy_green(product(F, back))
            return product(back, isotropic(_flow, C, self.law, mu, jnp.asarray(dt / relaxation)))

        return jax.vmap(flowed, in_axes=(-3, 0), out_axes=-3)(state, self._branches(self.relaxation))

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Return the sum of dt |dev tau|^2 / (2 eta) over the branches, with tau at the end of the step."""
        mu = _shear_modulus(self.law, F.shape[:-2])

        def lost(back: Array, beta: Array, relaxation: Array) -> Array:
            F_e = product(F, back)
            P = jax.grad(lambda G: jnp.sum(_spring(self.law, G)))(F_e)
            tau = product(P, jnp.swapaxes(F_e, -1, -2))
            return 0.5 * dt * beta / (mu * relaxation) * jnp.sum(tau * tau, axis=(-2, -1))

        branches = after, self._branches(self.beta), self._branches(self.relaxation)
        return jax.vmap(lost, in_axes=(-3, 0, 0))(*branches).sum(axis=0)

    @staticmethod
    def _branches(values: tuple[float | Array, ...]) -> Array:
        """Stack the values of n branches, each a number or an array over points, along a new first axis (n, ...)."""
        return jnp.stack(jnp.broadcast_arrays(*(jnp.asarray(value, float) for value in values)))


def _spring(law: EnergyMaterial, F_e: Array) -> Array:
    return law.energy(jnp.cbrt(1.0 / det(F_e))[..., None, None] * F_e)


def _shear_modulus(law: EnergyMaterial, shape: tuple[int, ...]) -> Array:
    """Return the shear modulus at rest (...) [kPa], a single number if it is the same at all points; 1 where it would be 0."""
    is_uniform = all(jnp.ndim(leaf) == 0 for leaf in jax.tree.leaves(law))
    mu = law.moduli_at_rest(() if is_uniform else shape)[0]
    return jnp.where(mu > 0.0, mu, 1.0)


def _flow(c: Array, law: EnergyMaterial, mu: Array, steps: Array) -> Array:
    r"""Return the factors :math:`e^{\epsilon - \epsilon_{trial}}` (..., 3) of the principal stretches due to viscous flow.

    c (..., 3) are the eigenvalues of the trial state's :math:`C_e`, mu (...) [kPa] the shear modulus at rest and
    ``steps`` is dt / t_r; :math:`\epsilon` solves
    :math:`\epsilon + \frac{dt}{2 \mu t_r} \, \partial\Psi/\partial\epsilon = \epsilon_{trial}`.
    """
    trial = 0.5 * jnp.log(c)

    def residual(strain: Array) -> Array:
        tau = jax.grad(lambda e: jnp.sum(_spring(law, jnp.exp(e)[..., None] * IDENTITY)))(strain)
        return strain + (0.5 * steps / mu)[..., None] * tau - trial

    mean = trial.mean(axis=-1, keepdims=True)
    small = mean + (trial - mean) / (1.0 + steps[..., None])
    return jnp.exp(solve(residual, lax.stop_gradient(small)) - trial)
