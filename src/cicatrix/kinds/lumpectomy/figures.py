"""Which pictures a lumpectomy's run gets, of a section and of a solid."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from matplotlib.figure import Figure

from ...coupling.continuum import FieldsCycle
from ...coupling.cycle import HealingCycle, TissueState
from ...files.figures_continuum import View, fields_figure
from ...mechanics.body import Body
from . import figures_section as figures
from . import figures_solid
from .body import Anatomy, Plan
from .case import LumpectomyCase
from .section import SectionPlan
from .solid import SolidPlan
from .summary import edge_profile, visit_name

BEFORE, FRESH, HEALED = "before", "fresh", "healed"
Shapes = Mapping[tuple[str, str], np.ndarray]  # (position, moment) -> x (n_nodes, 3) [mm]


def first_figure(planned: Plan, anatomy: Anatomy) -> Figure:
    """What will be computed: image, tissue, mesh."""
    if isinstance(planned, SolidPlan):
        return figures_solid.anatomy_figure(planned, anatomy)
    assert isinstance(planned, SectionPlan)
    return figures.section_figure(planned, anatomy)


def last_figures(
    case: LumpectomyCase,
    planned: Plan,
    cycle: HealingCycle,
    state: TissueState,
    shapes: Shapes,
    fronts: list[np.ndarray],
    rows: list[dict],
) -> Iterator[tuple[str, Figure]]:
    """What came out: name and picture."""
    home = case.coupling.healing_position
    mode = f"{case.coupling.mode} coupling, healing {home}"
    before, x_fresh = shapes[home, BEFORE], shapes[home, FRESH]
    fresh = cycle.body(cycle.unhealed(x_fresh))
    panels = {
        "before surgery": figures.energy_panel(planned.intact, cycle.X, before),
        "fresh cavity": figures.energy_panel(fresh, cycle.X, x_fresh),
        closing_word(state): figures.energy_panel(cycle.body(state), cycle.X, state.x),
    }
    if isinstance(cycle, FieldsCycle):
        assert state.course is not None
        view = _view(planned, state.x)
        yield "fields", fields_figure(cycle.transport, state.course.now, state.x, cycle.days(state.cycle), view)
    if isinstance(planned, SolidPlan):
        positions = case.outcome.positions
        yield "closure", figures_solid.closure_figure(planned, cycle, fronts, rows, mode)
        pairs = {p: (shapes[p, BEFORE], shapes[p, HEALED]) for p in positions}
        yield "surface", figures_solid.surface_figure(planned, pairs, closing_word(state), case.image.side)
        yield "energy", figures_solid.energy_figure(planned, panels)
        return
    assert isinstance(planned, SectionPlan)
    yield "closure", figures.closure_figure(planned, cycle.automaton.lattice, fronts, rows, mode)
    yield "outline", _outlines(case, planned, shapes)
    yield "energy", figures.energy_figure(planned, panels)
    yield "edge-energy", _edges(planned, cycle, fresh, {home: (before, x_fresh)})


def _view(planned: Plan, x: np.ndarray) -> View:
    """The section, or of a solid the axial plane through its cavity."""
    if isinstance(planned, SectionPlan):
        return View(planned.section.axis_labels, is_downward=planned.section.plane == "axial")
    centre = x[np.unique(planned.intact.frame.space.corners[planned.cavity])].mean(axis=0)
    return View(("left [mm]", "posterior [mm]"), 2, float(centre[2]), is_downward=True)


def _outlines(case: LumpectomyCase, planned: SectionPlan, shapes: Shapes) -> Figure:
    moments = [BEFORE, FRESH, *(visit_name(w) for w in case.outcome.visits_weeks), HEALED]
    named = {p: [(m, shapes[p, m]) for m in moments if (p, m) in shapes] for p in case.outcome.positions}
    return figures.outline_figure(planned, named, {p: shapes[p, HEALED] for p in case.outcome.positions})


def _edges(
    planned: SectionPlan, cycle: HealingCycle, fresh: Body, pairs: Mapping[str, tuple[np.ndarray, np.ndarray]]
) -> Figure:
    def profiles(before: np.ndarray, after: np.ndarray):
        return edge_profile(planned, planned.intact, cycle.X, before), edge_profile(planned, fresh, cycle.X, after)

    return figures.edge_figure({position: profiles(*pair) for position, pair in pairs.items()})


def closing_word(state: TissueState) -> str:
    """What the last shape is called."""
    return HEALED if state.is_closed else "at the last week"
