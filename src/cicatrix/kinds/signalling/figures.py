"""Figures of a signalling network: time course, steady states and parameter sensitivities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...biology.steady import SteadyStates

MAX_LINES = 20  # largest number of species drawn as lines; more are drawn as a map
MAX_PARAMETERS = 30  # largest number of parameters that are shown
MIN_SENSITIVITY = 0.02  # fraction of the largest sensitivity below which a parameter is not shown
MARKS = ("-", "--", ":", "-.")


def courses_figure(
    history: Mapping[str, np.ndarray], names: Sequence[str], inputs: Sequence[str], unit: str = " [1]"
) -> Figure:
    """Draw all species over time, as lines or as a map.

    Above them, draw the inputs that the case sets. ``unit`` is written behind the labels of the axes.
    """
    tall = 0.26 * len(names) + 1.5 if len(names) > MAX_LINES else 5.0
    figure = Figure(figsize=(10, tall + (1.6 if inputs else 0.0)), layout="constrained")
    heights = [1.2, tall] if inputs else None
    axes = np.atleast_1d(figure.subplots(2 if inputs else 1, 1, sharex=True, height_ratios=heights))
    time = history["time_h"]
    for name, colour in zip(inputs, _colours(len(inputs))):
        axes[0].step(time, history[f"input_{name}"], where="post", color=colour, label=name)
    if inputs:
        axes[0].set_ylabel(f"input{unit}")
        axes[0].grid(alpha=0.3)
        axes[0].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    states = np.array([history[name] for name in names])
    if len(names) > MAX_LINES:
        _map_over_time(axes[-1], time, states, names, unit)
    else:
        _lines_over_time(axes[-1], time, states, names, unit)
    axes[-1].set_xlabel("time [h]")
    return figure


def states_figure(found: SteadyStates, names: Sequence[str], unit: str = " [1]") -> Figure:
    """Draw the activities in every steady state, with its stability and the number of initial states that reached it."""
    figure = Figure(figsize=(max(5.0, 0.42 * len(names) + 3.0), 0.5 * len(found.states) + 2.2), layout="constrained")
    ax = figure.subplots()
    values = np.array([state.y for state in found.states])
    image = ax.imshow(values, aspect="auto", cmap="viridis", vmin=0.0)
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    words = [
        f"{number}: {'stable' if state.is_stable else 'unstable'}, {state.n_starts} of {len(found.reached)} starts"
        for number, state in enumerate(found.states, 1)
    ]
    ax.set_yticks(range(len(words)), words)
    if len(names) <= MAX_LINES:
        _write_values(ax, values)
    figure.colorbar(image, ax=ax, label=_quantity(unit))
    return figure


def branches_figure(found: Mapping[float, SteadyStates], names: Sequence[str], over: str, unit: str = " [1]") -> Figure:
    """Draw the steady states of each species against an input: full marks are stable, open marks unstable."""
    columns = min(4, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(2.9 * columns, 2.3 * rows), layout="constrained")
    axes = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True)).ravel()
    for ax in axes[len(names) :]:
        ax.set_axis_off()
    for k, (ax, name) in enumerate(zip(axes, names)):
        for is_stable, face in ((False, "white"), (True, "#0072b2")):
            points = [(v, s.y[k]) for v, one in found.items() for s in one.states if s.is_stable == is_stable]
            if points:
                ax.plot(*np.array(points).T, "o", ms=4, color="#0072b2", markerfacecolor=face)
        ax.set_title(name, fontsize=9)
        ax.grid(alpha=0.3)
    figure.supxlabel(f"input {over}")
    figure.supylabel(f"steady {_quantity(unit)}; open: unstable")
    return figure


def sensitivities_figure(rows: Sequence[Sequence[Any]]) -> Figure:
    """Draw relative sensitivities p dy/dp, one map for each state, with outputs as columns and the main parameters as rows."""
    maps = {at: _sensitivity_map([row for row in rows if row[0] == at]) for at in dict.fromkeys(row[0] for row in rows)}
    wide = sum(0.32 * len(outputs) + 2.6 for _, outputs, _ in maps.values())
    tall = max(0.2 * len(names) + 2.0 for names, _, _ in maps.values())
    figure = Figure(figsize=(max(5.0, wide), max(3.5, tall)), layout="constrained")
    for ax, (at, (names, outputs, values)) in zip(np.atleast_1d(figure.subplots(1, len(maps))), maps.items()):
        most = max(float(np.abs(values).max(initial=0.0)), 1e-12)
        image = ax.imshow(values, aspect="auto", cmap="RdBu_r", vmin=-most, vmax=most)
        ax.set_xticks(range(len(outputs)), outputs, rotation=90, fontsize=8)
        ax.set_yticks(range(len(names)), names, fontsize=8)
        ax.set_title(at, fontsize=10)
        figure.colorbar(image, ax=ax, label="p dy/dp [1]")
    return figure


def _sensitivity_map(rows: Sequence[Sequence[Any]]) -> tuple[list[str], list[str], np.ndarray]:
    outputs = list(dict.fromkeys(row[1] for row in rows))
    names = list(dict.fromkeys(f"{row[2]} {row[3]}" for row in rows))
    values = np.zeros((len(names), len(outputs)))
    for _, output, kind, of, _, _, relative in rows:
        values[names.index(f"{kind} {of}"), outputs.index(output)] = relative
    weight = np.abs(values).max(axis=1, initial=0.0)
    order = [
        i for i in np.argsort(-weight, kind="stable")[:MAX_PARAMETERS] if weight[i] > MIN_SENSITIVITY * weight.max()
    ]
    return [names[i] for i in order], outputs, values[order]


def _quantity(unit: str) -> str:
    """Return what the states of a network are called: activities if they have a unit, amounts in the model's own unit if not."""
    return f"activity{unit}" if unit else "amount or concentration"


def _lines_over_time(ax: Axes, time: np.ndarray, states: np.ndarray, names: Sequence[str], unit: str) -> None:
    for number, (name, values, colour) in enumerate(zip(names, states, _colours(len(names)))):
        ax.plot(time, values, MARKS[number // 10 % len(MARKS)], color=colour, label=name)
    ax.set_ylabel(_quantity(unit))
    ax.grid(alpha=0.3)
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8)


def _map_over_time(ax: Axes, time: np.ndarray, states: np.ndarray, names: Sequence[str], unit: str) -> None:
    image = ax.pcolormesh(time, np.arange(len(names)), states, cmap="viridis", shading="nearest", rasterized=True)
    ax.set_yticks(range(len(names)), names, fontsize=7)
    ax.invert_yaxis()
    ax.figure.colorbar(image, ax=ax, label=_quantity(unit))


def _write_values(ax: Axes, values: np.ndarray) -> None:
    middle = 0.5 * values.max()
    for (i, k), value in np.ndenumerate(values):
        text = f"{value:.2f}" if 0.01 <= abs(value) < 1000.0 or not value else f"{value:.1e}"
        colour = "white" if value < middle else "black"
        ax.text(k, i, text, ha="center", va="center", fontsize=7, color=colour)


def _colours(n: int) -> list[Any]:
    ten = matplotlib.colormaps["tab10"].colors
    return [ten[i % 10] for i in range(n)]
