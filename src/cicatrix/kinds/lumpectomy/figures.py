"""Choice of the figures of a lumpectomy's run, for a section and for a whole breast."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...coupling.continuum_healing import ContinuumHealing
from ...coupling.cycle import HealingCycle
from ...coupling.healing import TissueState
from ...files.figures_continuum import View, fields_figure
from ...runs.kind import Drawing
from . import figures_section as figures
from . import figures_solid
from .body import Anatomy, BreastModel
from .case import LumpectomyCase
from .section import SectionModel
from .solid import SolidModel
from .summary import edge_profile, visit_name

BEFORE, FRESH, HEALED = "before", "fresh", "healed"
Shapes = Mapping[tuple[str, str], np.ndarray]  # (position of the patient, visit) -> node positions (n_nodes, 3) [mm]


def first_figure(model: BreastModel, anatomy: Anatomy) -> Figure:
    """Draw the model before it is run: image, tissue, mesh."""
    if isinstance(model, SolidModel):
        return figures_solid.anatomy_figure(model, anatomy)
    assert isinstance(model, SectionModel)
    return figures.section_figure(model, anatomy)


def last_figures(
    case: LumpectomyCase,
    model: BreastModel,
    cycle: HealingCycle,
    state: TissueState,
    shapes: Shapes,
    fronts: list[np.ndarray],
    rows: list[dict],
) -> dict[str, Drawing]:
    """Return the functions that draw the results, by name."""
    own = OWN_FIGURES.get(case.healing.model, _no_figures)(model, cycle, state)
    mode = f"{case.coupling.mode} coupling, healing {case.coupling.healing_position}"
    before, x_fresh = (shapes[case.coupling.healing_position, moment] for moment in (BEFORE, FRESH))

    def panels() -> dict[str, Any]:
        return {
            "before surgery": figures.energy_panel(model.intact, cycle.X, before),
            "fresh cavity": figures.energy_panel(cycle.opened, cycle.X, x_fresh),
            closing_word(state): figures.energy_panel(cycle.body(state), cycle.X, state.x),
        }

    if isinstance(model, SolidModel):
        pairs = {p: (shapes[p, BEFORE], shapes[p, HEALED]) for p in _solved(case, shapes)}
        return own | {
            "closure": lambda: figures_solid.closure_figure(model, cycle.ruler, fronts, rows, mode),
            "surface": lambda: figures_solid.surface_figure(model, pairs, closing_word(state), case.image.side),
            "energy": lambda: figures_solid.energy_figure(model, panels()),
        }
    assert isinstance(model, SectionModel)
    home = {case.coupling.healing_position: (before, x_fresh)}
    return own | {
        "closure": lambda: figures.closure_figure(model, cycle.ruler.lattice, fronts, rows, mode),
        "outline": lambda: _outlines(case, model, shapes),
        "energy": lambda: figures.energy_figure(model, panels()),
        "edge-energy": lambda: _edges(model, cycle, home),
    }


def _no_figures(model: BreastModel, cycle: HealingCycle, state: TissueState) -> dict[str, Drawing]:
    return {}


def _continuum_figures(model: BreastModel, cycle: HealingCycle, state: TissueState) -> dict[str, Drawing]:
    """Return maps of cells, cytokine, collagen and permanent stretch."""
    healing = cycle.healing
    assert isinstance(healing, ContinuumHealing)
    now, days = state.healing.integration.now, cycle.days(state.cycle)
    return {"fields": lambda: fields_figure(healing.transport, now, state.x, days, _view(model, state.x))}


# functions that make the figures of a single healing model, by the value of healing.model
OWN_FIGURES: dict[str, Callable[[BreastModel, HealingCycle, TissueState], dict[str, Drawing]]] = {
    "fields": _continuum_figures
}


def _view(model: BreastModel, x: np.ndarray) -> View:
    """Choose the plane of fields: the section, or the axial plane through the cavity of a solid."""
    if isinstance(model, SectionModel):
        return View(model.section.axis_labels, is_downward=model.section.plane == "axial")
    centre = x[np.unique(model.intact.discretization.space.corners[model.cavity])].mean(axis=0)
    return View(("left [mm]", "posterior [mm]"), 2, float(centre[2]), is_downward=True)


def _outlines(case: LumpectomyCase, model: SectionModel, shapes: Shapes) -> Figure:
    moments = [BEFORE, FRESH, *(visit_name(w) for w in case.outcome.visits_weeks), HEALED]
    solved = _solved(case, shapes)
    named = {p: [(m, shapes[p, m]) for m in moments if (p, m) in shapes] for p in solved}
    return figures.outline_figure(model, named, {p: shapes[p, HEALED] for p in solved})


def _solved(case: LumpectomyCase, shapes: Shapes) -> list[str]:
    """Return the positions asked for in which an equilibrium of the healed body was found; else that in which it healed."""
    found = [position for position in case.outcome.positions if (position, HEALED) in shapes]
    return found or [case.coupling.healing_position]


def _edges(model: SectionModel, cycle: HealingCycle, pairs: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    def profiles(before: np.ndarray, after: np.ndarray):
        return edge_profile(model, model.intact, cycle.X, before), edge_profile(model, cycle.opened, cycle.X, after)

    return figures.edge_figure({position: profiles(*pair) for position, pair in pairs.items()})


def closing_word(state: TissueState) -> str:
    """Return the label of the last shape in figures, which says whether the wound is closed."""
    return HEALED if state.is_closed else "at the last week"
