"""Laws made of laws."""

from __future__ import annotations

from jax import Array

from .material import EnergyMaterial, State


class Sum(EnergyMaterial):
    """Energies that add up, each with its own history."""

    parts: tuple[EnergyMaterial, ...]

    def energy(self, F: Array, state: State = ()) -> Array:
        """Sum of the parts' energies: F (..., 3, 3) [1] -> (...) [kPa]."""
        return sum(part.energy(F, s) for part, s in zip(self.parts, state or ((),) * len(self.parts), strict=True))  # pyright: ignore[reportReturnType]

    def volume_at_rest(self) -> Array:
        """That of the first part, which is to be the one that bears volume change."""
        return self.parts[0].volume_at_rest()

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """The parts' histories, in order."""
        return tuple(part.initial_state(shape) for part in self.parts)

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Advance every part."""
        return tuple(p.advance(F, s, dt) for p, s in zip(self.parts, state or ((),) * len(self.parts), strict=True))
