"""A lumpectomy, from its image to the healed shape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...core.errors import ConvergenceError
from ...core.named import part, prefixed
from ...coupling.cycle import HealingCycle
from ...coupling.healing import TissueState
from ...files.pictures import picture
from ...geometry.volume import Volume
from ...mechanics.body import Body, mean_energy
from ...mechanics.failure import NoEquilibriumError
from ...mechanics.self_contact import SkinContact, is_available, sites
from ...numerics.newton import NewtonReport
from ...outcome.closure import middle_layer, wound_centre
from ...runs.kind import Context, Drawing, End, Fields, Packed, Row, Simulation, SurfaceData
from ...runs.quantity import Quantity
from .anatomy import anatomy_of
from .body import MIN_SKIN_FLAP_MM, Anatomy, BreastModel
from .build import CLOT_KPA, breast_model, breast_model_from_arrays, equilibrium_of, healing_cycle, imaged_in
from .case import LumpectomyCase
from .conditioning import Conditioned, condition, scaled
from .figures import BEFORE, FRESH, HEALED, first_figure, last_figures
from .solid import SolidModel
from .summary import (
    closing_sentence,
    closure_numbers,
    fitted_numbers,
    history_row,
    nipple_motion,
    outcome_numbers,
    visit_name,
)
from .visits import last_cycle, visit_cycles

Which = tuple[str, str]  # position of the patient and moment, such as ("upright", "week 2")
Shapes = Mapping[Which, np.ndarray]  # loaded positions (n_nodes, 3) [mm]


class BreastState(NamedTuple):
    """State of the breast before surgery, or after a cycle of healing."""

    tissue: TissueState | None
    """State of the healing cycle; None before surgery."""
    shapes: Shapes
    """All loaded shapes computed so far, by position of the patient and moment."""
    new: tuple[Which, ...]
    """Keys of the shapes that were computed for this state."""
    factor: Mapping[str, np.ndarray]
    """Matrix factor with which the solver starts the next equilibrium solve."""
    fronts: tuple[np.ndarray, ...] = ()
    """Open sites after each cycle; for a solid, only in one layer of the lattice."""
    rows: tuple[dict, ...] = ()
    """Rows of the history."""
    has_clot: bool = False
    """Whether the empty part of the cavity is filled with clot."""


REMEDY = "Give stiffer tissue ([tissue]), a smaller resection or another position, or a finer mesh ([mesh])."
CLIPPED_SHARE = (
    0.01  # share of the resection that must be left in place to be mentioned; meshing changes its size by 0.3 %
)


@contextmanager
def _named(what: str) -> Iterator[None]:
    """Name the stage, the position and what to change in the sentence of a solve that fails."""
    try:
        yield
    except ConvergenceError as error:
        why = f"{error.cause} {REMEDY}" if isinstance(error, NoEquilibriumError) else str(error)
        raise ConvergenceError(f"{what[0].upper()}{what[1:]}: {why}", error.history) from error


def _conditioned(stored: Any) -> Conditioned | None:
    """Return what a checkpoint holds of the fit of stiffness; None if nothing was fitted."""
    if stored is None:
        return None
    logs, covariance, misfit_mm, n_solves = stored
    return Conditioned(np.array(logs), np.array(covariance), misfit_mm, n_solves)


class LumpectomyRun(Simulation[BreastState]):
    """Computes the unloaded breast, removes the cavity, simulates healing, and solves for the loaded shapes at visits."""

    building, marching = "", "heal"

    def __init__(self, case: LumpectomyCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        self.anatomy: Anatomy | None = None
        self.equilibrium = equilibrium_of(case, lambda words: self.context.progress.update(None, words))
        self.home = case.coupling.healing_position
        self.positions = list(dict.fromkeys([self.home, *case.outcome.positions]))
        checkpoint, self.fitted = self.context.checkpoint, case
        if checkpoint is None:
            self.model, self.conditioned = self._build_model(), None
        else:
            self.conditioned = _conditioned(checkpoint.scalars.get("conditioned"))
            if self.conditioned is not None:
                self.fitted = scaled(case, self.conditioned.factors())
            self.model = breast_model_from_arrays(self.fitted, part("model", checkpoint.arrays))

    def _build_model(self) -> BreastModel:
        self.anatomy, notes = anatomy_of(self.case, self.context.progress)
        with self.context.progress.stage("mesh"):
            model = breast_model(self.case, self.anatomy)
        self.notes += [*notes, *model.notes]
        if not is_available():
            self.notes.append(
                "Contact of skin with skin is left out, and whether skin crosses skin is not known: IPC Toolkit (ipctk) is "
                "not installed, or has no wheel for this platform."
            )
        if (clipped := model.clipped_share) > CLIPPED_SHARE:
            self.notes.append(
                f"{100 * clipped:.0f} % of the resection is not removed: it lies outside the breast, or within "
                f"{MIN_SKIN_FLAP_MM:g} mm of the skin or the chest wall"
            )
        margin, wanted = model.margin_mm(self.anatomy), self.case.resection.margin_mm
        if margin < wanted:
            self.notes.append(
                f"the resection leaves {margin:.1f} mm around the tumour; resection.margin_mm is {wanted:g}"
            )
        return model

    def volumes(self) -> dict[str, Volume]:
        """Return the label map from which the mesh is made, and the image reduced for display in a report."""
        assert self.anatomy is not None
        volumes = {"labels": self.anatomy.labels}
        if self.anatomy.image is not None:
            volumes["picture"], note = picture(self.anatomy.image)
            self.notes += [note] if note else []
        return volumes

    def found(self) -> dict[str, Any]:
        """Return the centre and radius of the resection, and the position of a section along its normal."""
        centre, radius = self.model.centre_mm, self.model.radius_mm
        return {"resection_centre_mm": centre, "radius_in_body_mm": radius, "slice_mm": self.model.slice_mm}

    def first_figures(self) -> dict[str, Drawing]:
        """Return the function that draws image, tissue and mesh."""
        return {"section": lambda: first_figure(self.model, self.anatomy)}

    def start(self) -> BreastState:
        """Compute the unloaded shape; return the state before surgery, with the shape under gravity in every patient position."""
        case, shapes = self.case, {}
        with self.context.progress.stage("unload"), _named("the unloaded shape"):
            if case.outcome.supine_nipple_mm is not None:
                self._condition(np.asarray(case.outcome.supine_nipple_mm, float))
            model = self.model
            X, report = self.equilibrium.unloaded(model.intact, model.x_imaged, model.gravity(case.image.position))
            self._note_solve("unloaded shape", report)
            self._note_crossings("unloaded shape", X)
        with self.context.progress.stage("before surgery"):
            for position in self.positions:
                self.context.progress.update(0.0, position)
                start = imaged_in(case, model, position)
                x = self._reported(BEFORE, position, model.intact, X, start)
                if x is not None:
                    shapes[position, BEFORE] = x
        self.cycle = self._cycle(X, shapes[self.home, BEFORE])
        self.notes += self.cycle.healing.notes
        return BreastState(None, shapes, tuple(shapes), self.equilibrium.state_arrays())

    def _condition(self, supine_mm: np.ndarray) -> None:
        """Fit the stiffness of tissue and fascia to the place of the nipple lying supine (3,) LPS [mm]."""
        arrays, image = self.model.arrays(), self.case.image
        starts: list[np.ndarray | None] = [None, None]

        def supine(factors: np.ndarray) -> np.ndarray:
            model = breast_model_from_arrays(scaled(self.case, factors), arrays)
            known, gravity = model.x_imaged, model.gravity(image.position)
            X, _ = self.equilibrium.unloaded(model.intact, known, gravity, starts[0])
            x, _ = self.equilibrium.loaded(model.intact, X, model.gravity("supine"), starts[1])
            starts[:] = X, x
            return model.nipple_position(x)

        seen = self.model.from_patient(supine_mm)[: len(self.model.nipple_position(self.model.x_imaged))]
        self.conditioned = condition(supine, seen, self.equilibrium.tell)
        self.fitted = scaled(self.case, self.conditioned.factors())
        self.model = breast_model_from_arrays(self.fitted, arrays)
        self.notes.append(
            f"stiffness fitted to the nipple lying supine, which is met to {self.conditioned.misfit_mm:.1f} mm after "
            f"{self.conditioned.n_solves} bodies; skin as the case gives it"
        )

    def _cycle(self, X: np.ndarray, x_intact: np.ndarray, has_clot: bool = False) -> HealingCycle:
        return healing_cycle(self.fitted, self.model, X, x_intact, self.equilibrium, has_clot)

    def _reported(
        self, moment: str, position: str, body: Body, X: np.ndarray, start: np.ndarray | None
    ) -> np.ndarray | None:
        """Solve for the loaded shape of a body in one position (n_nodes, 3) [mm].

        None if there is no equilibrium, which is noted, in a position that is only reported: healing takes place in another one.
        """
        when = "before surgery" if moment == BEFORE else moment
        try:
            with _named(f"{when}, {position}"):
                x, report = self.equilibrium.loaded(body, X, self.model.gravity(position), start)
        except ConvergenceError as error:
            if position == self.home:
                raise
            self.notes.append(f"Left out: {error}")
            return None
        self._note_solve(f"{when}, {position}", report)
        self._note_crossings(f"{when}, {position}", x)
        return x

    def _note_crossings(self, what: str, x: np.ndarray) -> None:
        """Add a note if skin crosses skin in a shape (n_nodes, 3) [mm]."""
        if is_available() and len(found := self._skin.crossings(x)):
            self.notes.append(f"{what}: skin crosses skin {sites(found)} in the axes of the mesh")

    @cached_property
    def _skin(self) -> SkinContact:
        """The body's contact; one for the search of crossings alone where the case switches contact off."""
        body = self.model.intact
        return body.contact or SkinContact(body.discretization.space, body.discretization.skin_facets)

    def _note_solve(self, what: str, report: NewtonReport) -> None:
        """Add a note if an equilibrium solve, described by ``what``, did not converge in its first Newton run."""
        if len(report.history) > 1:
            self.notes.append(f"{what}: {report.iterations} iterations; " + "; ".join(report.history))

    def march(self, state: BreastState) -> Iterator[BreastState]:
        """Yield the state after surgery and after every cycle of healing, with the loaded shapes if a visit is due."""
        self.equilibrium.restore(self.model.intact.discretization, state.factor)
        self._fill_cavity(state.has_clot)
        if state.tissue is None:
            with self.context.progress.stage("surgery"):
                state = self._after(state, self._solved(state, f"{FRESH} cavity, {self.home}"), [FRESH])
            yield state
        while state.tissue.cycle < last_cycle(self.case) and not self.cycle.is_over(state.tissue):
            when = f"day {self.cycle.days(state.tissue.cycle + 1):g} of healing, {self.home}"
            state = self._after(state, self._solved(state, when), [])
            yield state

    def _solved(self, before: BreastState, when: str) -> TissueState:
        """Return the state after surgery or after the next cycle; the cavity is filled with clot if the empty one collapses."""
        try:
            with _named(when):
                return self._next(before)
        except ConvergenceError as error:
            if self.cycle.cavity.contents:
                raise
            self.notes.append(
                f"{error} The empty cavity may collapse there, as contact of its walls is not modelled: from now on it is filled "
                f"with clot and wound fluid of shear modulus {CLOT_KPA:g} kPa."
            )
        self.equilibrium.restore(self.model.intact.discretization, before.factor)
        self._fill_cavity(True)
        with _named(when):
            return self._next(before)

    def _next(self, before: BreastState) -> TissueState:
        return self.cycle.start() if before.tissue is None else self.cycle.step(before.tissue)

    def _fill_cavity(self, has_clot: bool) -> None:
        """Fill the empty part of the cavity with clot, or empty it."""
        if has_clot != bool(self.cycle.cavity.contents):
            self.cycle = self._cycle(self.cycle.X, self.cycle.x_intact, has_clot)

    def _after(self, before: BreastState, tissue: TissueState, moments: list[str]) -> BreastState:
        """Return the state after a cycle, with the loaded shapes of the given moments and of visits in this cycle."""
        shapes = dict(before.shapes)
        visits = [visit_name(weeks) for weeks, at in visit_cycles(self.case).items() if at == tissue.cycle]
        for moment in [*moments, *visits]:
            shapes |= self._visit(shapes, tissue, moment)
        new = tuple(which for which in shapes if which not in before.shapes)
        front = middle_layer(self.cycle.open_sites(tissue), wound_centre(self.cycle.ruler.open0))
        rows = (*before.rows, history_row(self.cycle, tissue))
        clot = bool(self.cycle.cavity.contents)
        return BreastState(tissue, shapes, new, self.equilibrium.state_arrays(), (*before.fronts, front), rows, clot)

    def _visit(self, shapes: Shapes, tissue: TissueState, moment: str) -> dict[Which, np.ndarray]:
        """Solve for the loaded shape in every patient position that had one before surgery."""
        asked = (position for position in self.positions if (position, BEFORE) in shapes)
        found = {(position, moment): self._shape(shapes, tissue, moment, position) for position in asked}
        return {which: x for which, x in found.items() if x is not None}

    def _shape(self, shapes: Shapes, tissue: TissueState, moment: str, position: str) -> np.ndarray | None:
        if position == self.home:
            self._note_crossings(f"{moment}, {position}", tissue.x)
            return tissue.x
        body = self.cycle.body(tissue)
        start = self.cycle.extension.fill(shapes[position, BEFORE], body.fraction)
        x = self._reported(moment, position, body, self.cycle.X, start)
        return None if x is None else self.cycle.extension.fill(x, body.fraction)

    def rows(self, state: BreastState) -> tuple[Row, ...]:
        """Return the history row of the latest cycle; none before surgery."""
        return state.rows[-1:]

    def is_mark(self, state: BreastState) -> bool:
        """Return whether the state is after surgery."""
        return state.tissue is not None

    def fields(self, state: BreastState) -> Iterator[Fields]:
        """Yield the loaded shapes computed for this state and, after surgery, the body in its unloaded shape."""
        yield from self._shapes(state.tissue, state.shapes, state.new)
        if state.tissue is None:
            return
        tissue, cycle, space = state.tissue, self.cycle, self.model.intact.discretization.space
        cells = {
            "strain_energy_density_kPa": mean_energy(cycle.body(tissue), cycle.X, tissue.x),
            "cavity": self.model.cavity.astype(np.int32),
            **cycle.shown(tissue),
        }
        points, displacement = (values[: space.n_geometric_nodes] for values in (cycle.X, tissue.x - cycle.X))
        days = cycle.days(tissue.cycle)
        yield Fields("body", tissue.cycle, days, points, space.geometric_nodes, {"displacement": displacement}, cells)

    def _shapes(self, tissue: TissueState | None, shapes: Shapes, which: tuple[Which, ...]) -> Iterator[Fields]:
        """Return loaded shapes with displacement since before surgery, strain energy density, and fields of the healing model."""
        if not which:
            return
        body = self.model.intact if tissue is None else self.cycle.body(tissue)
        shown = {} if tissue is None else self.cycle.shown(tissue)
        for position, moment in which:
            name = f"before-{position}" if moment == BEFORE else position
            x, before = shapes[position, moment], shapes[position, BEFORE]
            number = 0 if tissue is None else tissue.cycle
            yield self._loaded(name, number, body, x, x - before, shown)

    def _loaded(
        self, name: str, number: int, body: Body, x: np.ndarray, moved: np.ndarray, shown: Mapping[str, np.ndarray]
    ) -> Fields:
        space = self.model.intact.discretization.space
        cells = {
            "filled_fraction": np.ones(space.n_elements),
            "strain_energy_density_kPa": mean_energy(body, self.cycle.X, x),
            "cavity": self.model.cavity.astype(np.int32),
            **shown,
        }
        n, days = space.n_geometric_nodes, self.cycle.days(number)
        return Fields(name, number, days, x[:n], space.geometric_nodes, {"displacement": moved[:n]}, cells, "shapes")

    def pack(self, state: BreastState) -> Packed:
        """Return model, shapes, fronts, rows, tissue, and the factor that the next solve starts from."""
        assert state.tissue is not None
        arrays, scalars = self.cycle.pack(state.tissue)
        shapes = {f"{position}.{moment}": x for (position, moment), x in state.shapes.items()}
        packed = prefixed("model", self.model.arrays()) | prefixed("shape", shapes) | prefixed("factor", state.factor)
        packed |= prefixed("state", arrays)
        rows = [{k: None if v != v else v for k, v in row.items()} for row in state.rows]
        packed |= {"X": self.cycle.X, "fronts": np.packbits(np.array(state.fronts), axis=-1)}
        shown = [list(which) for which in state.shapes]
        kept = {"rows": rows, "shapes": shown, "state": scalars, "has_clot": state.has_clot}
        if self.conditioned is not None:
            fit = self.conditioned
            kept["conditioned"] = [fit.logs.tolist(), fit.covariance.tolist(), fit.misfit_mm, fit.n_solves]
        return packed, kept

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> BreastState:
        """Return the state in a checkpoint."""
        stored = part("shape", arrays)
        shapes = {(position, moment): stored[f"{position}.{moment}"] for position, moment in scalars["shapes"]}
        self.cycle = self._cycle(arrays["X"], shapes[self.home, BEFORE], scalars["has_clot"])
        width = self.cycle.ruler.lattice.shape[-1]
        fronts = tuple(np.unpackbits(arrays["fronts"], axis=-1, count=width).astype(bool))
        rows = tuple({k: np.nan if v is None else v for k, v in row.items()} for row in scalars["rows"])
        tissue = self.cycle.unpack(part("state", arrays), scalars["state"])
        return BreastState(tissue, shapes, (), part("factor", arrays), fronts, rows, scalars["has_clot"])

    def done(self, state: BreastState) -> tuple[float, str]:
        """Return the fraction of the wound that is closed, and the day."""
        return state.rows[-1]["closed_fraction"], f"day {state.rows[-1]['time_days']:.0f}"

    def analyse(self, state: BreastState) -> Shapes:
        """Return all loaded shapes; visits after closure have the healed shape, which no longer changes."""
        assert state.tissue is not None
        tissue = state.tissue
        with self.context.progress.stage("healed shape"):
            shapes = {**state.shapes, **self._visit(state.shapes, tissue, HEALED)}
        for weeks, at in visit_cycles(self.case).items():
            if tissue.is_closed and at > tissue.cycle:
                healed = {p: x for (p, moment), x in shapes.items() if moment == HEALED}
                shapes |= {(position, visit_name(weeks)): x for position, x in healed.items()}
        return shapes

    def last_fields(self, end: End[BreastState]) -> Iterator[Fields]:
        """Return the healed shapes."""
        healed = tuple(which for which in end.analysis if which[1] == HEALED)
        yield from self._shapes(end.state.tissue, end.analysis, healed)

    def outcome(self, end: End[BreastState]) -> dict[str, Quantity]:
        """Return closure, and how the shape changed in every position at every visit.

        The position in which it heals is among them if no shape was found in those asked for.
        """
        asked = list(self.case.outcome.positions)
        if not any((position, HEALED) in end.analysis for position in asked):
            asked.append(self.home)
        changes = {
            (position, moment): self.model.change(end.analysis[position, BEFORE], x)
            for (position, moment), x in end.analysis.items()
            if moment != BEFORE and position in asked
        }
        healed = [position for position, moment in changes if moment == HEALED]
        main = self.home if self.home in asked else healed[0]
        closure = closure_numbers(self.cycle, end.state.tissue, list(end.state.rows))
        return closure | self._body_numbers(end.analysis) | outcome_numbers(changes, (main, HEALED))

    def _body_numbers(self, shapes: Shapes) -> dict[str, Quantity]:
        """Return how far the nipple moves from prone to supine before surgery, and the stiffness that was fitted."""
        found = {} if self.conditioned is None else fitted_numbers(self.conditioned)
        supine = shapes.get(("supine", BEFORE))
        if supine is not None and self.case.image.position == "prone":
            found |= nipple_motion(self.model, supine)
        return found

    def surfaces(self, end: End[BreastState]) -> dict[str, SurfaceData]:
        """Return the outer surface of a solid before surgery and healed, in each position."""
        if not isinstance(self.model, SolidModel):
            return {}
        surfaces = {}
        for position in (p for p, moment in end.analysis if moment == HEALED and p in self.case.outcome.positions):
            before = end.analysis[position, BEFORE]
            for moment in (BEFORE, HEALED):
                x = end.analysis[position, moment]
                data = {"displacement": x - before, "retraction_mm": self.model.retraction(before, x)}
                surfaces[f"{position}-{moment}"] = SurfaceData(x, self.model.space.boundary, data)
        return surfaces

    def figures(self, end: End[BreastState]) -> dict[str, Drawing]:
        """Return the functions that draw closure, outlines or surfaces, and strain energy."""
        state = end.state
        fronts, rows = list(state.fronts), list(state.rows)
        return last_figures(self.case, self.model, self.cycle, state.tissue, end.analysis, fronts, rows)

    def sentence(self, end: End[BreastState]) -> str:
        """Return a sentence on when the wound closed."""
        return closing_sentence(self.cycle, end.state.tissue)
