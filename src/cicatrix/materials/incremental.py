"""Law without history that represents a law with history during one time step."""

from __future__ import annotations

from jax import Array

from ..core.law import param
from .material import EnergyMaterial, Material, Response, State


class IncrementalMaterial(EnergyMaterial):
    """History-free law to solve for equilibrium at the end of one time step of a law with history.

    The stress is evaluated with the history at the end of the step, and the tangent is the consistent one, which includes the
    change of that history with F: it differs from the second derivative of the energy at fixed history.

    Parameters
    ----------
    law : Material
        Any law, with or without history.
    before : State
        History of the law at the start of the step.
    dt : float or () array [s]
        Length of the step.
    """

    law: Material
    before: State
    dt: float | Array = param("s", "dt", low=0.0)

    def after(self, F: Array) -> State:
        """Return the history at the end of a step whose final deformation is F."""
        return self.law.advance(F, self.before, self.dt)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return the stored energy at the end of the step: F (..., 3, 3) [1] -> (...) [kPa]."""
        return self.law.energy(F, self.after(F))

    def stress(self, F: Array, state: State = ()) -> Array:
        """Return P at the end of the step: F (..., 3, 3) [1] -> (..., 3, 3) [kPa]."""
        return self.law.end_of_step(F, self.before, self.dt)[0]

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and consistent tangent at the end of the step, from the response of the law."""
        P, A, _ = self.law.response(F, self.before, self.dt)  # pyright: ignore[reportArgumentType]
        return Response(P, A, state)

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the stress-free volume ratio of the law at the start of the step."""
        return self.law.volume_at_rest(self.before)

    def has_potential(self) -> bool:
        """Return whether a step of the law has a potential, so that the tangent is symmetric."""
        return self.law.has_potential()

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Return shear and bulk modulus of the law in its initial state (*shape) [kPa], which do not depend on the step."""
        return self.law.moduli_at_rest(shape)
