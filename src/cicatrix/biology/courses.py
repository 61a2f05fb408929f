"""Time integration of signalling networks."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ..numerics.ode import Accuracy, Solution, integrate_ode
from .network import RateLaw


@eqx.filter_jit
def integrate(law: RateLaw, inputs: Array, start: Array, times: Array, accuracy: Accuracy) -> Solution:
    """Integrate from an initial state (..., n_species) under inputs (..., n_inputs); return states at the times (n_times,) [s].

    One program is compiled for each combination of wiring, array shapes and accuracy, and reused for all parameter values.
    Batched states share their time steps.
    """
    return integrate_ode(lambda bound, y, t: bound.rate(y, t), law.under(inputs), start, times, accuracy)


def end_state(law: RateLaw, inputs: Array, start: Array, corners: Array, accuracy: Accuracy) -> Array:
    """Return the state (n_species,) at the last of ``corners`` (n + 1,) [s], with inputs (n, n_inputs) constant between them.

    The result can be differentiated with respect to the law's parameters, the inputs and the initial state.
    """

    def pass_on(y: Array, segment: tuple[Array, Array]) -> tuple[Array, None]:
        held, times = segment
        return integrate_ode(lambda bound, z, t: bound.rate(z, t), law.under(held), y, times, accuracy).y[-1], None

    return jax.lax.scan(pass_on, start, (inputs, jnp.stack([corners[:-1], corners[1:]], axis=1)))[0]
