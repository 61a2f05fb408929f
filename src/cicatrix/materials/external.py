"""Interface to materials that are computed outside JAX: in NumPy, a C library, a vendor's subroutine, another solver."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero

from ..core.errors import InputError
from ..core.law import Law, param
from ..numerics.host import call_back
from .material import Response, State, isotropic_moduli


class Answer(NamedTuple):
    """NumPy arrays that a material outside JAX returns for n points."""

    energy: np.ndarray
    """Stored energy per reference volume at the end of the step (n,) [kPa]."""
    P: np.ndarray
    """First Piola-Kirchhoff stress at the end of the step (n, 3, 3) [kPa]."""
    A: np.ndarray
    """Consistent tangent dP/dF (n, 3, 3, 3, 3) [kPa], through the change of history in the step."""
    state: np.ndarray | None = None
    """History at the end of the step (n, m), in new arrays; None without history."""
    heat: np.ndarray | None = None
    """Work dissipated as heat in the step (n,) [kPa]; None if there is no dissipation."""


class ExternalMaterial(Law):
    """A material whose stress and tangent are computed by code outside JAX.

    Mechanics calls ``respond(F, state, dt, *parameters)`` with NumPy arrays in double precision: F (n, 3, 3) [1], state (n, m),
    dt a float [s], each parameter (n,). It returns an :class:`Answer`. With dt = 0 it must leave the history unchanged and return
    energy and stress at that history. It may modify the arrays. The solver chooses n, at most the number of points of a body.

    The function must be pure, must not call JAX (the process could deadlock), and must be safe to call from
    several threads if ``CICATRIX_THREADS`` is above 1. Its exceptions reach the caller of the solver unchanged, but a
    :class:`..core.errors.ConvergenceError` makes the solver try a smaller load step. At trial shapes without a solution the
    function should return NaN in P, which makes the solver shorten the Newton step.

    Gradients are available with respect to F only: twice through the energy, once through the stress. With respect to
    parameters, history and dt they raise an InputError. Measured costs: docs/decisions/0027.

    Parameters
    ----------
    respond : callable
        The function described above. It must be hashable; materials with the same function share compiled code.
    parameters : tuple of floats or (...) arrays
        Further arguments of ``respond``, each a number or an array with one number per point.
    initial_history : tuple of float
        Initial history at a point, m numbers; empty for a material without history.
    rest_volume : float or (...) array [1]
        Volume ratio at which the material with its initial history is stress-free. It does not change with the history.
    symmetric : bool
        Whether the consistent tangent has major symmetry, A_iJkL = A_kLiJ.

    Raises
    ------
    InputError
        If ``respond`` cannot be hashed, or (when called) returns arrays of other shapes.
    """

    respond: Callable[..., Answer] = eqx.field(static=True)
    parameters: tuple[float | Array, ...] = ()
    initial_history: tuple[float, ...] = eqx.field(static=True, default=())
    rest_volume: float | Array = param("1", "v", above=0.0, default=1.0)
    symmetric: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        super().__check_init__()
        try:
            hash((self.respond, self.initial_history))
        except TypeError as error:
            raise InputError(f"ExternalMaterial.respond and initial_history must be hashable: {error}.") from None

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return P, its consistent tangent and the history after a step dt [s] that ends at F (..., 3, 3), from ``respond``."""
        P, A, after = _asked(self._outside, ("P", "A", "state"), *self._arguments(F, state, dt))
        return Response(P, A, self._history(after))

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return the stored energy at fixed history: F (..., 3, 3) [1] -> (...) [kPa]; its derivative dPsi/dF is ``stress``."""
        return _energy(self._outside, *self._arguments(F, state, 0.0))

    def stress(self, F: Array, state: State = ()) -> Array:
        """Return P at fixed history: F (..., 3, 3) [1] -> (..., 3, 3) [kPa]; its derivative dP/dF is the tangent at dt = 0."""
        return _stress(self._outside, *self._arguments(F, state, 0.0))[0]

    def end_of_step(self, F: Array, state: State, dt: float) -> tuple[Array, State]:
        """Return P and history after a step; the derivative dP/dF is the consistent tangent.

        The history cannot be differentiated: its derivative is NaN.
        """
        P, after = _stress(self._outside, *self._arguments(F, state, dt))
        return P, self._history(after)

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Return the history after a step dt [s] that ends at F (..., 3, 3) [1] -> (..., m); it has no derivatives."""
        return _advanced(self._outside, *self._arguments(F, state, dt)) if self.initial_history else state

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Return the work turned into heat in a step dt [s] that ends at F (...) [kPa]; it has no derivatives."""
        if not self.initial_history:
            return jnp.zeros(F.shape[:-2])
        return _asked(self._outside, ("heat",), *self._arguments(F, before, dt))[0]

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return ``initial_history`` at every point, (*shape, m)."""
        return (
            jnp.broadcast_to(jnp.asarray(self.initial_history, float), (*shape, len(self.initial_history)))
            if self.initial_history
            else ()
        )

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the volume ratio of the stress-free material (...) [1], the parameter ``rest_volume``."""
        return jnp.asarray(self.rest_volume, float)

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Return shear and bulk modulus at rest (*shape) [kPa], from the initial tangent averaged over all rotations."""
        side = jnp.broadcast_to(jnp.cbrt(self.volume_at_rest()), shape)
        return isotropic_moduli(self.response(side[..., None, None] * jnp.eye(3), self.initial_state(shape)).A)

    def has_potential(self) -> bool:
        """Return whether the tangent is symmetric, the parameter ``symmetric``."""
        return self.symmetric

    def growth_tensor(self, state: State = ()) -> Array:
        """Return the identity (3, 3): the material does not grow."""
        return jnp.eye(3)

    @property
    def _outside(self) -> _Outside:
        return _Outside(self.respond, len(self.initial_history))

    def _arguments(self, F: Array, state: State, dt: float) -> tuple[Array, ...]:
        """Return F (*shape, 3, 3), history (*shape, m), dt () and the parameters, each parameter broadcast to (*shape)."""
        shape = F.shape[:-2]
        history = self.initial_state(shape) if isinstance(state, tuple) else state
        history = (
            jnp.broadcast_to(history, (*shape, len(self.initial_history)))
            if self.initial_history
            else jnp.zeros((*shape, 0))
        )
        parameters = (jnp.broadcast_to(jnp.asarray(value, float), shape) for value in self.parameters)
        return F, history, jnp.asarray(dt, float), *parameters

    def _history(self, after: Array) -> State:
        return after if self.initial_history else ()


