"""Finite viscoelasticity of isotropic laws: Maxwell branches beside the law, a Prony series at small strain."""

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
    r"""An isotropic law and Maxwell branches whose springs are shares of it.

    .. math:: \Psi = \Psi_{law}(F) + \sum_i \beta_i \Psi_{law}(\bar F_e^i), \qquad
        -\tfrac12 \mathcal{L}_v b_e^i \, (b_e^i)^{-1} = \frac{1}{2 \eta_i} \mathrm{dev} \, \tau^i,
        \qquad \eta_i = \beta_i \mu \, t_i

    Source: Guo, Mofrad & Buganza Tepole, Eq. (2), after Reese & Govindjee (1998), with several branches. A spring feels
    :math:`\bar F_e = J_e^{-1/3} F_e` alone, so the branches have no bulk stress and the dashpot for volume of Eq. (2) has nothing
    to do. With mu the law's shear modulus at rest, :math:`t_i` is the relaxation time at small strain, where the modulus
    relaxes as :math:`1 + \sum \beta_i e^{-t / t_i}`. A step is backward Euler in the logarithms of the principal elastic
    stretches: stable however long it is, it keeps det F_v = 1, and its tangent is symmetric.

    Parameters
    ----------
    law : EnergyMaterial
        Isotropic, free of stress at rest, and without history.
    beta : n floats or (...) arrays [1]
        Stiffness of the branches over that of the law.
    relaxation : n floats or (...) arrays [s]
        Their relaxation times.

    Raises
    ------
    InputError
        If there is no branch, or not as many of the one as of the other.
    """

    law: EnergyMaterial
    beta: tuple[float | Array, ...] = param("1", "beta", low=0.0)
    relaxation: tuple[float | Array, ...] = param("s", "t_r", above=0.0)

    def __check_init__(self):
        super().__check_init__()
        if not self.beta:
            raise InputError("Viscoelastic.beta is empty: give one branch at least.")
        if len(self.beta) != len(self.relaxation):
            raise InputError(
                f"Viscoelastic.relaxation must have one time per branch: {len(self.beta)}; got {len(self.relaxation)}."
            )

    def energy(self, F: Array, state: State = ()) -> Array:
        """Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        back = self.initial_state(()) if isinstance(state, tuple) else state
        springs = jax.vmap(lambda back, beta: beta * _spring(self.law, product(F, back)), in_axes=(-3, 0))
        return self.law.energy(F) + springs(back, self._branches(self.beta)).sum(axis=0)

    def volume_at_rest(self, state: State = ()) -> Array:
        """That of the law."""
        return self.law.volume_at_rest()

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Inverse of each branch's viscous deformation (*shape, n, 3, 3)."""
        return jnp.broadcast_to(IDENTITY, (*shape, len(self.beta), 3, 3))

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Let the dashpots flow for dt [s]; each along the principal axes of its elastic deformation."""
        mu = _shear_modulus(self.law, F.shape[:-2])

        def flowed(back: Array, relaxation: Array) -> Array:
            C = right_cauchy_green(product(F, back))
            return product(back, isotropic(_flow, C, self.law, mu, jnp.asarray(dt / relaxation)))

        return jax.vmap(flowed, in_axes=(-3, 0), out_axes=-3)(state, self._branches(self.relaxation))

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Sum of dt |dev tau|^2 / (2 eta), tau as at the end of the step."""
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
        """One number, or one array of points, for each branch (n, ...)."""
        return jnp.stack(jnp.broadcast_arrays(*(jnp.asarray(value, float) for value in values)))


def _spring(law: EnergyMaterial, F_e: Array) -> Array:
    return law.energy(jnp.cbrt(1.0 / det(F_e))[..., None, None] * F_e)


def _shear_modulus(law: EnergyMaterial, shape: tuple[int, ...]) -> Array:
    """At rest (...) [kPa]; one number where the law's parameters are the same at all points; 1 where nothing resists."""
    is_uniform = all(jnp.ndim(leaf) == 0 for leaf in jax.tree.leaves(law))
    mu = law.moduli_at_rest(() if is_uniform else shape)[0]
    return jnp.where(mu > 0.0, mu, 1.0)


def _flow(c: Array, law: EnergyMaterial, mu: Array, steps: Array) -> Array:
    r"""What the dashpot takes of the principal stretches: :math:`e^{\epsilon - \epsilon_{trial}}` (..., 3).

    c (..., 3) are those of the trial state's :math:`C_e`, mu (...) [kPa] is the shear modulus at rest, ``steps`` = dt / t_r, and
    :math:`\epsilon + \frac{dt}{2 \mu t_r} \, \partial\Psi/\partial\epsilon = \epsilon_{trial}`.
    """
    trial = 0.5 * jnp.log(c)

    def residual(strain: Array) -> Array:
        tau = jax.grad(lambda e: jnp.sum(_spring(law, jnp.exp(e)[..., None] * IDENTITY)))(strain)
        return strain + (0.5 * steps / mu)[..., None] * tau - trial

    mean = trial.mean(axis=-1, keepdims=True)
    small = mean + (trial - mean) / (1.0 + steps[..., None])
    return jnp.exp(solve(residual, lax.stop_gradient(small)) - trial)
