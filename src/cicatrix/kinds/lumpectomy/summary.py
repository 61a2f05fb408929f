"""Numbers of a lumpectomy: one row of the history per cycle, and the outcome."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from ...core.units import weeks_from_days
from ...coupling.cycle import HealingCycle
from ...coupling.healing import TissueState
from ...geometry.transfer import linear_fit
from ...mechanics.body import Body
from ...outcome import closure
from ...outcome.change import ShapeChange
from ...runs.quantity import Quantity
from .body import BreastModel
from .conditioning import Conditioned
from .section import SectionModel

UNITS = {"percent": "%", "mm": "mm"}
# columns of the history of a section and of a solid: open size, size of the front, size of new tissue
SIZES = {
    2: ("open_area_mm2", "wound_perimeter_mm", "tissue_area_mm2"),
    3: ("open_volume_mm3", "wound_area_mm2", "tissue_volume_mm3"),
}


def history_row(cycle: HealingCycle, state: TissueState) -> dict[str, float | int]:
    """Compute one row of history.csv; in a section, energies are per mm of depth."""
    lattice, open0 = cycle.ruler.lattice, cycle.ruler.open0
    occupancy, is_open = cycle.occupancy(state), cycle.open_sites(state)
    open_size, front_size, tissue_size = SIZES[lattice.ndim]
    moved = np.linalg.norm(state.x - cycle.X, axis=1)[_vertices(cycle.intact)]
    return {
        "cycle": state.cycle,
        "time_days": cycle.days(state.cycle),
        "closed_fraction": 1.0 - np.count_nonzero(is_open) / np.count_nonzero(open0),
        open_size: closure.open_size(lattice, is_open),
        front_size: closure.front_size(lattice, is_open, occupancy),
        "n_cells": int(np.count_nonzero(occupancy)),
        "strain_energy_uJ": cycle.body(state).strain_energy(cycle.X, state.x),
        "wound_energy_mean_kPa": cycle.edge_energy(state),
        "max_displacement_mm": float(moved.max()),
        "newton_iterations": state.newton_iterations,
        "wound_asymmetry": closure.asymmetry(is_open, closure.wound_centre(open0)),
        "wound_roundness": closure.roundness(lattice, is_open),
        "wound_drift_mm": float(np.linalg.norm(closure.centroid_shift(lattice, is_open, open0))),
        "clamped_cells": 0,  # replaced below by models that have clamped cells
        tissue_size: float(np.sum(cycle.intact.volumes(cycle.X) * cycle.filled(state)[:, None])),
        **cycle.healing.measured(state),
    }


def _vertices(body: Body) -> np.ndarray:
    space = body.discretization.space
    return np.unique(space.element_nodes[:, : space.n_axes + 1])


def closure_numbers(cycle: HealingCycle, state: TissueState, rows: list[dict]) -> dict[str, Quantity]:
    """Compute the time to closure, and measures of the asymmetry of the front."""
    if state.is_closed:
        days = Quantity(state.closure_days, "days", cycle.healing.closes)
    else:
        days = Quantity(None, "days", f"still {100 * (1 - rows[-1]['closed_fraction']):.1f} % open at the last cycle")
    half = next((r for r in rows if r["closed_fraction"] >= 0.5), rows[-1])
    note = f"at {100 * half['closed_fraction']:.0f} % closed; {rows[0]['wound_asymmetry']:.3f} when fresh; 0 = point-symmetric"
    return {
        "time_to_closure_days": days,
        "wound_asymmetry": Quantity(half["wound_asymmetry"], "1", note),
        "wound_drift_mm": Quantity(
            half["wound_drift_mm"], "mm", "shift of the open wound's centroid, at the same cycle"
        ),
        "fresh_wound_energy_mean_kPa": Quantity(state.W_ref, "kPa", "mean over the fresh wound edge: W_ref"),
    }


def nipple_motion(model: BreastModel, supine: np.ndarray) -> dict[str, Quantity]:
    """Return how far the nipple moves from the prone image to a supine shape before surgery (n_nodes, 3) [mm]."""
    moved = model.nipple_position(supine) - model.nipple_position(model.x_imaged)
    lps = model.to_patient(moved)
    outwards = lps[0] if model.side == "left" else -lps[0]
    words = f"before surgery; {lps[1]:.0f} mm backwards, {outwards:.0f} outwards, {-lps[2]:.0f} down"
    return {"nipple_prone_to_supine_mm": Quantity(float(np.linalg.norm(moved)), "mm", words)}


def fitted_numbers(fit: Conditioned) -> dict[str, Quantity]:
    """Return the factors of stiffness that were fitted to the nipple's place lying supine."""
    out = {}
    for which, (name, what) in enumerate(
        {"tissue": "fat, gland, tumour and scar", "fascia": "the fascia's springs"}.items()
    ):
        low, high = fit.interval(which)
        note = f"times the stiffness of {what} in the case; 5-95 %: {low:.2g} to {high:.2g}"
        out[f"{name}_stiffness_factor"] = Quantity(float(fit.factors()[which]), "1", note)
    out["supine_nipple_misfit_mm"] = Quantity(
        fit.misfit_mm, "mm", "distance of the nipple from outcome.supine_nipple_mm"
    )
    return out


