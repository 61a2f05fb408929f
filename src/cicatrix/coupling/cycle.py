"""The healing cycle (Garbey et al., Fig. 3): loaded solve, energy to the lattice, healing, filled tissue, and again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..geometry.transfer import SiteMap, linear_fit
from ..healing.automaton import Automaton, AutomatonState
from ..healing.continuum import Course
from ..healing.model import Cue
from ..materials.active import Contraction
from ..materials.compose import Sum
from ..materials.growth import NaturalConfiguration
from ..materials.neo_hookean import NeoHookean
from ..mechanics.body import Body, deformation_gradients
from ..mechanics.equilibrium import Equilibrium
from ..mechanics.extension import Extension
from .deposition import Deposition

LEAST_FILLED = 0.05  # an element with less tissue than this share is out of the mechanics
WELL_FILLED = 0.5  # an element with less is too soft, as a whole, to say what its cells feel


@dataclass(frozen=True, eq=False)
class Tissue:
    """Elastic constants and density of a tissue at quadrature points; numbers or (n_elements, n_qp) arrays."""

    mu: np.ndarray
    """Shear modulus [kPa]."""
    kappa: np.ndarray
    """Bulk modulus [kPa]."""
    density: np.ndarray
    """Mass per reference volume [kg/mm^3]."""


@dataclass(frozen=True, eq=False)
class TissueState:
    """Everything that changes: a checkpoint is this, a restart begins from it.

    Parameters
    ----------
    cycle : int
        Cycles done.
    healing : AutomatonState
        Cells.
    filled : (n_elements,) array [1]
        Share of each element that is tissue.
    natural : (n_elements, n_qp, 3, 3) array [1]
        Natural configuration of the tissue.
    x : (n_nodes, 3) array [mm]
        Loaded positions in the healing position, the open cavity moved along.
    newton_iterations : int
        Of the last solve.
    W_ref : float [kPa]
        Mean energy over the fresh wound edge.
    closure_days : float [days]
        When the last open site was filled; below 0 while the wound is open.
    course : Course, optional
        Of healing by fields.
    """

    cycle: int
    healing: AutomatonState
    filled: np.ndarray
    natural: np.ndarray
    x: np.ndarray
    newton_iterations: int
    W_ref: float = 0.0
    closure_days: float = -1.0
    course: Course | None = None

    @property
    def is_closed(self) -> bool:
        """No open site is left."""
        return self.closure_days >= 0.0


@dataclass(frozen=True, eq=False)
class HealingCycle:
    """What does not change while a wound heals.

    Parameters
    ----------
    intact : Body
        The body before surgery.
    X : (n_nodes, 3) array [mm]
        Its unloaded shape: the reference of mechanics and lattice alike.
    x_intact : (n_nodes, 3) array [mm]
        Its loaded shape in the healing position.
    gravity : (3,) array [mm/s^2]
        In the healing position, in the body's axes.
    tissue, scar : Tissue
        What is there before surgery, and what grows in the cavity.
    cavity : (n_elements,) bool array
        Elements taken out.
    contraction : float [kPa]
        Pull of new tissue.
    automaton : Automaton
        Healing model on the lattice of the unloaded reference.
    sites : SiteMap
        Element of each lattice site.
    deposition : Deposition
        Stress-free state of new tissue.
    days_per_cycle, days_per_step : float [days]
        Time between mechanical solves, and of one automaton step.
    equilibrium : Equilibrium
        Mechanical solver.
    """

    intact: Body
    X: np.ndarray
    x_intact: np.ndarray
    gravity: np.ndarray
    tissue: Tissue
    scar: Tissue
    cavity: np.ndarray
    contraction: float
    automaton: Automaton
    sites: SiteMap
    deposition: Deposition
    days_per_cycle: float
    days_per_step: float
    equilibrium: Equilibrium
    closes: ClassVar[str] = "the automaton step that filled the last site"

    def start(self) -> TissueState:
        """The fresh wound: the cavity is open, the body has found its new shape.

        Raises
        ------
        ConvergenceError
            If no equilibrium is found.
        """
        fresh = self._equilibrated(self.unhealed(self.x_intact), self.x_intact)
        return replace(fresh, W_ref=self.edge_energy(fresh))

    def unhealed(self, x: np.ndarray) -> TissueState:
        """The open cavity in a given shape x (n_nodes, 3) [mm]."""
        healing = self.automaton.initial_state()
        space = self.intact.frame.space
        natural = np.broadcast_to(np.eye(3), (space.n_elements, space.table.weight.size, 3, 3))
        return TissueState(0, healing, self.filled(healing), natural, x, 0)

    def step(self, state: TissueState) -> TissueState:
        """One cycle: the cells heal under the present energy, then the body finds its shape with what they filled.

        Raises
        ------
        ConvergenceError
            If no equilibrium is found.
        """
        cue = Cue(self.energy_at_sites(state).reshape(self.automaton.lattice.shape), state.W_ref or 1.0)
        healing, closure_days = self._heal(state, cue)
        filled = self.filled(healing)
        natural = self.deposition.natural(state.natural, state.filled, filled, self.felt_deformation(state.x))
        new = TissueState(state.cycle + 1, healing, filled, natural, state.x, 0, state.W_ref, closure_days)
        return self._equilibrated(new, state.x)

    def is_over(self, state: TissueState) -> bool:
        """Whether nothing happens any more."""
        return state.is_closed

    def measured(self, state: TissueState) -> dict[str, float]:
        """Numbers that only this kind of healing has, by name."""
        return {}

    def shown(self, state: TissueState) -> dict[str, np.ndarray]:
        """What elements hold (n_elements,), by name."""
        return {"filled_fraction": state.filled}

    def felt_deformation(self, x: np.ndarray) -> np.ndarray:
        """F that tissue feels, its volume ratio linear in each element: x (n_nodes, 3) [mm] -> (n_elements, n_qp, 3, 3)."""
        F = deformation_gradients(self.intact.frame.space, self.X, x)
        return np.cbrt(self.intact.dilation(self.X, x) / np.linalg.det(F))[..., None, None] * F

    def _heal(self, state: TissueState, cue: Cue) -> tuple[AutomatonState, float]:
        healing, closure_days = state.healing, state.closure_days
        last = int(np.floor(self.days(state.cycle + 1) / self.days_per_step + 1e-9))
        while healing.step < last:
            healing = self.automaton.advance(healing, cue)
            if closure_days < 0.0 and not self.open_sites(healing).any():
                closure_days = healing.step * self.days_per_step
        return healing, closure_days

    def _equilibrated(self, state: TissueState, start: np.ndarray) -> TissueState:
        body = self.body(state)
        x, report = self.equilibrium.loaded(body, self.X, self.gravity, start)
        return replace(state, x=self.extension.fill(x, body.fraction), newton_iterations=report.iterations)

    @cached_property
    def extension(self) -> Extension:
        """Continuation of displacements into the open cavity."""
        return Extension(self.intact.frame, self.X)

    def days(self, cycle: int) -> float:
        """Time after so many cycles [days]."""
        return cycle * self.days_per_cycle

    def body(self, state: TissueState) -> Body:
        """The body as it is: elements with hardly any tissue are out, the others count by the share that is filled.

        An element that hangs on the rest by a corner only would swing freely, so it waits until a side is held.
        """
        fraction = np.where(self._held(state.filled >= LEAST_FILLED), state.filled, 0.0)
        is_new = self.cavity[:, None]
        elastic = NeoHookean(
            np.where(is_new, self.scar.mu, self.tissue.mu), np.where(is_new, self.scar.kappa, self.tissue.kappa)
        )
        law = tissue_law(elastic, np.where(is_new, self.contraction, 0.0) * np.ones_like(self.tissue.mu), state.natural)
        return self.intact.with_tissue(law, np.where(is_new, self.scar.density, self.tissue.density), fraction)

    def _held(self, chosen: np.ndarray) -> np.ndarray:
        """Chosen elements that are joined side by side to tissue that was there before (n_elements,) bool."""
        inner, outer = self.intact.frame.space.neighbours
        sides = chosen[inner] & chosen[outer]
        n = chosen.size
        graph = sp.coo_array((np.ones(np.count_nonzero(sides)), (inner[sides], outer[sides])), shape=(n, n))
        _, part = connected_components(graph, directed=False)
        return chosen & np.isin(part, part[~self.cavity & chosen])

    def open_sites(self, healing: AutomatonState) -> np.ndarray:
        """Sites that wait for a cell: bool array of the lattice's shape."""
        return self.automaton.fillable & ~healing.occupancy

    def filled(self, healing: AutomatonState) -> np.ndarray:
        """Share of each element that cells fill (n_elements,) [1]: every site counts in exactly one element."""
        total = self.sites.count(self.automaton.fillable.ravel())
        return 1.0 - self.sites.count(self.open_sites(healing).ravel()) / np.maximum(total, 1)

    def energy_at_sites(self, state: TissueState) -> np.ndarray:
        """Strain energy density of the tissue at every lattice site (n_sites,) [kPa], mapped back onto the reference.

        Cells at the front feel the tissue they sit on: where an element is not well filled, the nearest that is counts.
        The tissue of a thinly filled element lies along its wall, but as a mixture it is strained like a void.
        """
        body, space = self.body(state), self.intact.frame.space
        coefficients = linear_fit(body.energy_density(self.X, state.x), body.volumes(self.X), space.table.points)
        held = (body.fraction >= WELL_FILLED) & (state.filled >= WELL_FILLED)
        centres = self.X[space.element_nodes[:, : space.n_axes + 1], : space.n_axes].mean(axis=1)
        nearest = np.flatnonzero(held)[cKDTree(centres[held]).query(centres[~held])[1]]
        coefficients[~held] = coefficients[nearest] * np.eye(1, space.n_axes + 1)
        return np.maximum(self.sites.evaluate(coefficients), 0.0)

    def edge_energy(self, state: TissueState) -> float:
        """Mean energy density over the sites that border the open wound [kPa]; 0 when it is closed."""
        edge = self.edge_sites(state.healing).ravel()
        return float(self.energy_at_sites(state)[edge].mean()) if edge.any() else 0.0

    def edge_sites(self, healing: AutomatonState) -> np.ndarray:
        """Cells with an open neighbour: bool array of the lattice's shape."""
        return self.automaton.lattice.beside(self.open_sites(healing)) & healing.occupancy


def tissue_law(elastic: NeoHookean, contraction: np.ndarray, natural: np.ndarray) -> NaturalConfiguration:
    """The law of all tissue in a lumpectomy, old and new; one form, so that nothing recompiles as tissue grows."""
    return NaturalConfiguration(Sum((elastic, Contraction(contraction))), natural)


def run(cycle: HealingCycle, state: TissueState, last_cycle: int) -> Iterator[TissueState]:
    """The one time loop: yield the state after each cycle until healing is over or the last cycle is done."""
    while state.cycle < last_cycle and not cycle.is_over(state):
        state = cycle.step(state)
        yield state
