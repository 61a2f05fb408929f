"""Constitutive law whose energy is the sum of the energies of several laws."""

from __future__ import annotations

from jax import Array

from .material import EnergyMaterial, Material, Response, State


class Sum(EnergyMaterial):
    """Law whose energy is the sum of the energies of several laws, its parts; each part has its own history."""

    parts: tuple[Material, ...]

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return the sum of the energies of the parts: F (..., 3, 3) [1] -> (...) [kPa]."""
        return sum(part.energy(F, s) for part, s in self._with(state))  # pyright: ignore[reportReturnType]

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the stress-free volume ratio of the first part; the part with the bulk modulus must come first."""
        part, history = self._with(state)[0]
        return part.volume_at_rest(history)

    def growth_tensor(self, state: State = ()) -> Array:
        """Return the growth tensor F_g (..., 3, 3) [1] of the first part; a part that grows must come first."""
        part, history = self._with(state)[0]
        return part.growth_tensor(history)

    def has_potential(self) -> bool:
        """Return True if a step of every part has a potential, so that the tangent of the sum is symmetric."""
        return all(part.has_potential() for part in self.parts)

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return the initial histories of the parts at points of a given shape: a tuple in the order of the parts."""
        return tuple(part.initial_state(shape) for part in self.parts)

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Return the histories of all parts after a step dt [s] that ends at F (..., 3, 3) [1]."""
        return tuple(part.advance(F, s, dt) for part, s in self._with(state))

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress and tangent, each the sum over the parts, and the new histories, from the ``response`` of every part."""
        answers = [part.response(F, s, dt) for part, s in self._with(state)]
        P, A = (sum(answer[which] for answer in answers) for which in (0, 1))
        return Response(P, A, tuple(answer.state for answer in answers))

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Return the work that all parts together dissipate as heat in a step dt [s] that ends at F (...) [kPa]."""
        both = zip(self._with(before), self._with(after), strict=True)
        return sum(part.dissipated(F, old, new, dt) for (part, old), (_, new) in both)  # pyright: ignore[reportReturnType]

    def _with(self, state: State) -> list[tuple[Material, State]]:
        return list(zip(self.parts, state or ((),) * len(self.parts), strict=True))
