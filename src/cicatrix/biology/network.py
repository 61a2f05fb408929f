"""Signalling networks of normalised Hill functions: rates at a point."""

from __future__ import annotations

from typing import Literal, Protocol

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, param
from .wiring import Wiring

TINY = 1e-250  # lower limit of x in x^n = exp(n log x), negligible like its powers; exp and log are vectorised, powers are not
BEYOND = 1e-6  # share by which x^n may exceed 1 where act has a pole, so that act is smooth at 1
Inhibition = Literal["complement", "weighted"]


class RateLaw(Protocol):
    """Interface of a network for time courses, steady states and continuum models, implemented by Hill and SBML networks."""

    @property
    def species(self) -> tuple[str, ...]:
        """Names of the states (n_species,)."""
        ...

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs, which are set from outside (n_inputs,)."""
        ...

    @property
    def is_time_dependent(self) -> bool:
        """Whether the rate depends explicitly on time."""
        ...

    @property
    def differentiable(self) -> dict[str, tuple[str, ...]]:
        """Names of the parameter fields (1-D for one network), each with the species or reactions of its values."""
        ...

    def rate(self, y: Array, inputs: Array | None = None, time: Array | float = 0.0) -> Array:
        """Return dy/dt at states (..., n_species) under inputs (..., n_inputs) and at a time [s] -> (..., n_species) [1/s]."""
        ...

    def under(self, inputs: Array | None = None) -> BoundRates:
        """Return the rates as a function of state and time, with fixed inputs (..., n_inputs), for evaluation at many states."""
        ...

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of what is part of a result besides the states (n_shown,)."""
        ...

    def begin(self, own: Array, inputs: Array) -> Array:
        """Return the initial state (n_species,) under inputs (n_inputs,); ``own`` is that under the network's own inputs."""
        ...

    def carried(self, y: Array, before: Array, after: Array) -> Array:
        """Return a state (..., n_species) just after the inputs change from ``before`` to ``after`` (..., n_inputs)."""
        ...

    def observe(self, y: Array, inputs: Array, time: Array | float = 0.0) -> Array:
        """Return what is ``shown`` (..., n_shown) at states (..., n_species), inputs (..., n_inputs) and times [s]."""
        ...


class BoundRates(Protocol):
    """Interface of a network's rates as a function of state and time, with fixed inputs."""

    def rate(self, y: Array, time: Array | float = 0.0) -> Array:
        """Return dy/dt at states (..., n_species) and a time [s] -> (..., n_species) [1/s]."""
        ...


