"""Laws made of laws."""

from __future__ import annotations

from jax import Array

from .material import EnergyMaterial, Response, State


class Sum(EnergyMaterial):
    """Energies that add up, each with its own history."""

    parts: tuple[EnergyMaterial, ...]

    def energy(self, F: Array, state: State = ()) -> Array:
        """Sum of the parts' energies: F (..., 3, 3) [1] -> (...) [kPa]."""
        return sum(part.energy(F, s) for part, s in self._with(state))  # pyright: ignore[reportReturnType]

    def volume_at_rest(self, state: State = ()) -> Array:
        """That of the first part, which is to be the one that bears volume change."""
        part, history = self._with(state)[0]
        return part.volume_at_rest(history)

    def growth_tensor(self, state: State = ()) -> Array:
        """That of the first part."""
        part, history = self._with(state)[0]
        return part.growth_tensor(history)

    def has_potential(self) -> bool:
        """Where all parts have one."""
        return all(part.has_potential() for part in self.parts)

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """The parts' histories, in order."""
        return tuple(part.initial_state(shape) for part in self.parts)

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Advance every part."""
        return tuple(part.advance(F, s, dt) for part, s in self._with(state))

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Sum of the parts' answers, each in the cheapest way that it knows."""
        answers = [part.response(F, s, dt) for part, s in self._with(state)]
        P, A = (sum(answer[which] for answer in answers) for which in (0, 1))
        return Response(P, A, tuple(answer.state for answer in answers))

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Sum over the parts."""
        both = zip(self._with(before), self._with(after), strict=True)
        return sum(part.dissipated(F, old, new, dt) for (part, old), (_, new) in both)  # pyright: ignore[reportReturnType]

    def _with(self, state: State) -> list[tuple[EnergyMaterial, State]]:
        return list(zip(self.parts, state or ((),) * len(self.parts), strict=True))
