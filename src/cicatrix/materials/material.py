"""What a material is: stress, tangent and history at one point, derived from an energy."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.law import Law

State = Any  # a pytree of arrays with leading shape (...); () for a law without history


class Response(NamedTuple):
    """Answer of a material at points."""

    P: Array
    """First Piola-Kirchhoff stress (..., 3, 3) [kPa]."""
    A: Array
    """Consistent tangent dP/dF (..., 3, 3, 3, 3) [kPa]."""
    state: State
    """History at the end of the step; never the input mutated."""


class Material(Protocol):
    """Law, composition or surrogate: mechanics cannot tell and need not."""

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """History of virgin material at points of the given shape."""
        ...

    def advance(self, F: Array, state: State, dt: float) -> State:
        """History after a step dt [s] that ends at F."""
        ...

    def stress(self, F: Array, state: State) -> Array:
        """P at points: F (..., 3, 3) [1] -> (..., 3, 3) [kPa]."""
        ...

    def response(self, F: Array, state: State, dt: float) -> Response:
        """Stress, consistent tangent and new history."""
        ...


class EnergyMaterial(Law):
    """A hyperelastic law: write ``energy`` (and ``advance``, if history matters), get the rest."""

    def energy(self, F: Array, state: State = ()) -> Array:
        """Strain energy per reference volume: F (..., 3, 3) [1] -> (...) [kPa]."""
        raise NotImplementedError

    def volume_at_rest(self, state: State = ()) -> Array:
        """Volume ratio of the stress-free state (...) [1]: about where a solver may look for the loaded one."""
        return jnp.ones(())

    def growth_tensor(self, state: State = ()) -> Array:
        """F_g, reference to grown, of a law that grows (..., 3, 3) [1]; the identity of any other."""
        return jnp.eye(3)

    def has_potential(self) -> bool:
        """Whether a step of it follows from a potential, so that its tangent is symmetric; that of growth does not."""
        return True

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """No history unless the law says otherwise."""
        return ()

    def advance(self, F: Array, state: State, dt: float) -> State:
        """History after a step dt [s] that ends at F; none unless the law says otherwise."""
        return state

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Work turned into heat in a step dt [s] that ends at F (...) [kPa]; never negative."""
        return jnp.zeros(F.shape[:-2])

    def stress(self, F: Array, state: State = ()) -> Array:
        """P = dPsi/dF at points, the history held: F (..., 3, 3) [1] -> (..., 3, 3) [kPa]."""
        return jax.grad(lambda G: jnp.sum(self.energy(G, state)))(F)

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Stress, tangent dP/dF and new history; points are independent, so nine directional derivatives give A."""

        def stress(G: Array) -> tuple[Array, State]:
            after = self.advance(G, state, dt)
            return self.stress(G, after), after

        directions = jnp.eye(9).reshape(9, 3, 3)
        P, along, after = jax.linearize(stress, F, has_aux=True)
        columns = jax.vmap(lambda d: along(jnp.broadcast_to(d, F.shape)))(directions)
        A = jnp.moveaxis(columns, 0, -1).reshape(*F.shape, 3, 3)
        return Response(P, A, after)

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Shear and bulk modulus [kPa] of virgin material where it is free of stress, at points of a shape.

        Those of the instantaneous tangent there, averaged over all turns of the material: an isotropic law's own. Of a law
        whose parameters are single numbers the shape may be left out.
        """
        side = jnp.broadcast_to(jnp.cbrt(jnp.asarray(self.volume_at_rest(), float)), shape)
        F, virgin = side[..., None, None] * jnp.eye(3), self.initial_state(shape)
        if jax.tree.leaves(virgin):
            _, along = jax.linearize(lambda F: self.stress(F, virgin), F)
            columns = jax.vmap(lambda d: along(jnp.broadcast_to(d, (*shape, 3, 3))))(jnp.eye(9).reshape(9, 3, 3))
            A = jnp.moveaxis(columns, 0, -1).reshape(*shape, 3, 3, 3, 3)
        else:
            A = self.response(F, virgin).A
        volumetric, every = jnp.einsum("...iijj->...", A), jnp.einsum("...ijij->...", A)
        return (3.0 * every - volumetric) / 30.0, volumetric / 9.0


def has_bulk_modulus(law: Law) -> bool:
    """Whether a law, or a part of it, bears change of volume: its ``kappa`` is above 0."""
    named = jax.tree_util.tree_leaves_with_path(law)
    kappas = [value for path, value in named if getattr(path[-1], "name", "") == "kappa"]
    return any(bool(np.any(np.asarray(value) > 0.0)) for value in kappas if not isinstance(value, jax.core.Tracer))