class HillNetwork(Law):
    r"""Signalling network of Hill functions; the activity of a species is a fraction in [0, 1] of its greatest amount.

    .. math::
        \dot y_i = (F_i \, y_{max,i} - y_i) / \tau_i, \qquad
        act(x) = w \frac{B \, x^n}{K^n + x^n}, \quad B = \frac{E^n - 1}{2 E^n - 1}, \quad K^n = B - 1, \quad E = EC_{50}

    so that act(0) = 0, act(E) = w / 2, act(1) = w. NOT: 1 - act. AND of m factors: their product over :math:`w^{m-1}`. OR of
    the reactions with the same target: x + y - x y. An input ``=> X`` has its weight as value. A species without reaction decays.

    Source: Kraeutler, Soltis & Saucerman, BMC Systems Biology 4:157 (2010), as in the cardiac fibroblast network of Zeigler et
    al., Journal of Molecular and Cellular Cardiology 94:72-81 (2016). Differences from the source: act is computed as
    :math:`w (1 - E^n) x^n / (E^n + (1 - 2 E^n) x^n)`, which is equal but avoids the quotients, and is :math:`w x^n` for
    :math:`E^n = 1/2`, where B and K are infinite. For :math:`E^n > 1/2` the function has a pole at
    :math:`x = (E^n / (2 E^n - 1))^{1/n} > 1`; it is smooth on [0, 1], and its argument is cut off just above 1, as the value is
    in the source's program. For smaller E it is not cut off for x > 1 (y_max > 1).
    Negative x, which can arise from solver errors, counts as 0. The product over :math:`w^{m-1}` is formed
    without division by a power of a weight that may be 0, wherever its limit exists.

    Parameters
    ----------
    wiring : Wiring
        Connections of the network; its arrays are compile-time constants, so all parameter sets share one program.
    y_max : (..., n_species) array [1]
        Maximum activities; 0 is a knock-out.
    tau : (..., n_species) array [s]
        Time constants of the activities.
    weight, n, ec50 : (..., n_reactions) array [1]
        Parameters of every reaction: weight in [0, 1]; Hill exponent of at least 1, since the slope at 0 is infinite below;
        half-maximal activity above 0 and below 1.
    inhibition : str
        "complement": NOT is 1 - act, as printed; an inhibited reaction of small weight then activates its target almost fully,
        since act <= w. "weighted": NOT is w - act, as in the program Netflux; equal to 1 - act for w = 1, and 0 for w = 0.

    Raises
    ------
    InputError
        If a parameter is out of its range; the message names the species or reaction.
    """

    wiring: Wiring = param("1", "wiring", static=True)
    y_max: Array = param("1", "y_max")
    tau: Array = param("s", "tau", typed="h")
    weight: Array = param("1", "w")
    n: Array = param("1", "n")
    ec50: Array = param("1", "EC50")
    inhibition: Inhibition = param("1", "inhibition", static=True, default="complement")

    def __check_init__(self):
        fields = (self.y_max, self.tau, self.weight, self.n, self.ec50)
        if not all(isinstance(value, np.ndarray) for value in fields):
            return  # traced values inside a JAX transformation; the law was checked when it was created
        species, reactions = self.wiring.species, self.wiring.reactions
        _check("y_max", self.y_max, self.y_max >= 0.0, "at least 0", "species", species)
        _check("tau", self.tau, self.tau > 0.0, "above 0 s", "species", species)
        _check("weight", self.weight, (self.weight >= 0.0) & (self.weight <= 1.0), "in [0, 1]", "reaction", reactions)
        _check("n", self.n, (self.n >= 1.0) & (self.n <= 50.0), "in [1, 50]", "reaction", reactions)
        _check("ec50", self.ec50, (self.ec50 > 0.0) & (self.ec50 < 1.0), "above 0 and below 1", "reaction", reactions)
        if self.inhibition == "complement":
            is_finite = (self.weight > 0.0) | (self.wiring.n_negated < 2)
            words = "above 0 in an AND of two inhibitors or more, which is divided by it"
            _check("weight", self.weight, is_finite, words, "reaction", reactions)

    def saturating(self, most: np.ndarray) -> tuple[str, ...]:
        """Return the species above 1, by largest activities (..., n_species) [1], that a reaction counts as 1 there.

        Those are reactions whose act has a pole above 1.
        """
        species, reaction, _ = self.wiring.edges
        is_cut = (np.asarray(self.ec50) ** np.asarray(self.n) > 0.5)[..., reaction]
        is_cut = is_cut & (most[..., species] > 1.0)
        which = species[is_cut.reshape(-1, len(species)).any(axis=0)]
        return tuple(self.species[k] for k in np.unique(which))

    @property
    def species(self) -> tuple[str, ...]:
        """Names of the states (n_species,)."""
        return self.wiring.species

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the species X with a reaction ``=> X`` (n_inputs,)."""
        return self.wiring.input_names

    @property
    def is_time_dependent(self) -> bool:
        """Return False: the rates do not depend explicitly on time."""
        return False

    @property
    def differentiable(self) -> dict[str, tuple[str, ...]]:
        """Names of the parameter fields, each with the species or reactions of its values."""
        species, reactions = self.wiring.species, self.wiring.reactions
        return {"y_max": species, "tau": species, "weight": reactions, "n": reactions, "ec50": reactions}

    def rate(self, y: Array, inputs: Array | None = None, time: Array | float = 0.0) -> Array:
        """Return dy/dt at activities (..., n_species) [1] -> (..., n_species) [1/s].

        ``inputs`` (..., n_inputs) [1] replace the weights of the reactions ``=> X``, in the order of ``input_names``.
        Leading axes of states, inputs and parameters broadcast. ``time`` is not used.
        """
        return self.under(inputs).rate(y, time)

    def activation(self, y: Array, inputs: Array | None = None) -> Array:
        """Return F, the activation of every species, at activities (..., n_species) [1] -> (..., n_species) [1]."""
        bound = self.under(inputs)
        return jnp.moveaxis(bound.driven(_first(y), _width(y, bound.lead)), 0, -1)

    def under(self, inputs: Array | None = None) -> HillRates:
        """Return the rates with fixed inputs (..., n_inputs) [1]; terms that do not depend on the state are computed once."""
        _, reaction, is_negated = self.wiring.edges
        weight, n = self._weights(inputs), jnp.asarray(self.n)
        half = jnp.maximum(jnp.asarray(self.ec50) ** self.n, TINY)
        is_plain = self.inhibition == "weighted" or not is_negated.any()
        return HillRates(
            self.wiring,
            _first(self.y_max),
            _first(self.tau),
            _first(n)[reaction],
            _first(half / (1.0 - half))[reaction],
            _first((1.0 - 2.0 * half) / (1.0 - half))[reaction],
            _first(_most(half))[reaction],
            None if is_plain else _first(weight)[reaction[is_negated]],
            _first(weight if is_plain else _power(weight, 1 - self.wiring.n_negated)),
        )

    @property
    def shown(self) -> tuple[str, ...]:
        """Names of what is part of a result besides the states: none."""
        return ()

    def begin(self, own: Array, inputs: Array) -> Array:
        """Return the initial state (n_species,): inputs do not change it."""
        return own

    def carried(self, y: Array, before: Array, after: Array) -> Array:
        """Return a state (..., n_species) just after the inputs change: the same one."""
        return y

    def observe(self, y: Array, inputs: Array, time: Array | float = 0.0) -> Array:
        """Return what is ``shown`` (..., 0)."""
        return jnp.asarray(y)[..., :0]

    def _weights(self, inputs: Array | None) -> Array:
        """Return the weights (..., n_reactions), with the inputs in place of the weights of ``=> X``."""
        weight = jnp.asarray(self.weight)
        if inputs is None or not self.input_names:
            return weight
        put = jnp.asarray(inputs)
        lead = np.broadcast_shapes(weight.shape[:-1], put.shape[:-1])
        weight = jnp.broadcast_to(weight, (*lead, weight.shape[-1]))
        return weight.at[..., self.wiring.input_reactions].set(put)


class HillRates(eqx.Module):
    """Rates of a network with fixed parameters and inputs; batch axes come last, so that every species is a contiguous row."""

    wiring: Wiring = eqx.field(static=True)
    y_max: Array
    tau: Array
    n: Array
    """Hill exponent of every edge, that is of every factor of a reaction (n_edges, ...)."""
    offset: Array
    slope: Array
    """Coefficients of act / w = x^n / (offset + slope x^n) of every edge: ``offset`` and ``slope`` (n_edges, ...)."""
    most: Array
    """Largest x^n of every edge (n_edges, ...): just above 1 where act has a pole, else infinite."""
    weight: Array | None
    """Weight of every negated edge if NOT is 1 - act; None if NOT is w - act."""
    scale: Array
    """Multiplier of the product of each reaction's factors (n_reactions, ...)."""

    @property
    def lead(self) -> tuple[int, ...]:
        """Batch shape of parameters and inputs."""
        arrays = (self.y_max, self.tau, self.n, self.offset, self.slope, self.scale)
        return np.broadcast_shapes(*(array.shape[1:] for array in arrays))

    def rate(self, y: Array, time: Array | float = 0.0) -> Array:
        """Return dy/dt at activities (..., n_species) [1] -> (..., n_species) [1/s]."""
        width, rows = _width(y, self.lead), _first(y)
        F = self.driven(rows, width)
        rate = (F * _wide(self.y_max, width) - _wide(rows, width)) / _wide(self.tau, width)
        return jnp.moveaxis(rate, 0, -1)

    def driven(self, y: Array, width: int) -> Array:
        """Return the activation F (n_species, ...) [1] at activities (n_species, ...) [1]; both get ``width`` batch axes."""
        species, _, is_negated = self.wiring.edges
        log = jnp.log(jnp.maximum(_wide(y, width), TINY))
        x = jnp.minimum(jnp.exp(_wide(self.n, width) * _rows(log, species)), _wide(self.most, width))
        hill = x / (_wide(self.offset, width) + _wide(self.slope, width) * x)
        given, taken = hill[: (~is_negated).sum()], hill[(~is_negated).sum() :]
        if self.weight is not None:
            taken = _wide(self.weight, width) * taken
        shape = np.broadcast_shapes(given.shape[1:], taken.shape[1:])
        factor = jnp.concatenate([jnp.broadcast_to(part, (len(part), *shape)) for part in (given, 1.0 - taken)])
        flow = _wide(self.scale, width) * _gathered_product(factor, self.wiring.factors_of)
        return 1.0 - _gathered_product(1.0 - flow, self.wiring.reactions_into)


