"""Figures of a cell's adhesion: its bonds over time, and its steady state against the stretch of the substrate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

MEAN = "#000000"
PANELS = {
    "bound_fraction": "bound fraction [1]",
    "traction_kPa": "traction [kPa]",
    "flow_um_per_s": "actin velocity [um/s]",
}


def course_figure(history: Mapping[str, np.ndarray], mean: tuple[np.ndarray, np.ndarray] | None) -> Figure:
    """Draw bound fraction and traction over time (for clutches also the velocity of actin), with one colour per stretch.

    Bands show one standard deviation between cells. ``mean`` has times (r,) and bound fractions (r, s) of the mean field, which
    are drawn with the samples.
    """
    rows = {name: values.reshape(-1, np.sum(history["step"] == 0)) for name, values in history.items()}
    panels = {name: words for name, words in PANELS.items() if name in rows}
    figure = Figure(figsize=(5.5 * len(panels), 4.6), layout="constrained")
    axes = figure.subplots(1, len(panels))
    t, n = rows["time_s"][:, 0], rows["stretch"].shape[1]
    for i in range(n):
        colour = colormaps["viridis"](0.9 * i / max(n - 1, 1))
        bound, sd = rows["bound_fraction"][:, i], rows["bound_fraction_sd"][:, i]
        band = "sd between cells" if i == 0 and sd.any() else None
        axes[0].fill_between(t, bound - sd, bound + sd, color=colour, alpha=0.2, linewidth=0, label=band)
        axes[0].plot(t, bound, color=colour, linewidth=1.3, label=f"stretch {rows['stretch'][0, i]:g}")
        for ax, name in zip(axes[1:], list(panels)[1:]):
            ax.plot(t, rows[name][:, i], color=colour, linewidth=1.3)
        if mean is not None:
            label = "mean field" if i == n - 1 else None
            axes[0].plot(mean[0], mean[1][:, i], color=MEAN, linestyle="--", linewidth=0.9, label=label)
    for ax, words in zip(axes, panels.values()):
        ax.set_xlabel("time [s]")
        ax.set_ylabel(words)
        ax.set_ylim(bottom=0.0)
        ax.grid(alpha=0.3)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)
    return figure


def stretch_figure(numbers: Mapping[str, Any]) -> Figure:
    """Draw stiffness, force, bound fraction and traction in the steady state against the substrate's stretch."""
    panels = {
        "stiffness_pN_um": "effective stiffness [pN/um]",
        "force_pN": "force of a bond [pN]",
        "steady_bound_fraction": "bound fraction [1]",
        "steady_traction_kPa": "traction [kPa]",
    }
    figure = Figure(figsize=(13, 3.6), layout="constrained")
    order = np.argsort(numbers["stretch"])
    for ax, (name, words) in zip(figure.subplots(1, len(panels)), panels.items()):
        values = np.array(numbers[name])[order]
        ax.plot(np.array(numbers["stretch"])[order], values, "o-", color="#0072b2")
        ax.set_xlabel("stretch [1]")
        ax.set_ylabel(words)
        ax.grid(alpha=0.3)
        ax.set_ylim(0.0, 1.08 * max(values.max(), 1e-300))
        ax.ticklabel_format(useOffset=False)
    return figure