def outcome_numbers(changes: dict[tuple[str, str], ShapeChange], main: tuple[str, str]) -> dict[str, Quantity]:
    """Return outcomes from the shape changes of each (position, visit); those of ``main`` also under their names alone."""
    out: dict[str, Quantity] = {}
    for field in fields(ShapeChange):
        unit = UNITS.get(field.name.rsplit("_", 1)[1], "mm")
        out[field.name] = Quantity(
            getattr(changes[main], field.name), unit, f"{main[0]}, {main[1]}, compared with before surgery"
        )
    for (position, visit), change in changes.items():
        for field in fields(ShapeChange):
            unit = out[field.name].unit
            out[f"{position}.{visit.replace(' ', '_')}.{field.name}"] = Quantity(getattr(change, field.name), unit)
    return out


def visit_name(weeks: float) -> str:
    """Return the name of a visit, such as ``week 2``."""
    return f"week {weeks:g}"


def closing_sentence(cycle: HealingCycle, state: TissueState) -> str:
    """Return a sentence about how the healing ended."""
    if state.is_closed:
        days = state.closure_days
        return f"The wound closed after {days:.1f} days ({weeks_from_days(days):.1f} weeks, {state.cycle} cycles)."
    return f"The wound is still open after {cycle.days(state.cycle):.0f} days, the last that the case allows."


def edge_profile(model: SectionModel, body: Body, X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the strain energy density of the tissue along the cavity's edge (Garbey et al., Fig. 2).

    X, x (n_nodes, 3) [mm] -> angle around the cavity's centre as imaged (n,) [degrees], ascending, and energy (n,)
    [kPa] on the outer side of each edge of the cavity.
    """
    space = body.discretization.space
    mesh = space.mesh
    border = model.cavity_border
    inner, outer = mesh.f2t[:, border]
    side = np.where(model.cavity[inner], outer, inner)
    coefficients = linear_fit(body.energy_density(X, x), body.volumes(X), space.table.points)[side]
    middle = mesh.p[:, mesh.facets[:, border]].mean(axis=1).T
    local = _local(mesh.p[:, mesh.t[:, side]].transpose(2, 1, 0), middle)
    W = coefficients[:, 0] + np.sum(coefficients[:, 1:] * (local - 1.0 / 3.0), axis=1)
    spoke = middle - model.section.from_patient(model.centre_mm)[:2]
    angle = np.degrees(np.arctan2(spoke[:, 1], spoke[:, 0])) % 360.0
    order = np.argsort(angle)
    return angle[order], np.maximum(W[order], 0.0)


def _local(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Compute coordinates in the reference triangle: corners (n, 3, 2), points (n, 2) -> (n, 2)."""
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
    return np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
