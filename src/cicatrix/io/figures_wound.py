"""Pictures of a wound that heals by fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import CenteredNorm
from matplotlib.figure import Figure

from ..core.units import days_from_hours
from ..geometry.cuts import plane_cut
from ..healing.fields import WoundState
from ..healing.transport import Transport

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


class View(NamedTuple):
    """How fields are shown: a body of two dimensions as it is, of a solid the plane where one axis is constant."""

    labels: tuple[str, str]
    axis: int = 2
    at_mm: float = 0.0
    window: np.ndarray | None = None
    """Lower and upper corner (2, 2) [mm]; all there is without."""
    is_downward: bool = False
    """Whether the vertical axis points down."""


SHEET = View(("x [mm]", "y [mm]"), window=np.array([[-VIEW_MM, -VIEW_MM], [VIEW_MM, VIEW_MM]]))
BREAST = View(("x [mm]", "z, from the chest wall [mm]"), axis=1)


def fields_figure(transport: Transport, state: WoundState, x: np.ndarray, days: float, view: View) -> Figure:
    """Cells, cytokine, collagen and permanent stretch on the body at positions x (n_nodes, 3) [mm]."""
    values = {
        "cells": state.fields[:, 0],
        "cytokine": state.fields[:, 1],
        "collagen": transport.at_carriers(state.local.phi),
        "permanent stretch": transport.at_carriers(np.prod(state.local.stretch, axis=-1)),
    }
    figure = Figure(figsize=(15, 4.0), layout="constrained")
    figure.suptitle(f"after {days:.4g} days, on the deformed body", fontsize=11)
    for ax, (name, field) in zip(figure.subplots(1, 4), values.items()):
        polygons, shown = _polygons(x[transport.carriers], transport, field, view)
        norm = CenteredNorm(1.0) if name == "permanent stretch" else None  # white is none
        drawn = PolyCollection(
            list(polygons), array=shown, cmap=MAPS[name], norm=norm, edgecolors="face", linewidths=0.2
        )
        drawn.set_rasterized(True)
        ax.add_collection(drawn)
        figure.colorbar(drawn, ax=ax, shrink=0.8)
        ax.set_title(f"{name} [1]", fontsize=10)
        ax.set_aspect("equal")
        ax.set_xlabel(view.labels[0])
        ax.autoscale_view()
        if view.window is not None:
            ax.set_xlim(*view.window[:, 0])
            ax.set_ylim(*view.window[:, 1])
        if view.is_downward:
            ax.invert_yaxis()
    figure.axes[0].set_ylabel(view.labels[1])
    return figure


def _polygons(x: np.ndarray, transport: Transport, field: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Polygons (n, a, 2) [mm] and the field's mean in each of these (n,)."""
    cells = transport.cells
    if transport.space.n_axes == 2:
        return _parts(x[cells][..., :2], field[cells])
    polygons, owner = plane_cut(x, cells, view.axis, view.at_mm)
    kept = [k for k in range(3) if k != view.axis]
    return polygons[..., kept], field[cells[owner]].mean(axis=1)


def _parts(corners: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Elements of the plane (n, a, 2), each cut into one part for each corner, and the field's value in each part."""
    pieces, shown = [], []
    for k in range(corners.shape[1]):
        ring = [np.roll(part, -k, axis=1) for part in (corners, values)]
        for part, out in zip(ring, (pieces, shown)):
            mid = 0.5 * (part[:, 0] + part[:, 1]), part.mean(axis=1), 0.5 * (part[:, 0] + part[:, -1])
            out.append(np.stack([part[:, 0], *mid], axis=1))
    return np.concatenate(pieces), np.concatenate(shown).mean(axis=1)
