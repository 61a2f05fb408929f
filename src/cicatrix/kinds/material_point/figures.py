"""Figures of a material point: stress against stretch, and all quantities over time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = {"x": "#0072b2", "y": "#d55e00", "z": "#009e73"}
LINES = {"x": "-", "y": "-", "z": "--"}  # z is drawn over y, which it often equals
HEAT, STORED = "#cc79a7", "#000000"
ARROWS = 5  # number of arrows along a curve


def response_figure(history: Mapping[str, np.ndarray]) -> Figure:
    """Draw Cauchy stress against stretch along x and y; the start is an open mark, the end a full one, arrows show the order."""
    sheared = np.ptp(history["shear"]) > 0.0
    figure = Figure(figsize=(15 if sheared else 10.5, 4.8), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, 3 if sheared else 2))
    for ax, axis in zip(axes, "xy"):
        _path(ax, history[f"lambda_{axis}"], history[f"sigma_{axis}_kPa"], COLOURS[axis])
        ax.set_xlabel(f"stretch $\\lambda_{axis}$ [1]")
        ax.set_ylabel(f"Cauchy stress $\\sigma_{axis}$ [kPa]")
    if sheared:
        _path(axes[2], history["shear"], history["sigma_xy_kPa"], COLOURS["z"])
        axes[2].set_xlabel("shear $F_{xy}$ [1]")
        axes[2].set_ylabel("Cauchy stress $\\sigma_{xy}$ [kPa]")
    return figure


def histories_figure(history: Mapping[str, np.ndarray], grows: bool) -> Figure:
    """Draw stretch, stress, growth (or volume, if nothing grows) and energy over time."""
    figure = Figure(figsize=(11, 7.2 if grows else 6.8), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True).ravel()
    time = history["time_h"]
    for axis, colour in COLOURS.items():
        style = {"color": colour, "linestyle": LINES[axis]}
        axes[0].plot(time, history[f"lambda_{axis}"], label=f"$\\lambda_{axis}$", **style)
        axes[1].plot(time, history[f"sigma_{axis}_kPa"], label=f"$\\sigma_{axis}$", **style)
        if grows:
            axes[2].plot(time, history[f"growth_{axis}"], label=f"$F_{{g,{axis}{axis}}}$", **style)
    if np.ptp(history["shear"]) > 0.0:
        axes[0].plot(time, history["shear"] + 1.0, color=HEAT, label="1 + shear $F_{xy}$")
        axes[1].plot(time, history["sigma_xy_kPa"], color=HEAT, label="$\\sigma_{xy}$")
    if not grows:
        volume = history["lambda_x"] * history["lambda_y"] * history["lambda_z"]
        axes[2].plot(time, volume, color=STORED, label="det F")
    axes[3].plot(time, history["energy_kPa"], color=STORED, label="stored energy")
    axes[3].plot(time, history["dissipation_kPa"], color=HEAT, label="dissipated since the start")
    names = (
        "stretch [1]",
        "Cauchy stress [kPa]",
        "growth [1]" if grows else "volume ratio [1]",
        "energy density [kPa]",
    )
    for number, (ax, name) in enumerate(zip(axes, names)):
        ax.set_ylabel(name)
        ax.set_xlabel("time [h]" if number > 1 else "")
        _dress(ax)
        ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    return figure


def _path(ax: Axes, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    ax.plot(x, y, color=colour, linewidth=1.5)
    for start, end in _arrows(x, y):
        ax.annotate("", (x[end], y[end]), (x[start], y[start]), arrowprops={"arrowstyle": "-|>", "color": colour})
    ax.plot(x[0], y[0], "o", color=colour, markerfacecolor="white", label="start", zorder=3)
    ax.plot(x[-1], y[-1], "o", color=colour, label="end", zorder=3)
    ax.legend(fontsize=8)
    _dress(ax)


def _arrows(x: np.ndarray, y: np.ndarray) -> list[tuple[int, int]]:
    """Return pairs of rows between which arrows are drawn, equally spaced along the curve as drawn."""
    spans = [max(float(np.ptp(column)), 1e-12) for column in (x, y)]
    steps = np.hypot(np.diff(x) / spans[0], np.diff(y) / spans[1])
    length = np.append(0.0, np.cumsum(steps))
    if length[-1] < 1e-6:
        return []
    wanted = (np.arange(ARROWS) + 0.5) / ARROWS * length[-1]
    ends = np.clip(np.searchsorted(length, wanted), 1, len(x) - 1)
    return [(int(end) - 1, int(end)) for end in ends]


def _dress(ax: Axes) -> None:
    """Draw a grid, and widen the limits of a constant quantity, so that round-off is not magnified."""
    ax.grid(alpha=0.3)
    for low, high, put in ((*ax.get_xlim(), ax.set_xlim), (*ax.get_ylim(), ax.set_ylim)):
        middle = 0.5 * (low + high)
        if high - low < 1e-6 * max(abs(middle), 1.0):
            room = 0.05 * max(abs(middle), 1.0)
            put(middle - room, middle + room)
    ax.ticklabel_format(useOffset=False)
