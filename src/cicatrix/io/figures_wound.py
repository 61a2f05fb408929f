"""Pictures of a wound that heals by fields."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from ..core.units import days_from_hours
from ..geometry.cuts import plane_cut
from ..healing.fields import WoundState
from ..study.wound import WoundModel

COLOURS = {"centre": "#d55e00", "edge": "#0072b2"}
PANELS = {
    "rho": "cells, of healthy tissue [1]",
    "c": "cytokine, of its largest [1]",
    "phi": "collagen, of healthy tissue [1]",
}
MAPS = {"cells": "viridis", "cytokine": "magma", "collagen": "cividis", "permanent stretch": "coolwarm"}
VIEW_MM = 25.0  # half of the side of a sheet's picture


def course_figure(history: Mapping[str, np.ndarray], ratio: str) -> Figure:
    """Size of the wound, and what it holds at its centre and edge, over time."""
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    axes = figure.subplots(2, 3).flat
    days = days_from_hours(history["time_h"])
    ax = next(axes)
    ax.plot(days, history[ratio], color="black", linewidth=1.8)
    ax.set_ylabel(
        "area of the ring over its first [1]" if "area" in ratio else "volume of the cavity over its first [1]"
    )
    lam = "lamP_area" if "area" in ratio else "lamP_volume"
    for name, title in {**PANELS, lam: f"permanent stretch of {'area' if 'area' in ratio else 'volume'} [1]"}.items():
        ax = next(axes)
        for where, colour in COLOURS.items():
            ax.plot(days, history[f"{name}_{where}"], color=colour, linewidth=1.6, label=where)
        ax.set_ylabel(title)
        ax.legend(frameon=False, fontsize=9)
    ax = next(axes)
    ax.semilogy(days[1:], history["step_h"][1:], ".-", color="0.35", linewidth=0.8)
    ax.set_ylabel("step of time [h]")
    for ax in figure.axes:
        ax.set_xlabel("time [d]")
        ax.grid(alpha=0.3)
    return figure


def fields_figure(model: WoundModel, state: WoundState, hours: float) -> Figure:
    """Cells, cytokine, collagen and permanent stretch on the deformed body: a sheet, or the middle plane of a solid."""
    transport = model.solver.transport
    values = {
        "cells": state.fields[:, 0],
        "cytokine": state.fields[:, 1],
        "collagen": transport.at_carriers(state.local.phi),
        "permanent stretch": transport.at_carriers(np.prod(state.local.stretch, axis=-1)),
    }
    x = state.x[transport.carriers]
    is_sheet = transport.space.n_axes == 2
    figure = Figure(figsize=(15, 4.0), layout="constrained")
    figure.suptitle(f"after {days_from_hours(hours):.4g} days, on the deformed body", fontsize=11)
    for ax, (name, field) in zip(figure.subplots(1, 4), values.items()):
        polygons, shown = _squares(x, transport.cells, field) if is_sheet else _cut(x, transport.cells, field)
        drawn = PolyCollection(list(polygons), array=shown, cmap=MAPS[name], edgecolors="face", linewidths=0.2)
        drawn.set_rasterized(True)
        ax.add_collection(drawn)
        figure.colorbar(drawn, ax=ax, shrink=0.8)
        ax.set_title(f"{name} [1]", fontsize=10)
        ax.set_aspect("equal")
        ax.set_xlabel("x [mm]")
        ax.autoscale_view()
        if is_sheet:
            ax.set_xlim(-VIEW_MM, VIEW_MM)
            ax.set_ylim(-VIEW_MM, VIEW_MM)
    figure.axes[0].set_ylabel("y [mm]" if is_sheet else "z, from the chest wall [mm]")
    return figure


def _squares(x: np.ndarray, cells: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quadrilaterals (n, 4, 2), each cut into four, and the field's value in each part (n,)."""
    corners, values = x[cells][..., :2], field[cells]
    pieces, shown = [], []
    for k in range(4):
        ring = [np.roll(part, -k, axis=1) for part in (corners, values)]
        for part, out in zip(ring, (pieces, shown)):
            mid = 0.5 * (part[:, 0] + part[:, 1]), part.mean(axis=1), 0.5 * (part[:, 0] + part[:, 3])
            out.append(np.stack([part[:, 0], *mid], axis=1))
    return np.concatenate(pieces), np.concatenate(shown).mean(axis=1)


def _cut(x: np.ndarray, tetrahedra: np.ndarray, field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Polygons (n, 4, 2) in which the plane y = 0 cuts tetrahedra, and the field's mean in each of these (n,)."""
    polygons, owner = plane_cut(x, tetrahedra, 1, 0.0)
    return polygons[..., [0, 2]], field[tetrahedra[owner]].mean(axis=1)
