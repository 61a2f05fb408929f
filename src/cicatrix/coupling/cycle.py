"""Healing cycle (Garbey et al., Fig. 3): solve for the loaded shape, heal at that deformation, update the tissue, repeat."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Generic, final

import numpy as np

from ..core.named import part, prefixed
from ..mechanics.body import Body
from ..mechanics.equilibrium import Equilibrium
from ..mechanics.extension import Extension
from .cavity import Cavity
from .healing import H, Healing, TissueState
from .ruler import Ruler


@final
@dataclass(frozen=True, eq=False)
class HealingCycle(Generic[H]):
    """Healing cycle: the order of the solves, and all data that stay constant while a wound heals.

    Parameters
    ----------
    cavity : Cavity
        The body before surgery, and the part of it that surgery removes.
    x_intact : (n_nodes, 3) array [mm]
        Loaded shape before surgery in the healing position.
    gravity : (3,) array [mm/s^2]
        Gravity in the healing position, in the body's axes.
    ruler : Ruler
        Lattice that measures the wound.
    healing : Healing
        Model of wound healing.
    equilibrium : Equilibrium
        Mechanical solver.
    days_per_cycle : float [days]
        Time between mechanical solves.
    """

    cavity: Cavity
    x_intact: np.ndarray
    gravity: np.ndarray
    ruler: Ruler
    healing: Healing[H]
    equilibrium: Equilibrium
    days_per_cycle: float

    @property
    def intact(self) -> Body:
        """The body before surgery."""
        return self.cavity.intact

    @property
    def X(self) -> np.ndarray:
        """Unloaded shape, the reference of the mechanics and of the lattice (n_nodes, 3) [mm]."""
        return self.cavity.X

    @cached_property
    def opened(self) -> Body:
        """The body with the open cavity."""
        return self.cavity.body(self.ruler.filled(self.ruler.fresh), self.cavity.unstrained)

    @cached_property
    def extension(self) -> Extension:
        """Extension of the displacements into the open cavity."""
        return Extension(self.intact.discretization, self.X)

    def start(self) -> TissueState[H]:
        """Open the cavity, find the body's new shape, and return the state right after surgery.

        Raises
        ------
        ConvergenceError
            If no equilibrium is found.
        """
        x, iterations = self._loaded(self.opened, self.x_intact)
        fresh = self.ruler.fresh
        W_ref = self.ruler.edge_energy(self.opened, self.X, x, self.ruler.filled(fresh), fresh)
        state = TissueState(0, self.healing.fresh(x, self.x_intact), x, iterations, W_ref)
        if not (self.body(state).fraction > self.opened.fraction).any():
            return state
        return self._equilibrated(replace(state, newton_iterations=0))

    def step(self, state: TissueState[H]) -> TissueState[H]:
        """Heal over one cycle, then find the shape of the body with its new tissue.

        Raises
        ------
        ConvergenceError
            If the model of wound healing finds no solution, or the body no equilibrium.
        """
        done = self.healing.advance(state, self.days(state.cycle + 1))
        x = state.x if done.x is None else done.x
        new = TissueState(state.cycle + 1, done.healing, x, done.iterations, state.W_ref, done.closure_days)
        return self._equilibrated(new) if done.x is None else new

    def is_over(self, state: TissueState[H]) -> bool:
        """Check whether the simulation of healing is complete."""
        return self.healing.is_over(state)

    def _equilibrated(self, state: TissueState[H]) -> TissueState[H]:
        """Return the state with the equilibrium shape of its tissue; Newton's method starts from the shape in the given state."""
        x, iterations = self._loaded(self.body(state), state.x)
        return replace(state, x=x, newton_iterations=state.newton_iterations + iterations)

    def _loaded(self, body: Body, start: np.ndarray) -> tuple[np.ndarray, int]:
        """Return a body's loaded shape in the healing position (n_nodes, 3) [mm], and the number of Newton iterations."""
        x, report = self.equilibrium.loaded(body, self.X, self.gravity, start)
        return self.extension.fill(x, body.fraction), report.iterations

    def days(self, cycle: int) -> float:
        """Return the time at the end of a cycle [days]."""
        return cycle * self.days_per_cycle

    def body(self, state: TissueState[H]) -> Body:
        """Return the body with its present tissue."""
        return self.healing.body(state.healing)

    def occupancy(self, state: TissueState[H]) -> np.ndarray:
        """Return the sites that are filled with tissue: bool array of the lattice's shape."""
        return self.healing.occupancy(state.healing)

    def open_sites(self, state: TissueState[H]) -> np.ndarray:
        """Return the sites that are not filled yet: bool array of the lattice's shape."""
        return self.ruler.open_sites(self.occupancy(state))

    def filled(self, state: TissueState[H]) -> np.ndarray:
        """Return the fraction of each element that is tissue (n_elements,) [1]."""
        return self.healing.filled(state.healing)

    def edge_energy(self, state: TissueState[H]) -> float:
        """Return the mean strain energy density over the edge of the open wound [kPa]; 0 when the wound is closed."""
        return self.ruler.edge_energy(self.body(state), self.X, state.x, self.filled(state), self.occupancy(state))

    def shown(self, state: TissueState[H]) -> dict[str, np.ndarray]:
        """Return the fields for the result files, by name: arrays (n_elements,)."""
        return {"filled_fraction": self.filled(state), **self.healing.shown(state.healing)}

    def pack(self, state: TissueState[H]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return a state as named arrays, and scalars that JSON can store."""
        arrays, scalars = self.healing.pack(state.healing)
        return {"x": state.x} | prefixed("healing", arrays), {
            "cycle": state.cycle,
            "newton_iterations": state.newton_iterations,
            "W_ref": state.W_ref,
            "closure_days": state.closure_days,
            "healing": scalars,
        }

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> TissueState[H]:
        """Return the state that ``pack`` stored, to the bit."""
        return TissueState(
            scalars["cycle"],
            self.healing.unpack(part("healing", arrays), scalars["healing"]),
            arrays["x"],
            scalars["newton_iterations"],
            scalars["W_ref"],
            scalars["closure_days"],
        )


def run(cycle: HealingCycle[H], state: TissueState[H], last_cycle: int) -> Iterator[TissueState[H]]:
    """Run cycles from a given state; yield the state after each cycle until healing is over or ``last_cycle`` is done."""
    while state.cycle < last_cycle and not cycle.is_over(state):
        state = cycle.step(state)
        yield state
