"""A law with history, during one step of time: a law without."""

from __future__ import annotations

from jax import Array

from ..core.law import param
from .material import EnergyMaterial, Response, State


class Stepped(EnergyMaterial):
    """What mechanics sees of a law with history while it looks for the shape at the end of a step.

    Its stress is the law's once the history has gone on to the end of the step, so that the tangent is the consistent one.
    That is not the derivative of its energy at fixed history alone.

    Parameters
    ----------
    law : EnergyMaterial
        Any law.
    before : State
        Its history at the start of the step.
    dt : float or () array [s]
        Length of the step.
    """

    law: EnergyMaterial
    before: State
    dt: float | Array = param("s", "dt", low=0.0)

    def after(self, F: Array) -> State:
        """History at the end of a step that ends at F."""
        return self.law.advance(F, self.before, self.dt)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Stored energy at the end of the step: F (..., 3, 3) [1] -> (...) [kPa]."""
        return self.law.energy(F, self.after(F))

    def stress(self, F: Array, state: State = ()) -> Array:
        """P at the end of the step: F (..., 3, 3) [1] -> (..., 3, 3) [kPa]."""
        return self.law.stress(F, self.after(F))

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Stress and consistent tangent at the end of the step, as the law gives them."""
        P, A, _ = self.law.response(F, self.before, self.dt)  # pyright: ignore[reportArgumentType]
        return Response(P, A, state)

    def volume_at_rest(self, state: State = ()) -> Array:
        """That of the law at the start of the step."""
        return self.law.volume_at_rest(self.before)

    def has_potential(self) -> bool:
        """As the law's steps have."""
        return self.law.has_potential()

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Those of the law, whatever the step."""
        return self.law.moduli_at_rest(shape)
