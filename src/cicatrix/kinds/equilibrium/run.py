"""Mechanics without healing: the loaded shape of a body, or its unloaded shape; on one process or on several MPI ranks.

Every rank has the whole mesh, and assembles a part of the elements.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...core.errors import ConvergenceError
from ...core.ranks import Ranks
from ...core.units import acceleration_mm_s2, ml_from_mm3
from ...files.mesh_doubts import UNIT_QUESTION, doubt_of_extent, doubts_of, extent_of
from ...mechanics.division import layout_of, shared
from ...mechanics.equilibrium import Equilibrium
from ...mechanics.failure import NoEquilibriumError, percent
from ...numerics.krylov import PetscEngine
from ...numerics.newton import NewtonReport
from ...runs.kind import Context, Drawing, End, Fields, Packed, Row, Simulation
from ...runs.quantity import Quantity
from .build import displaced_positions, given_and_body, notes_of, on_petsc
from .case import EquilibriumCase
from .figures import shape_figure
from .history import HistoryRun

REPORTED = ("iterations", "load_steps", "history", "norms", "is_stable")


class EquilibriumState(NamedTuple):
    """Shape of the body: the given one before the solve, the solution after it."""

    positions: np.ndarray
    """Nodes of the loaded shape, or of the unloaded one if the case is an inverse problem (n_nodes, 3) [mm]."""
    report: NewtonReport | None = None
    factorizations: int = 0
    share: float = 1.0
    """Share of the load under which the shape is in equilibrium [1]; below 1 if none was found under the whole load."""


class EquilibriumRun(Simulation[EquilibriumState]):
    """Solves for one shape of a body; cases with ``[history]`` are run by :class:`.history.HistoryRun`."""

    building, marching, on_ranks = "mesh", "solve", True

    def __init__(self, case: EquilibriumCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        self.given, self.body = given_and_body(case, self.context.ranks)
        self.notes += notes_of(self.given)
        if self.notes:
            self.context.progress.update(1.0, " ".join(self.notes))

    @classmethod
    def of(cls, case: EquilibriumCase) -> type[Simulation]:
        """Return the class for load histories if the case has ``[history]``, else this class."""
        return cls if case.history is None else HistoryRun

    def start(self) -> EquilibriumState:
        """Return the given shape."""
        return EquilibriumState(self.body.discretization.space.positions)

    def march(self, state: EquilibriumState) -> Iterator[EquilibriumState]:
        """Yield the state with the solution, unless the given state already has it."""
        if state.report is not None:
            return
        try:
            state = self._solved()
        except NoEquilibriumError as error:
            words = [str(error), *doubts_of(self.given)]
            if error.share > 0.0:  # recorded by the driver, although the integration ends here
                yield EquilibriumState(error.positions, NewtonReport(), 0, error.share)
                words.append(f"The last stable shape, under {percent(error.share)} of the {error.load}, is in fields.")
            raise ConvergenceError(" ".join(words), error.history) from error
        self.notes += [*_how(self.case, self.context.ranks), *state.report.history]
        yield state

    def is_mark(self, state: EquilibriumState) -> bool:
        """Return whether the state carries the whole load."""
        return state.share == 1.0

    def _solved(self) -> EquilibriumState:
        """Solve for equilibrium on all ranks together; every rank returns all node positions."""
        case, body, ranks = self.case, self.body, self.context.ranks

        def on_message(words: str) -> None:
            self.context.progress.update(None, words)
            if ranks.share(ranks.is_interrupted):
                raise KeyboardInterrupt

        prescribed_positions, on = (
            displaced_positions(body, self.given.displacement) if self.given.displacement.any() else None,
            None,
        )
        if on_petsc(case, ranks):
            body = shared(body, ranks)
            on = PetscEngine(layout_of(body.discretization), "gamg" if case.solver.linear == "gamg" else "mumps")
        solver = Equilibrium(case.solver.relative_tolerance, on_message, on)
        X, gravity = body.discretization.space.positions, acceleration_mm_s2(np.array(case.loads.gravity_m_s2))
        with ranks.abort_on_error():
            if case.solver.inverse:
                found, report = solver.unloaded(body, X, gravity)
            else:
                found, report = solver.loaded(body, X, gravity, prescribed_positions=prescribed_positions)
        return EquilibriumState(found, report, solver.factorizations)

    def rows(self, state: EquilibriumState) -> Iterator[Row]:
        """Return the residual of every Newton iteration, one row each."""
        for number, norm in enumerate(state.report.norms if state.report else (), 1):
            yield {"iteration": number, "residual_mN": norm}

    def _shapes(self, state: EquilibriumState) -> tuple[np.ndarray, np.ndarray]:
        """Return the unloaded and the loaded shape (n_nodes, 3) [mm]."""
        given = self.body.discretization.space.positions
        return (state.positions, given) if self.case.solver.inverse else (given, state.positions)

    def _displacement(self, state: EquilibriumState) -> np.ndarray:
        """Return the displacement of the given nodes (n, 3) [mm]."""
        return (state.positions - self.body.discretization.space.positions)[: len(self.given.points)]

    def fields(self, state: EquilibriumState) -> Iterator[Fields]:
        """Return displacement, strain energy density and volume ratio of the solution on the given mesh."""
        if state.report is None:
            return
        given, (X, x) = self.given, self._shapes(state)
        points = {"displacement": self._displacement(state), "fixed": given.is_fixed}
        cells = {
            "strain_energy_density_kPa": self.body.energy_density(X, x).mean(axis=1),
            "volume_ratio": self.body.volume_ratio(X, x).mean(axis=1),
            "youngs_modulus_kPa": given.E,
        }
        yield Fields("body", 0, 0.0, given.points, given.tetrahedra, points, cells)

    def pack(self, state: EquilibriumState) -> Packed:
        """Return the positions of the nodes as an array, for a checkpoint."""
        report = state.report or NewtonReport()
        reported = {name: getattr(report, name) for name in REPORTED}
        return {"positions": state.positions}, {"report": reported, "factorizations": state.factorizations}

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> EquilibriumState:
        """Return the state whose node positions are in a checkpoint."""
        return EquilibriumState(arrays["positions"], NewtonReport(**scalars["report"]), scalars["factorizations"])

    def done(self, state: EquilibriumState) -> tuple[float, str]:
        """Return the share of the load that is in equilibrium."""
        return state.share if state.report else 0.0, ""

    def outcome(self, end: End[EquilibriumState]) -> dict[str, Quantity]:
        """Return displacement, energy, volume and mass, and the solver's effort."""
        body, state, (X, x) = self.body, end.state, self._shapes(end.state)
        report = state.report or NewtonReport()
        volume = body.volumes(body.discretization.space.positions)
        return {
            "max_displacement_mm": Quantity(np.linalg.norm(self._displacement(state), axis=1).max(), "mm"),
            "strain_energy_uJ": Quantity(body.strain_energy(X, x), "uJ"),
            "newton_iterations": Quantity(report.iterations, "1"),
            "load_steps": Quantity(report.load_steps, "1"),
            "factorizations": Quantity(state.factorizations, "1"),
            "n_dofs": Quantity(body.discretization.supports(False).n_unknowns, "1", "degrees of freedom that are free"),
            "volume_ml": Quantity(ml_from_mm3(volume.sum()), "ml", "as given"),
            "mass_g": Quantity(1e3 * float(np.sum(body.density * body.volumes(X))), "g"),
            "largest_extent_mm": Quantity(
                extent_of(self.given.points), "mm", UNIT_QUESTION if doubt_of_extent(self.given.points) else ""
            ),
        }

    def figures(self, end: End[EquilibriumState]) -> Mapping[str, Drawing]:
        """Return the function that draws the two shapes."""
        space = self.body.discretization.space
        draw = partial(shape_figure, space, space.positions, end.state.positions, self.case.solver.inverse)
        return {"shape": draw}

    def sentence(self, end: End[EquilibriumState]) -> str:
        """Return a sentence on the solution, the number of iterations, and whether the given shape is stable."""
        report = end.state.report or NewtonReport()
        sought = "unloaded" if self.case.solver.inverse else "loaded"
        doubted = "" if report.is_stable else " The given shape is not a stable equilibrium of it."
        return f"The {sought} shape was found in {report.iterations} Newton iterations.{doubted}"


def _how(case: EquilibriumCase, ranks: Ranks) -> list[str]:
    if not on_petsc(case, ranks):
        return []
    method = "GAMG" if case.solver.linear == "gamg" else "MUMPS"
    return [f"PETSc's {method} solved the linear systems on {ranks.size} rank{'s' * (ranks.size > 1)}."]
