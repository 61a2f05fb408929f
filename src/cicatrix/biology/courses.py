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


@eqx.filter_jit
def results(law: RateLaw, states: Array, before: Array, inputs: Array, times: Array) -> Array:
    """Return what a result has at each time: the states (n_times, n_species) after a change of inputs, and what is ``shown``.

    ``before`` (n_inputs,) are the inputs under which the states were integrated, ``inputs`` (n_times, n_inputs) those that apply
    from each of the ``times`` (n_times,) [s] on.
    """
    y = law.carried(states, before, inputs)
    return jnp.concatenate([y, law.observe(y, inputs, times)], axis=-1)


@eqx.filter_jit
def rate_and_jacobian(law: RateLaw, inputs: Array, y: Array) -> tuple[Array, Array]:
    """Return dy/dt (n_species,) at time 0 and its derivative with respect to the state (n_species, n_species)."""
    bound = law.under(inputs)
    return bound.rate(y), jax.jacfwd(bound.rate)(y)


def end_state(law: RateLaw, inputs: Array, start: Array, corners: Array, accuracy: Accuracy) -> Array:
    """Return the state (n_species,) at the last of ``corners`` (n + 1,) [s], with inputs (n, n_inputs) constant between them.

    ``start`` is the initial state under the network's own inputs. The result can be differentiated with respect to the law's
    parameters, the inputs and the initial state.
    """

    def pass_on(at: tuple[Array, Array], segment: tuple[Array, Array]) -> tuple[tuple[Array, Array], None]:
        (y, before), (held, times) = at, segment
        y = law.carried(y, before, held)
        done = integrate_ode(lambda bound, z, t: bound.rate(z, t), law.under(held), y, times, accuracy)
        return (done.y[-1], held), None

    first = (law.begin(start, inputs[0]), inputs[0])
    return jax.lax.scan(pass_on, first, (inputs, jnp.stack([corners[:-1], corners[1:]], axis=1)))[0][0]