@dataclass(frozen=True)
class _Outside:
    """Parts of an external material on which compiled code depends: its function and the number of its history variables."""

    respond: Callable[..., Answer]
    n_history: int


SHAPES = {"energy": (), "P": (3, 3), "A": (3, 3, 3, 3), "heat": ()}


@dataclass(frozen=True)
class _Question:
    """Callback that evaluates an external material in Python and returns the named fields of its :class:`Answer`."""

    outside: _Outside
    fields: tuple[str, ...]

    def shape(self, field: str) -> tuple[int, ...]:
        """Return the shape of a field at one point."""
        return (self.outside.n_history,) if field == "state" else SHAPES[field]

    def __call__(self, F: np.ndarray, state: np.ndarray, dt: np.ndarray, *parameters: np.ndarray) -> list[np.ndarray]:
        """Flatten all leading axes (also those of ``jax.vmap``), call ``respond``, and restore the axes."""
        if np.ptp(dt) if dt.size else False:
            raise InputError("ExternalMaterial: all points of one call must have the same dt.")
        points = np.broadcast_shapes(F.shape[:-2], state.shape[:-1], *(value.shape for value in parameters))
        n = math.prod(points)
        given = (_flat(F, points, 2), _flat(state, points, 1), *(_flat(value, points, 0) for value in parameters))
        answer = self.outside.respond(*given[:2], float(dt.flat[0]), *given[2:]) if n else None
        return [self._field(answer, field, n).reshape((*points, *self.shape(field))) for field in self.fields]

    def _field(self, answer: Answer | None, field: str, n: int) -> np.ndarray:
        """Return one field of the answer as an array (n, ...); zeros for a history or heat that the material does not have."""
        shape = (n, *self.shape(field))
        value = None if answer is None else getattr(answer, field)
        if value is None and (n == 0 or field == "heat" or shape == (n, 0)):
            return np.zeros(shape)
        found = np.asarray(value, float)
        if found.shape != shape:
            raise InputError(f"ExternalMaterial.respond must return {field} of shape {shape}; got {found.shape}.")
        return found


def _flat(values: np.ndarray, points: tuple[int, ...], own: int) -> np.ndarray:
    """Broadcast an array over all points, flatten its leading axes and return a contiguous copy (n, ...).

    ``points`` is the shape of all points, n their number; the last ``own`` axes are those of the quantity at one point.
    """
    shape = values.shape[values.ndim - own :]
    return np.array(np.broadcast_to(values, (*points, *shape)).reshape((math.prod(points), *shape)), order="C")


def _asked(outside: _Outside, fields: tuple[str, ...], F: Array, *others: Array) -> list[Array]:
    question = _Question(outside, fields)
    return call_back(question, [(*F.shape[:-2], *question.shape(field)) for field in fields], F, *others)


def _by_F_alone(tangents: tuple) -> Array:
    """Return the JAX tangent of F; raise an InputError if another argument has a tangent too."""
    F, *others = tangents
    if not all(isinstance(other, SymbolicZero) for other in others):
        raise InputError(
            "ExternalMaterial has derivatives by F only: hold its parameters, history and dt with jax.lax.stop_gradient."
        )
    return jnp.zeros(F.shape) if isinstance(F, SymbolicZero) else F


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _energy(outside: _Outside, F: Array, *others: Array) -> Array:
    return _asked(outside, ("energy",), F, *others)[0]


@partial(_energy.defjvp, symbolic_zeros=True)
def _energy_rate(outside: _Outside, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    P, _ = _stress(outside, *primals)
    return _energy(outside, *primals), jnp.sum(P * _by_F_alone(tangents), axis=(-2, -1))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _stress(outside: _Outside, F: Array, *others: Array) -> tuple[Array, Array]:
    """Return P (..., 3, 3) [kPa] and the history (..., m) at the end of a step; ``others`` are history, dt and parameters."""
    P, after = _asked(outside, ("P", "state"), F, *others)
    return P, after


@partial(_stress.defjvp, symbolic_zeros=True)
def _stress_rate(outside: _Outside, primals: tuple, tangents: tuple) -> tuple[tuple, tuple]:
    P, A, after = _asked(outside, ("P", "A", "state"), *primals)
    dP = jnp.sum(A * _by_F_alone(tangents)[..., None, None, :, :], axis=(-2, -1))
    return (P, after), (dP, jnp.full_like(after, jnp.nan))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _advanced(outside: _Outside, F: Array, *others: Array) -> Array:
    return _asked(outside, ("state",), F, *others)[0]


@partial(_advanced.defjvp, symbolic_zeros=True)
def _advanced_rate(outside: _Outside, primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    if not all(isinstance(tangent, SymbolicZero) for tangent in tangents):
        raise InputError(
            "ExternalMaterial has no derivatives of its history: in a material point it must stand by itself, and nothing that "
            "grows or flows may be made of it."
        )
    after = _advanced(outside, *primals)
    return after, jnp.zeros_like(after)
