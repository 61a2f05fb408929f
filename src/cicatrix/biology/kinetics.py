"""Reaction kinetics of SBML models: rates at a point, evaluated from expressions."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from .expressions import TIME, Expression, evaluate, names_in

Rules = tuple[tuple[str, Expression], ...]
"""Names with their formulas, ordered so that each depends only on those before it."""


class Kinetics(eqx.Module):
    r"""Kinetic laws of an SBML model; its states are concentrations or other quantities of the model.

    .. math:: \dot y = f(y, k, t), \quad f \text{ by the model's rules and reactions}

    Source: SBML Level 3 Version 2 Core (Hucka et al., J Integr Bioinform 16:20190021, 2019), sections 4.6, 4.8, 4.9 and 4.11.

    Parameters
    ----------
    species : tuple of str
        States (n_species,): species that reactions or rate rules change, and parameters with rate rules.
    input_names : tuple of str
        Constants (n_inputs,): parameters, compartments and species that no rule or reaction changes. All of them are inputs.
    values : (n_inputs,) array
        Values of the constants in the model, in its own units.
    assigned : Rules
        Names computed by rules or reactions, and constants that initial assignments compute from other constants.
    rates : tuple of Expression
        Rate of every state, per ``seconds``.
    seconds : float [s]
        The model's unit of time.
    initial : Rules
        Names that the initial values of the states need, and the states: values at time 0 from those of the inputs.
    volumes : tuple of str
        Compartment of every state that is a concentration (n_species,); empty for all others.
    shown : tuple of str
        Names besides the states that are part of a result: species and parameters that rules compute, and constant species.
    """

    species: tuple[str, ...] = eqx.field(static=True)
    input_names: tuple[str, ...] = eqx.field(static=True)
    values: Array
    assigned: Rules = eqx.field(static=True)
    rates: tuple[Expression, ...] = eqx.field(static=True)
    seconds: float = eqx.field(static=True, default=1.0)
    initial: Rules = eqx.field(static=True, default=())
    volumes: tuple[str, ...] = eqx.field(static=True, default=())
    shown: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def is_time_dependent(self) -> bool:
        """Whether a rule or a rate contains the time."""
        return any(TIME in names_in(one) for one in (*self.rates, *(rule for _, rule in self.assigned)))

    @property
    def differentiable(self) -> dict[str, tuple[str, ...]]:
        """Names of the parameter fields: an empty mapping, since all constants of the model are inputs."""
        return {}

    def rate(self, y: Array, inputs: Array | None = None, time: Array | float = 0.0) -> Array:
        """Return dy/dt at states (..., n_species) under constants (..., n_inputs) at a time [s] -> (..., n_species) [1/s]."""
        return self.under(inputs).rate(y, time)

    def under(self, inputs: Array | None = None) -> BoundKinetics:
        """Return the rates as a function of state and time alone, with fixed constants (..., n_inputs)."""
        return BoundKinetics(self, jnp.asarray(self.values if inputs is None else inputs))

    def begin(self, own: Array, inputs: Array) -> Array:
        """Return the initial state (n_species,) under constants (n_inputs,): initial assignments follow them.

        Compartments are of the model's own size until the first instant, so amounts are those of the model, and
        concentrations change with the size. ``own`` is the initial state of a model without ``initial``.
        """
        if not self.initial:
            return own
        sizes = [self.input_names.index(name) for name in set(self.volumes) & set(self.input_names)]
        before = jnp.asarray(inputs).at[np.array(sizes, int)].set(self.values[np.array(sizes, int)])
        values: dict[str, Any] = {name: before[k] for k, name in enumerate(self.input_names)} | {TIME: 0.0}
        for name, rule in self.initial:
            values[name] = evaluate(rule, values)
        start = jnp.stack([jnp.asarray(values[name], float) for name in self.species])
        return self.carried(start, before, inputs)

    def carried(self, y: Array, before: Array, after: Array) -> Array:
        """Return a state (..., n_species) just after the constants change: amounts stay, concentrations follow the volume."""
        old, new = (self.under(one).constants() for one in (before, after))
        share = [old[name] / new[name] if name in old else jnp.ones(()) for name in self.volumes]
        return (
            jnp.asarray(y) * jnp.stack(jnp.broadcast_arrays(*share), axis=-1) if any(self.volumes) else jnp.asarray(y)
        )

    def observe(self, y: Array, inputs: Array, time: Array | float = 0.0) -> Array:
        """Return what is ``shown`` besides the states (..., n_shown) at states (..., n_species), constants and times [s]."""
        values, lead = self.under(inputs).values(y, time), jnp.shape(y)[:-1]
        if not self.shown:
            return jnp.asarray(y)[..., :0]
        return jnp.stack([jnp.broadcast_to(jnp.asarray(values[name], float), lead) for name in self.shown], axis=-1)


class BoundKinetics(eqx.Module):
    """Rates of an SBML model as a function of state and time, with fixed constants."""

    law: Kinetics
    inputs: Array

    def constants(self) -> dict[str, Any]:
        """Return the constants, and what is computed from them alone, by name."""
        values: dict[str, Any] = {name: self.inputs[..., k] for k, name in enumerate(self.law.input_names)}
        for name, rule in self.law.assigned:
            if names_in(rule) <= values.keys():
                values[name] = evaluate(rule, values)
        return values

    def values(self, y: Array, time: Array | float = 0.0) -> dict[str, Any]:
        """Return the value of every name of the model at states (..., n_species) and a time [s]."""
        y, law = jnp.asarray(y), self.law
        values: dict[str, Any] = {name: self.inputs[..., k] for k, name in enumerate(law.input_names)}
        values |= {name: y[..., k] for k, name in enumerate(law.species)} | {TIME: time / law.seconds}
        for name, rule in law.assigned:
            values[name] = evaluate(rule, values)
        return values

    def rate(self, y: Array, time: Array | float = 0.0) -> Array:
        """Return dy/dt at states (..., n_species) at a time [s] -> (..., n_species) [1/s]."""
        values = self.values(y, time)
        lead = np.broadcast_shapes(jnp.shape(y)[:-1], self.inputs.shape[:-1])
        rates = [jnp.broadcast_to(jnp.asarray(evaluate(rate, values), float), lead) for rate in self.law.rates]
        return jnp.stack(rates, axis=-1) / self.law.seconds
