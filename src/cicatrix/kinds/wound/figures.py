"""Figures of a wound that heals by the continuum model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from ...core.units import days_from_hours
from ...files.figures_continuum import VIEW_MM, View

COLOURS = {"centre": "#d55e00", "edge": "#0072b2"}
PANELS = {
    "rho": "cells / healthy tissue [1]",
    "c": "cytokine / largest [1]",
    "phi": "collagen / healthy tissue [1]",
}


def course_figure(history: Mapping[str, np.ndarray], ratio: str) -> Figure:
    """Draw the size of the wound, cells, cytokine, collagen and permanent stretch at its centre and edge, over time."""
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    axes = figure.subplots(2, 3).flat
    days = days_from_hours(history["time_h"])
    ax = next(axes)
    ax.plot(days, history[ratio], color="black", linewidth=1.8)
    ax.set_ylabel("wound area / initial area [1]" if "area" in ratio else "cavity volume / initial volume [1]")
    lam = "lamP_area" if "area" in ratio else "lamP_volume"
    for name, title in {**PANELS, lam: f"permanent stretch of {'area' if 'area' in ratio else 'volume'} [1]"}.items():
        ax = next(axes)
        for where, colour in COLOURS.items():
            ax.plot(days, history[f"{name}_{where}"], color=colour, linewidth=1.6, label=where)
        ax.set_ylabel(title)
        ax.legend(frameon=False, fontsize=9)
    ax = next(axes)
    ax.semilogy(days[1:], history["step_h"][1:], ".-", color="0.35", linewidth=0.8)
    ax.set_ylabel("time step [h]")
    for ax in figure.axes:
        ax.set_xlabel("time [d]")
        ax.grid(alpha=0.3)
    return figure


SHEET = View(("x [mm]", "y [mm]"), window=np.array([[-VIEW_MM, -VIEW_MM], [VIEW_MM, VIEW_MM]]))
BREAST = View(("x [mm]", "z, from the chest wall [mm]"), axis=1)
