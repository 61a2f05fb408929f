"""Figure of tissue that grows because its cells pull at it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from ...core.units import days_from_hours

PANELS = {  # axis label: history column -> name in the legend
    "stretch [1]": {"lambda": "applied", "lambda_s": "elastic", "lambda_g": "grown"},
    "stress [kPa]": {"sigma_kPa": "tissue", "sigma_passive_kPa": "passive part", "traction_kPa": "traction of cells"},
    "adhesion [1]": {"bound_fraction": "fraction of closed bonds", "signal": "signal H"},
    "collagen / healthy tissue [1]": {"m_f": ""},
    "cells [1/mm³]": {"rho_per_mm3": ""},
    "cytokine [g/mm³]": {"c_g_per_mm3": ""},
}
COLOURS = ("#0072b2", "#d55e00", "#009e73")
LONG_H = 48.0  # duration [h] above which the time axis is in days


def tissue_cell_figure(history: Mapping[str, np.ndarray]) -> Figure:
    """Draw stretch, stress, adhesion, collagen, cells and cytokine over time."""
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    in_days = np.ptp(history["time_h"]) > LONG_H
    t = days_from_hours(history["time_h"]) if in_days else history["time_h"]
    for ax, (title, columns) in zip(figure.subplots(2, 3).flat, PANELS.items()):
        for colour, (name, words) in zip(COLOURS, columns.items()):
            ax.plot(t, history[name], color=colour, linewidth=1.6, label=words or None)
        ax.set_ylabel(title)
        ax.set_xlabel("time [d]" if in_days else "time [h]")
        ax.grid(alpha=0.3)
        ax.ticklabel_format(axis="y", useOffset=False)
        if len(columns) > 1:
            ax.legend(frameon=False, fontsize=9)
    return figure
