"""How a network gets from one state to another."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from ..numerics.ode import Accuracy, Course, course
from .network import RateLaw


@eqx.filter_jit
def follow(law: RateLaw, inputs: Array, start: Array, times: Array, accuracy: Accuracy) -> Course:
    """Lead states (..., n_species) under inputs (..., n_inputs) through times (n_times,) [s]: y (n_times, ..., n_species).

    One program for a law's wiring, the shapes and an accuracy: numbers may change. Several states share their steps.
    """
    return course(lambda bound, y, t: bound.rate(y, t), law.under(inputs), start, times, accuracy)


def end_of(law: RateLaw, inputs: Array, start: Array, corners: Array, accuracy: Accuracy) -> Array:
    """State (n_species,) at the last of corners (n + 1,) [s], under inputs (n, n_inputs) between each two of them.

    Made for derivatives: with respect to the law's parameters, inputs and start.
    """

    def pass_on(y: Array, segment: tuple[Array, Array]) -> tuple[Array, None]:
        held, times = segment
        return course(lambda bound, z, t: bound.rate(z, t), law.under(held), y, times, accuracy).y[-1], None

    return jax.lax.scan(pass_on, start, (inputs, jnp.stack([corners[:-1], corners[1:]], axis=1)))[0]