def _most(half: Array) -> Array:
    """Return the largest x^n of every reaction from E^n, at which the denominator of act is less than 1 by :data:`BEYOND`."""
    falls = (2.0 * half - 1.0) / (1.0 - half)
    return jnp.where(half > 0.5, 1.0 + BEYOND / jnp.maximum(falls, 1.0), jnp.inf)


def _power(weight: Array, exponent: np.ndarray) -> Array:
    """Raise weights (..., n_reactions) to powers given by integer exponents (n_reactions,), each at most 1."""
    safe = jnp.where(exponent < 0, weight, 1.0)
    return jnp.where(exponent == 1, weight, safe ** jnp.minimum(exponent, 0))


def _rows(rows: Array, which: np.ndarray) -> Array:
    return rows.at[which].get(mode="promise_in_bounds")


def _gathered_product(rows: Array, members: np.ndarray) -> Array:
    """Multiply rows (n, ...) over the indices ``members`` (m, most) -> (m, ...); index n stands for the factor 1."""
    rows = jnp.concatenate([rows, jnp.ones((1, *rows.shape[1:]), rows.dtype)])
    product = _rows(rows, members[:, 0])
    for column in members.T[1:]:
        product = product * _rows(rows, column)
    return product


def _first(values: Array) -> Array:
    """Move the last axis to the front: (..., n) -> (n, ...)."""
    return jnp.moveaxis(jnp.asarray(values), -1, 0)


def _width(y: Array, lead: tuple[int, ...]) -> int:
    return max(jnp.ndim(y) - 1, len(lead))


def _wide(rows: Array, width: int) -> Array:
    """Insert axes of length 1 before the batch axes of (n, ...), so that there are ``width`` batch axes."""
    return rows.reshape(rows.shape[0], *(1,) * (width + 1 - rows.ndim), *rows.shape[1:])


def _check(key: str, values: np.ndarray, is_good: np.ndarray, words: str, what: str, names: tuple[str, ...]) -> None:
    if values.shape[-1] != len(names):
        raise InputError(
            f"HillNetwork.{key} must have one value for each {what} ({len(names)}); got {values.shape[-1]}"
        )
    is_good = np.broadcast_to(is_good & np.isfinite(values), np.broadcast_shapes(is_good.shape, values.shape))
    if not np.all(is_good):
        worst = tuple(np.argwhere(~is_good)[0])
        got = np.broadcast_to(values, is_good.shape)[worst]
        raise InputError(f'{what} "{names[worst[-1]]}": {key} must be {words}; got {got:g}')
