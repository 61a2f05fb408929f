"""Integrate the deformation of a body of history-dependent tissue through a load history."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from ...core.errors import ConvergenceError
from ...core.named import part, prefixed
from ...core.units import acceleration_mm_s2, days_from_seconds, hours_from_seconds, ml_from_mm3
from ...mechanics.body_integration import BodyState, Load, initial_state, integrate
from ...mechanics.equilibrium import Equilibrium
from ...numerics.compiler import COMPILER
from ...numerics.newton import NewtonReport
from ...runs.kind import Context, Drawing, End, Fields, Packed, Row, Simulation
from ...runs.quantity import Quantity
from ...runs.trees import packed_tree, unpacked_tree
from .build import displaced_positions, given_and_body, load_steps, notes_of
from .case import EquilibriumCase
from .figures import history_figure, shape_figure

UNITS = {"max_displacement_mm": "mm", "strain_energy_uJ": "uJ", "dissipation_uJ": "uJ", "volume_ml": "ml"}


class HistoryState(NamedTuple):
    """State of a body at an instant of its load history."""

    number: int
    """Number of the instant; -1 before the first load."""
    body_state: BodyState
    solver: Mapping[str, np.ndarray]
    """Matrix factor with which the solver starts the next step."""
    factorizations: int


class HistoryRun(Simulation[HistoryState]):
    """Solves for the equilibrium of a viscous, growing or remodelling body at every instant of a load history."""

    building, marching = "mesh", "march"

    def __init__(self, case: EquilibriumCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        self.given, self.body = given_and_body(case, self.context.ranks)
        self.notes += notes_of(self.given)
        if self.notes:
            self.context.progress.update(1.0, " ".join(self.notes))
        self.X = self.body.discretization.space.positions
        on_message = partial(self.context.progress.update, None)
        self.solver = Equilibrium(case.solver.relative_tolerance, on_message)
        assert case.history is not None
        self.load_steps = load_steps(case.history)
        self._earlier = 0  # factorisations before the march began

    def start(self) -> HistoryState:
        """Return the body before its first load."""
        return HistoryState(-1, initial_state(self.body, self.X, float(self.load_steps[0, 0])), {}, 0)

    def march(self, state: HistoryState) -> Iterator[HistoryState]:
        """Solve for equilibrium at every later instant, and yield the state."""
        now, first = state.body_state, state.number + 1
        self.solver.restore(self.body.discretization, state.solver)
        self._earlier = state.factorizations - self.solver.factorizations
        try:
            for number, reached in enumerate(integrate(self.body, self.X, self._loads(first), now, self.solver), first):
                now = reached
                yield HistoryState(number, now, self.solver.state_arrays(), self._earlier + self.solver.factorizations)
        except ConvergenceError as error:
            raise ConvergenceError(
                f"After {hours_from_seconds(now.time):.6g} h the computation stopped: {error}", error.history
            ) from error

    def _loads(self, number: int) -> Iterator[Load]:
        gravity = acceleration_mm_s2(np.array(self.case.loads.gravity_m_s2))
        prescribed_positions = (
            displaced_positions(self.body, self.given.displacement) if self.given.displacement.any() else None
        )
        for time, share in self.load_steps[number:]:
            at = None if prescribed_positions is None else self.X + share * (prescribed_positions - self.X)
            yield Load(float(time), share * gravity, float(share), at)

    def _energy(self, now: BodyState) -> np.ndarray:
        """Return the strain energy density at quadrature points [kPa]."""
        return np.asarray(_energy(self.body.law, self.body.law_gradient(self.X, now.x), now.state))

    def _growth(self, now: BodyState, shape: tuple[int, ...]) -> np.ndarray:
        """Return the volume ratio of growth at quadrature points [1]."""
        return np.broadcast_to(np.linalg.det(np.asarray(self.body.law.growth_tensor(now.state))), shape)

    def _displacement(self, now: BodyState) -> np.ndarray:
        """Return the displacement of the given nodes (n, 3) [mm]."""
        return (now.x - self.X)[: len(self.given.points)]

    def rows(self, state: HistoryState) -> Iterator[Row]:
        """Return displacement, energies, volume and growth at an instant."""
        now = state.body_state
        if now.report is None:
            return
        W, volumes = self._energy(now), self.body.volumes(self.X)
        yield {
            "step": state.number,
            "time_h": hours_from_seconds(now.time),
            "share": float(self.load_steps[state.number, 1]),
            "max_displacement_mm": float(np.linalg.norm(self._displacement(now), axis=1).max()),
            "strain_energy_uJ": float(np.sum(W * volumes)),
            "dissipation_uJ": now.heat,
            "volume_ml": ml_from_mm3(float(np.sum(self.body.volume_ratio(self.X, now.x) * volumes))),
            "growth_mean": float(np.sum(self._growth(now, W.shape) * volumes) / volumes.sum()),
            "newton_iterations": now.report.iterations,
        }

    def fields(self, state: HistoryState) -> Iterator[Fields]:
        """Return displacement, strain energy density and growth on the given mesh."""
        now = state.body_state
        if now.report is None:
            return
        W = self._energy(now)
        cells = {"strain_energy_density_kPa": W.mean(axis=1), "growth": self._growth(now, W.shape).mean(axis=1)}
        days, points = days_from_seconds(now.time), {"displacement": self._displacement(now)}
        yield Fields("body", state.number, days, self.given.points, self.given.tetrahedra, points, cells)

    def pack(self, state: HistoryState) -> Packed:
        """Return positions, the law's history at every quadrature point, and the solver's stored factor."""
        now = state.body_state
        arrays = {"x": now.x, **packed_tree(now.state), **prefixed("solver", state.solver)}
        scalars = {"number": state.number, "time": now.time, "heat": now.heat, "factorizations": state.factorizations}
        return arrays, scalars

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> HistoryState:
        """Return the state in a checkpoint."""
        state = unpacked_tree(initial_state(self.body, self.X).state, arrays)
        now = BodyState(scalars["time"], arrays["x"], state, scalars["heat"], NewtonReport())
        return HistoryState(scalars["number"], now, part("solver", arrays), scalars["factorizations"])

    def done(self, state: HistoryState) -> tuple[float, str]:
        """Return the fraction of the instants that is computed, and the simulated time."""
        return (state.number + 1) / len(self.load_steps), f"{hours_from_seconds(state.body_state.time):.4g} h simulated"

    def outcome(self, end: End[HistoryState]) -> dict[str, Quantity]:
        """Return the last row, and the solver's effort."""
        history = end.history
        last = {name: Quantity(float(history[name][-1]), unit, "at the end") for name, unit in UNITS.items()}
        growth, n_dofs = float(history["growth_mean"][-1]), self.body.discretization.supports(False).n_unknowns
        return last | {
            "growth_mean": Quantity(growth, "1", "volume of grown tissue relative to the initial one"),
            "newton_iterations": Quantity(int(history["newton_iterations"].sum()), "1"),
            "factorizations": Quantity(end.state.factorizations, "1"),
            "n_dofs": Quantity(n_dofs, "1", "degrees of freedom that are free"),
        }

    def figures(self, end: End[HistoryState]) -> Mapping[str, Drawing]:
        """Return the functions that draw the shape at the end, and the history."""
        shape = partial(shape_figure, self.body.discretization.space, self.X, end.state.body_state.x, inverse=False)
        return {"shape": shape, "history": partial(history_figure, end.history)}

    def sentence(self, end: End[HistoryState]) -> str:
        """Return a sentence on how far the load history was integrated, and in how many steps."""
        n, hours = int(end.history["newton_iterations"].sum()), np.ptp(end.history["time_h"])
        return f"The body was simulated over {hours:.6g} h in {len(self.load_steps)} steps, {n} Newton iterations."


@partial(jax.jit, compiler_options=COMPILER)
def _energy(law, F, state):
    return law.energy(F, state)
