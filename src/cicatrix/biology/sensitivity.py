"""Sensitivities of the states of a network to its parameters."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..numerics.ode import Accuracy
from .courses import end_state
from .network import RateLaw

INPUT = "input"
CONSERVED = 1e-10  # reciprocal condition number below which a Jacobian counts as singular
Sensitivities = dict[str, np.ndarray]
"""Kind of parameter (a field of the law, or "input") -> dy/dp (n_species, n parameters)."""


def of_steady_state(
    law: RateLaw, inputs: np.ndarray, y: np.ndarray, scale: np.ndarray | float = 1.0
) -> Sensitivities | None:
    """Return derivatives of a steady state (n_species,) with respect to parameters p, by implicit differentiation: -J^-1 df/dp.

    Return None if J is singular, for example if quantities are conserved: the steady state then depends on the initial state.
    ``scale`` (n_species,) are the magnitudes of the species, by which J is divided before it is judged.
    """
    J, by = _derivatives(law, jnp.asarray(inputs), jnp.asarray(y))
    J = np.asarray(J)
    sizes = np.maximum(scale, np.abs(y))
    if not np.isfinite(J).all() or 1.0 / np.linalg.cond(J * sizes / sizes[:, None]) < CONSERVED:
        return None
    return {kind: -np.linalg.solve(J, np.asarray(columns)) for kind, columns in by.items()}


def of_end(
    law: RateLaw, inputs: np.ndarray, start: np.ndarray, corners: np.ndarray, accuracy: Accuracy
) -> Sensitivities:
    """Return derivatives of the final state of a time course (:func:`.courses.end_state`), by differentiating the solver's steps.

    The derivative with respect to an input is for an equal change of that input in all time segments.
    """
    by = _end_derivatives(law, jnp.asarray(inputs), jnp.asarray(start), jnp.asarray(corners), accuracy)
    return {kind: np.asarray(columns) for kind, columns in by.items()}


def parameters(law: RateLaw) -> dict[str, Array]:
    """Return the differentiable parameters of a law: field -> array."""
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
        return end_state(_put(law, values), inputs + values[INPUT], start, corners, accuracy)

    return jax.jacrev(end)(parameters(law) | {INPUT: jnp.zeros(inputs.shape[1:])})
