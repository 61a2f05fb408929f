"""A lumpectomy, from its image to the healed shape: the stages of a run and what each writes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...cases.continuum_laws import network_of
from ...coupling.cycle import HealingCycle, TissueState, run
from ...healing.automaton import AutomatonState
from ...healing.continuum import course_arrays, course_from, course_scalars
from ...mechanics.body import Body, mean_energy
from ...mechanics.equilibrium import Equilibrium
from ...numerics.newton import NewtonReport
from ...outcome.closure import middle_layer, wound_centre
from ...runs.checkpoints import Checkpoint
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .anatomy import anatomy_of
from .body import Plan
from .build import equilibrium_of, healing_cycle, imaged_in, last_cycle, plan, plan_from_arrays, visit_cycles
from .case import LumpectomyCase
from .continuum import thin_fronts_of
from .figures import BEFORE, FRESH, HEALED, first_figure, last_figures
from .solid import SolidPlan
from .summary import closing_sentence, closure_numbers, history_row, outcome_numbers, visit_name


@dataclass
class LumpectomyRun:
    """The stages of one run, in order; everything a checkpoint must hold is in ``shapes``, ``fronts``, ``rows``, the state."""

    case: LumpectomyCase
    folder: RunFolder
    progress: Progress
    shapes: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)  # (position, moment) -> x (n_nodes, 3)
    fronts: list[np.ndarray] = field(default_factory=list)  # open sites after each cycle; of a solid, one layer of them
    rows: list[dict] = field(default_factory=list)

    def go(self) -> str:
        """Run all stages; returns the sentence that ends the run."""
        if self.folder.checkpoint is None:
            planned, cycle, start = self._begin()
        else:
            planned, cycle, start = self._resume(self.folder.checkpoint)
        state = start
        with self.progress.stage("heal"):
            for state in run(cycle, start, last_cycle(self.case)):
                self._record(planned, cycle, state)
                self.progress.update(self.rows[-1]["closed_fraction"], f"day {self.rows[-1]['time_days']:.0f}")
        with self.progress.stage("outcome"):
            self._finish(planned, cycle, state)
        return closing_sentence(cycle, state)

    def _begin(self) -> tuple[Plan, HealingCycle, TissueState]:
        anatomy, notes = anatomy_of(self.case, self.progress)
        self.folder.save_labels(anatomy.labels)
        if anatomy.image is not None:
            self.folder.save_picture(anatomy.image)
        for note in notes:
            self.folder.note(note)
        with self.progress.stage("mesh"):
            planned = plan(self.case, anatomy)
            for note in planned.notes:
                self.folder.note(note)
            self.folder.found(
                resection_centre_mm=planned.centre_mm, radius_in_body_mm=planned.radius_mm, slice_mm=planned.slice_mm
            )
            margin, wanted = planned.margin_mm(anatomy), self.case.resection.margin_mm
            if margin < wanted:
                self.folder.note(
                    f"the resection leaves {margin:.1f} mm around the tumour; resection.margin_mm is {wanted:g}"
                )
            self.folder.save_figure("section", first_figure(planned, anatomy))
        equilibrium = self._equilibrium()
        with self.progress.stage("unload"):
            X, report = equilibrium.unloaded(
                planned.intact, planned.x_imaged, planned.gravity(self.case.image.position)
            )
            self._tell("unloaded shape", report)
        with self.progress.stage("before surgery"):
            for position in self._positions:
                self.progress.update(0.0, position)
                start = imaged_in(self.case, planned, position)
                x, report = equilibrium.loaded(planned.intact, X, planned.gravity(position), start)
                self.shapes[position, BEFORE] = x
                self._tell(f"before surgery, {position}", report)
                self._write_shape(planned, planned.intact, X, (position, BEFORE), (0, 0.0), {})
        cycle = self._cycle(planned, X, equilibrium)
        for note in thin_fronts_of(self.case, cycle):
            self.folder.note(note)
        with self.progress.stage("surgery"):
            state = cycle.start()
            self._visit(planned, cycle, state, FRESH)
            self._record(planned, cycle, state)
        return planned, cycle, state

    def _cycle(self, planned: Plan, X: np.ndarray, equilibrium: Equilibrium) -> HealingCycle:
        network = network_of(self.case.healing.mechanosensing)
        return healing_cycle(self.case, planned, X, self.shapes[self._home, BEFORE], equilibrium, network)

    def _equilibrium(self) -> Equilibrium:
        return equilibrium_of(self.case, lambda words: self.progress.update(None, words))

    @property
    def _home(self) -> str:
        return self.case.coupling.healing_position

    @property
    def _positions(self) -> list[str]:
        """Positions to solve for, the healing position first."""
        return list(dict.fromkeys([self._home, *self.case.outcome.positions]))

    def _tell(self, what: str, report: NewtonReport) -> None:
        """Note a solve that needed more than a plain Newton run."""
        if len(report.history) > 1:
            self.folder.note(f"{what}: {report.iterations} iterations; " + "; ".join(report.history))

    def _record(self, planned: Plan, cycle: HealingCycle, state: TissueState) -> None:
        """Write what a cycle gave: visits, row, fields, checkpoint, in this order."""
        for weeks, at in visit_cycles(self.case).items():
            if at == state.cycle:
                self._visit(planned, cycle, state, visit_name(weeks))
        centre = wound_centre(cycle.automaton.open0)
        self.fronts.append(middle_layer(cycle.open_sites(state.healing), centre))
        self.rows.append(history_row(cycle, state))
        self.folder.record(self.rows[-1])
        space = planned.intact.frame.space
        self.folder.write_fields(
            "body",
            state.cycle,
            cycle.days(state.cycle),
            cycle.X[: space.n_shape_nodes],
            space.shape_nodes,
            {"displacement": (state.x - cycle.X)[: space.n_shape_nodes]},
            {
                "strain_energy_density_kPa": mean_energy(cycle.body(state), cycle.X, state.x),
                "cavity": planned.cavity.astype(np.int32),
                **cycle.shown(state),
            },
        )
        self.folder.save_checkpoint(state.cycle, self._arrays(planned, cycle, state), self._scalars(state))

    def _visit(self, planned: Plan, cycle: HealingCycle, state: TissueState, moment: str) -> None:
        """Solve for the shape in every position."""
        body, when = cycle.body(state), (state.cycle, cycle.days(state.cycle))
        for position in self._positions:
            self.shapes[position, moment] = self._shape(planned, cycle, state, moment, position)
            self._write_shape(planned, body, cycle.X, (position, moment), when, cycle.shown(state))

    def _shape(self, planned: Plan, cycle: HealingCycle, state: TissueState, moment: str, position: str) -> np.ndarray:
        if position == self._home:
            return state.x
        body = cycle.body(state)
        start = cycle.extension.fill(self.shapes[position, BEFORE], body.fraction)
        x, report = cycle.equilibrium.loaded(body, cycle.X, planned.gravity(position), start)
        self._tell(f"{moment}, {position}", report)
        return cycle.extension.fill(x, body.fraction)

    def _write_shape(
        self,
        planned: Plan,
        body: Body,
        X: np.ndarray,
        which: tuple[str, str],
        when: tuple[int, float],
        shown: dict[str, np.ndarray],
    ) -> None:
        """Write a loaded shape; what it moved by since before surgery, per element what is ``shown`` and the energy."""
        position, moment = which
        x, before = self.shapes[which], self.shapes[position, BEFORE]
        space = planned.intact.frame.space
        self.folder.write_fields(
            f"before-{position}" if moment == BEFORE else position,
            *when,
            x[: space.n_shape_nodes],
            space.shape_nodes,
            {"displacement": (x - before)[: space.n_shape_nodes]},
            {
                "filled_fraction": np.ones(space.n_elements),
                "strain_energy_density_kPa": mean_energy(body, X, x),
                "cavity": planned.cavity.astype(np.int32),
                **shown,
            },
            folder="shapes",
        )

    def _arrays(self, planned: Plan, cycle: HealingCycle, state: TissueState) -> dict[str, np.ndarray]:
        arrays = {f"plan.{name}": array for name, array in planned.arrays().items()}
        arrays |= {f"shape.{position}.{moment}": x for (position, moment), x in self.shapes.items()}
        arrays |= {f"factor.{name}": array for name, array in cycle.equilibrium.kept().items()}
        arrays |= {"X": cycle.X, "x": state.x, "natural": state.natural, "filled": state.filled}
        if state.course is not None:
            arrays |= {f"course.{name}": array for name, array in course_arrays(state.course).items()}
        arrays |= {"occupancy": state.healing.occupancy, "fronts": np.packbits(np.array(self.fronts), axis=-1)}
        return arrays

    def _scalars(self, state: TissueState) -> dict:
        healing = state.healing
        return {
            "rows": [{k: None if v != v else v for k, v in row.items()} for row in self.rows],
            "W_ref": state.W_ref,
            "newton_iterations": state.newton_iterations,
            "closure_days": state.closure_days,
            "course": None if state.course is None else course_scalars(state.course),
            "healing": [
                healing.step,
                healing.n_edge_divisions,
                healing.n_layer_divisions,
                healing.n_dropped,
                healing.n_clamped,
            ],
        }

    def _resume(self, kept: Checkpoint) -> tuple[Plan, HealingCycle, TissueState]:
        arrays, scalars = kept.arrays, kept.scalars
        planned = plan_from_arrays(self.case, _part(arrays, "plan."))
        self.shapes = {tuple(name.split(".", 1)): x for name, x in _part(arrays, "shape.").items()}
        X = arrays["X"]
        equilibrium = self._equilibrium()
        equilibrium.restore(planned.intact.frame, _part(arrays, "factor."))
        cycle = self._cycle(planned, X, equilibrium)
        width = cycle.automaton.lattice.shape[-1]
        self.fronts = list(np.unpackbits(arrays["fronts"], axis=-1, count=width).astype(bool))
        self.rows = [{k: np.nan if v is None else v for k, v in row.items()} for row in scalars["rows"]]
        healing = AutomatonState(arrays["occupancy"].astype(bool), *scalars["healing"])
        state = TissueState(
            kept.cycle,
            healing,
            arrays["filled"],
            arrays["natural"],
            arrays["x"],
            scalars["newton_iterations"],
            scalars["W_ref"],
            scalars["closure_days"],
            scalars["course"] and course_from(_part(arrays, "course."), scalars["course"]),
        )
        return planned, cycle, state

    def _finish(self, planned: Plan, cycle: HealingCycle, state: TissueState) -> None:
        """Shapes at the end, visits that came after closure, numbers and pictures."""
        self._visit(planned, cycle, state, HEALED)
        for weeks, at in visit_cycles(self.case).items():
            if state.is_closed and at > state.cycle:
                for position in self._positions:
                    self.shapes[position, visit_name(weeks)] = self.shapes[position, HEALED]
        changes = {
            (position, moment): planned.change(self.shapes[position, BEFORE], x)
            for (position, moment), x in self.shapes.items()
            if moment != BEFORE and position in self.case.outcome.positions
        }
        main = self._home if self._home in self.case.outcome.positions else self.case.outcome.positions[0]
        numbers = closure_numbers(cycle, state, self.rows) | outcome_numbers(changes, (main, HEALED))
        self.folder.write_outcome({name: Quantity(n.value, n.unit, n.note) for name, n in numbers.items()})
        if isinstance(planned, SolidPlan):
            self._write_surfaces(planned)
        for name, figure in last_figures(self.case, planned, cycle, state, self.shapes, self.fronts, self.rows):
            self.folder.save_figure(name, figure)

    def _write_surfaces(self, planned: SolidPlan) -> None:
        """The outer surface before surgery and healed, in each position."""
        for position in self.case.outcome.positions:
            before = self.shapes[position, BEFORE]
            for moment in (BEFORE, HEALED):
                x = self.shapes[position, moment]
                data = {"displacement": x - before, "retraction_mm": planned.retraction(before, x)}
                self.folder.write_surface(f"{position}-{moment}", x, planned.space.boundary, data)


def _part(arrays: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
