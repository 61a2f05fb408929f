"""Interface of a material: stress, tangent and history at one point, derived from a strain energy."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.law import Law

State = Any  # a pytree of arrays with leading shape (...); () for a law without history


class Response(NamedTuple):
    """Stress, consistent tangent and new history of a material at points."""

    P: Array
    """First Piola-Kirchhoff stress (..., 3, 3) [kPa]."""
    A: Array
    """Consistent tangent dP/dF (..., 3, 3, 3, 3) [kPa]."""
    state: State
    """History at the end of the step; the input history is never modified in place."""


@runtime_checkable
class Material(Protocol):
    """Interface of materials: a law, a combination of laws, a representative volume element or a surrogate model.

    A material is a pytree. Its parameters are arrays with one number per point, or one number for all points; its other fields
    are hashable, so that materials of the same structure share compiled code. The leading axes (...) are points, which are
    independent of each other. All methods are called inside ``jax.jit``. :class:`EnergyMaterial` implements
    them from ``energy`` and, for laws with history, ``advance``; :class:`.external.ExternalMaterial` implements them from stress
    and tangent computed outside JAX.
    """

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Compute P [kPa], its consistent tangent dP/dF [kPa] and the history after a step dt [s] that ends at F (..., 3, 3) [1].

        The element matrices are computed from the tangent.
        """
        ...

    def stress(self, F: Array, state: State = ()) -> Array:
        """Compute P at fixed history: F (..., 3, 3) [1] -> (..., 3, 3) [kPa].

        Residuals are computed from P. JAX differentiates it with respect to F where no other tangent is available.
        """
        ...

    def energy(self, F: Array, state: State = ()) -> Array:
        """Compute the stored energy per reference volume at fixed history: F (..., 3, 3) [1] -> (...) [kPa].

        The energy appears in results, is an input of wound healing, and is minimised where Newton's method fails. The law of
        a skin must be twice differentiable by JAX.
        """
        ...

    def end_of_step(self, F: Array, state: State, dt: float) -> tuple[Array, State]:
        """Compute P (..., 3, 3) [kPa] and the history after a step dt [s] that ends at F (..., 3, 3) [1].

        For a material point, JAX differentiates P with respect to F, including the change of history with F.
        """
        ...

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the volume ratio of the stress-free state (...) [1], an initial guess; 1 without swelling or growth."""
        ...

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Return shear and bulk modulus of the initial, stress-free material at points of a shape, (*shape) [kPa].

        Their ratio determines how strictly an element conserves its volume.
        """
        ...

    def has_potential(self) -> bool:
        """Return whether a step has a potential: tangents are then symmetric, and a symmetric solver can be used."""
        ...

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return the initial history of points of a shape, arrays (*shape, ...); ``()`` for a material without history."""
        ...

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Compute the history after a step dt [s] that ends at F (..., 3, 3) [1].

        For materials without history this returns ``state`` unchanged.
        """
        ...

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Compute the work turned into heat in a step dt [s] that ends at F (...) [kPa]; 0 for a material without history."""
        ...

    def growth_tensor(self, state: State = ()) -> Array:
        """Return the growth tensor F_g (..., 3, 3) [1], reference to grown configuration; the identity without growth."""
        ...


class EnergyMaterial(Law):
    """Base class of laws with a strain energy; stress and tangent follow from it by automatic differentiation.

    A subclass defines ``energy``, and ``advance`` and ``initial_state`` if it has a history.
    """

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return the strain energy per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        raise NotImplementedError

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the volume ratio of the stress-free state (...) [1], which solvers use as an initial guess."""
        return jnp.ones(())

    def growth_tensor(self, state: State = ()) -> Array:
        """Return the growth tensor F_g (..., 3, 3) [1], reference to grown configuration; the identity without growth."""
        return jnp.eye(3)

    def has_potential(self) -> bool:
        """Return whether the stress of a step derives from a potential, so that the tangent is symmetric; by default True."""
        return True

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return the initial history of points of a shape, arrays (*shape, ...); () unless a subclass overrides this."""
        return ()

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Return the history after a step dt [s] that ends at F; unchanged unless a subclass overrides this."""
        return state

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Return the energy dissipated as heat in a step dt [s] that ends at F (...) [kPa]; never negative."""
        return jnp.zeros(F.shape[:-2])

    def stress(self, F: Array, state: State = ()) -> Array:
        """Return P = dPsi/dF at points, at fixed history: F (..., 3, 3) [1] -> (..., 3, 3) [kPa]."""
        return jax.grad(lambda G: jnp.sum(self.energy(G, state)))(F)

    def end_of_step(self, F: Array, state: State, dt: float) -> tuple[Array, State]:
        """Return P (..., 3, 3) [kPa] and the history after a step dt [s] that ends at F (..., 3, 3) [1]."""
        after = self.advance(F, state, dt)
        return self.stress(F, after), after

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return P, consistent tangent A and history after a step dt [s] that ends at F (..., 3, 3) [1].

        A is computed by nine directional derivatives for all points together, since points are independent.
        """
        directions = jnp.eye(9).reshape(9, 3, 3)
        P, along, after = jax.linearize(lambda G: self.end_of_step(G, state, dt), F, has_aux=True)
        columns = jax.vmap(lambda d: along(jnp.broadcast_to(d, F.shape)))(directions)
        A = jnp.moveaxis(columns, 0, -1).reshape(*F.shape, 3, 3)
        return Response(P, A, after)

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Return the shear and bulk modulus [kPa] in the stress-free state with the initial history, at points of a shape.

        They are computed from the instantaneous tangent averaged over all rotations of the material; for an isotropic law
        they are its own moduli. The shape may be omitted if all parameters of the law are single numbers.
        """
        side = jnp.broadcast_to(jnp.cbrt(jnp.asarray(self.volume_at_rest(), float)), shape)
        F, initial = side[..., None, None] * jnp.eye(3), self.initial_state(shape)
        if jax.tree.leaves(initial):
            _, along = jax.linearize(lambda F: self.stress(F, initial), F)
            columns = jax.vmap(lambda d: along(jnp.broadcast_to(d, (*shape, 3, 3))))(jnp.eye(9).reshape(9, 3, 3))
            A = jnp.moveaxis(columns, 0, -1).reshape(*shape, 3, 3, 3, 3)
        else:
            A = self.response(F, initial).A
        return isotropic_moduli(A)


def isotropic_moduli(A: Array) -> tuple[Array, Array]:
    """Return shear and bulk modulus (...) [kPa] of a tangent at rest (..., 3, 3, 3, 3) [kPa] averaged over all rotations."""
    volumetric, every = jnp.einsum("...iijj->...", A), jnp.einsum("...ijij->...", A)
    return (3.0 * every - volumetric) / 30.0, volumetric / 9.0


def has_bulk_modulus(law: Law) -> bool:
    """Return whether a law, or a part of it, has a bulk modulus, that is a ``kappa`` above 0."""
    named = jax.tree_util.tree_leaves_with_path(law)
    kappas = [value for path, value in named if getattr(path[-1], "name", "") == "kappa"]
    return any(bool(np.any(np.asarray(value) > 0.0)) for value in kappas if not isinstance(value, jax.core.Tracer))
