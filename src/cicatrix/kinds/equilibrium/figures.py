"""Figures of a body in equilibrium: its surface before and after, coloured by displacement, and its history."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ...mechanics.space import SolidSpace

CORNER_TRIANGLES = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]  # flat triangles of a face with midpoints of edges


def shape_figure(space: SolidSpace, start: np.ndarray, found: np.ndarray, inverse: bool) -> Figure:
    """Draw the given and the computed surface side by side, at the same scale: start, found (n_nodes, 3) [mm]."""
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    triangles = space.boundary[:, CORNER_TRIANGLES].reshape(-1, 3)
    moved = np.linalg.norm(found - start, axis=1)
    both = np.vstack([start, found])
    names = ("given", "unloaded" if inverse else "loaded")
    for place, (points, name) in enumerate(zip((start, found), names), 1):
        ax = figure.add_subplot(1, 2, place, projection="3d")
        surface = Poly3DCollection(points[triangles], cmap="viridis", edgecolors=(0, 0, 0, 0.15), linewidths=0.2)
        surface.set_array(moved[triangles].mean(axis=1))
        surface.set_clim(0.0, max(moved.max(), 1e-9))
        ax.add_collection3d(surface)
        low, high = both.min(axis=0), both.max(axis=0)
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]), title=name)
        ax.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
        ax.set_box_aspect(np.maximum(high - low, 1e-9))
    figure.colorbar(surface, ax=figure.axes, shrink=0.7, label="displacement [mm]")
    return figure


def history_figure(history: Mapping[str, np.ndarray]) -> Figure:
    """Draw displacement, volumes and energies of a body under a load history against time."""
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    time = history["time_h"]
    left, middle, right = figure.subplots(1, 3)
    left.plot(time, history["max_displacement_mm"], color="tab:blue")
    left.set(ylabel="largest displacement [mm]", title="shape")
    middle.plot(time, history["volume_ml"] / history["volume_ml"][0], color="tab:green", label="body")
    middle.plot(time, history["growth_mean"], color="tab:olive", ls="--", label="grown tissue, unstrained")
    middle.set(ylabel="volume over initial volume [1]", title="volume")
    right.plot(time, history["strain_energy_uJ"], color="tab:red", label="stored")
    right.plot(time, history["dissipation_uJ"], color="tab:gray", label="dissipated")
    right.set(ylabel="energy [uJ]", title="energy")
    for ax in (left, middle, right):
        ax.set_xlabel("time [h]")
        ax.grid(alpha=0.3)
    middle.legend(frameon=False)
    right.legend(frameon=False)
    return figure
