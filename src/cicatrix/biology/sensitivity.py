"""What a network's states owe to each of its parameters."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..numerics.ode import Accuracy
from .courses import end_of
from .network import RateLaw

INPUT = "input"
CONSERVED = 1e-10  # reciprocal condition below which a Jacobian has no inverse
Sensitivities = dict[str, np.ndarray]
"""Kind of parameter (a field of the law, or "input") -> dy/dp (n_species, n of them)."""


def of_steady_state(law: RateLaw, inputs: np.ndarray, y: np.ndarray) -> Sensitivities | None:
    """Derivatives of a steady state (n_species,), by the implicit function theorem: -J^-1 df/dp.

    None where J is singular, as where quantities are conserved: the state then depends on its start.
    """
    J, by = _derivatives(law, jnp.asarray(inputs), jnp.asarray(y))
    J = np.asarray(J)
    if 1.0 / np.linalg.cond(J) < CONSERVED:
        return None
    return {kind: -np.linalg.solve(J, np.asarray(columns)) for kind, columns in by.items()}


def of_end(
    law: RateLaw, inputs: np.ndarray, start: np.ndarray, corners: np.ndarray, accuracy: Accuracy
) -> Sensitivities:
    """Derivatives of the state at a course's end (as :func:`.courses.end_of`), through the solver's steps.

    That by an input is of the same change in all segments.
    """
    by = _end_derivatives(law, jnp.asarray(inputs), jnp.asarray(start), jnp.asarray(corners), accuracy)
    return {kind: np.asarray(columns) for kind, columns in by.items()}


def parameters(law: RateLaw) -> dict[str, Array]:
    """Arrays of a law that may be differentiated by."""
    return {name: jnp.asarray(getattr(law, name)) for name in law.differentiable}


def _put(law: RateLaw, values: dict[str, Any]) -> RateLaw:
    names = list(law.differentiable)
    return eqx.tree_at(lambda one: [getattr(one, name) for name in names], law, [values[name] for name in names])


@eqx.filter_jit
def _derivatives(law: RateLaw, inputs: Array, y: Array) -> tuple[Array, dict[str, Array]]:
    def rate(values: dict[str, Array], y: Array) -> Array:
        return _put(law, values).under(values[INPUT]).rate(y)

    by, J = jax.jacrev(rate, argnums=(0, 1))(parameters(law) | {INPUT: inputs}, y)
    return J, by


@eqx.filter_jit
def _end_derivatives(law: RateLaw, inputs: Array, start: Array, corners: Array, accuracy: Accuracy) -> dict[str, Array]:
    def end(values: dict[str, Array]) -> Array:
        return end_of(_put(law, values), inputs + values[INPUT], start, corners, accuracy)

    return jax.jacrev(end)(parameters(law) | {INPUT: jnp.zeros(inputs.shape[1:])})
