"""Interface between the healing cycle and a model of wound healing, and the state of the tissue that the cycle advances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from ..mechanics.body import Body

H = TypeVar("H")
"""State of a model of wound healing."""


@dataclass(frozen=True, eq=False)
class TissueState(Generic[H]):
    """State of a healing wound: all data that change in time, which a checkpoint stores and from which a restart begins.

    Parameters
    ----------
    cycle : int
        Number of cycles done.
    healing : H
        State of the model of wound healing.
    x : (n_nodes, 3) array [mm]
        Loaded positions in the healing position, including nodes in the open cavity.
    newton_iterations : int
        Iterations of the mechanics in the last cycle.
    W_ref : float [kPa]
        Mean strain energy density over the edge of the fresh wound.
    closure_days : float [days]
        Time at which the last open site was filled; below 0 while the wound is open.
    """

    cycle: int
    healing: H
    x: np.ndarray
    newton_iterations: int
    W_ref: float = 0.0
    closure_days: float = -1.0

    @property
    def is_closed(self) -> bool:
        """Whether no open site is left."""
        return self.closure_days >= 0.0


class Advance(NamedTuple, Generic[H]):
    """Result of healing over one cycle."""

    healing: H
    """State of the model at the end of the cycle."""
    closure_days: float
    """Time of closure [days], as in ``TissueState``; below 0 while the wound is open."""
    x: np.ndarray | None = None
    """Shape (n_nodes, 3) [mm], if the model solves the mechanics itself; None: the cycle solves them."""
    iterations: int = 0
    """Number of Newton iterations of the mechanics within the model."""


class Healing(Protocol[H]):
    """Interface of a model of wound healing on one body, as used by the healing cycle.

    A model never changes the states that it is given. Sites are those of the ruler (:class:`.ruler.Ruler`).
    """

    @property
    def closes(self) -> str:
        """Text that says when the wound counts as closed."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the run's manifest about the model on this body."""
        ...

    def fresh(self, x: np.ndarray, x_intact: np.ndarray) -> H:
        """Return the state right after surgery.

        x, x_intact (n_nodes, 3) [mm]: loaded shapes with the open cavity and before surgery. If the state already has
        tissue in the cavity, the cycle solves for the shape again.
        """
        ...

    def advance(self, state: TissueState[H], until: float) -> Advance[H]:
        """Heal from the end of the last cycle until a time [days], under the deformation ``state.x``.

        Raises
        ------
        ConvergenceError
            If the model finds no solution.
        """
        ...

    def is_over(self, state: TissueState[H]) -> bool:
        """Check whether the simulation of healing is complete."""
        ...

    def body(self, state: H) -> Body:
        """Return the body with its present tissue: constitutive law, density and fraction in each element."""
        ...

    def occupancy(self, state: H) -> np.ndarray:
        """Return the sites that are filled with tissue: bool array of the lattice's shape."""
        ...

    def filled(self, state: H) -> np.ndarray:
        """Return the fraction of each element that is tissue (n_elements,) [1]."""
        ...

    def shown(self, state: H) -> dict[str, np.ndarray]:
        """Return further fields for the result files, by name: arrays (n_elements,)."""
        ...

    def measured(self, state: TissueState[H]) -> dict[str, float]:
        """Return further columns for the history, by name."""
        ...

    def pack(self, state: H) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the state as named arrays, and scalars that JSON can store."""
        ...

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> H:
        """Return the state that ``pack`` stored, to the bit."""
        ...
