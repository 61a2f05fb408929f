"""Figures of the automaton alone: fronts over time, and their speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ...geometry.hexgrid import Lattice

MAX_PIXELS = 1200  # largest number of sites that are drawn along one axis


def closure_figure(
    lattice: Lattice,
    fillable: np.ndarray,
    fronts: Sequence[np.ndarray],
    steps: Sequence[int],
    history: Mapping[str, np.ndarray],
) -> Figure:
    """Draw fronts at some steps (in 3-D: in the middle plane), the radius over time, and the front's speed over the radius.

    fronts: occupancies (bool arrays of the lattice's shape) after ``steps``.
    """
    figure = Figure(figsize=(15, 4.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _fronts(left, lattice, fillable, fronts, steps)
    radius = _radius(lattice, history["n_open"])
    middle.plot(history["step"], radius, color="#0072b2")
    middle.set_xlabel("step")
    middle.set_ylabel("equivalent radius [mm]")
    middle.set_ylim(bottom=0.0)
    middle.grid(alpha=0.3)
    _speed(right, history["step"], radius)
    return figure


def _fronts(
    ax: Axes, lattice: Lattice, fillable: np.ndarray, fronts: Sequence[np.ndarray], steps: Sequence[int]
) -> None:
    plane = np.s_[lattice.shape[0] // 2] if lattice.ndim == 3 else np.s_[:]
    stride = max(1, -(-max(lattice.shape[-2:]) // MAX_PIXELS))
    thin = (slice(None, None, stride),) * 2
    index = np.stack(np.meshgrid(*[np.arange(0, n, stride) for n in lattice.shape[-2:]], indexing="ij"), axis=-1)
    at = index @ lattice.basis_mm[-2:, :2]
    norm, colours = Normalize(0, max(max(steps), 1)), colormaps["viridis"]
    for occupancy, step in zip(fronts, steps):
        is_open = (fillable[plane] & ~occupancy[plane])[thin]
        if is_open.any():
            ax.contour(
                at[..., 0], at[..., 1], is_open.astype(float), [0.5], colors=[colours(norm(step))], linewidths=1.0
            )
    _zoom(ax, at, (fillable[plane] & ~fronts[0][plane])[thin])
    ax.set_aspect("equal")
    ax.set_xlabel("x [mm]")
    ax.set_ylabel("y [mm]")
    ax.set_title("fronts" if lattice.ndim == 2 else "fronts in the middle plane")
    ax.figure.colorbar(ScalarMappable(norm, colours), ax=ax, label="step", shrink=0.8)


def _zoom(ax: Axes, at: np.ndarray, is_open: np.ndarray) -> None:
    """Limit the axes to the initially open sites, with a margin of a tenth of their extent."""
    points = at[is_open]
    if len(points):
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.1 * float((high - low).max()) + 1e-6
        ax.set_xlim(low[0] - margin, high[0] + margin)
        ax.set_ylim(low[1] - margin, high[1] + margin)


def _radius(lattice: Lattice, n_open: np.ndarray) -> np.ndarray:
    """Return the radius of the disc or ball with the same area or volume as the open sites [mm]."""
    measure = n_open * lattice.site_measure
    return np.sqrt(measure / np.pi) if lattice.ndim == 2 else np.cbrt(3.0 * measure / (4.0 * np.pi))


def _speed(ax: Axes, step: np.ndarray, radius: np.ndarray) -> None:
    """Plot the front's speed, averaged over 5 % of the initial radius, until the radius is a tenth of the initial one."""
    marks = radius[0] * np.arange(1.0, 0.09, -0.05)
    at = np.interp(-marks, -radius, step) if len(step) > 1 else np.zeros(0)
    reached = at < step[-1]
    if reached.sum() > 1:
        when, where = at[reached], marks[reached]
        speed = -np.diff(where) / np.diff(when) * 1e3
        ax.plot(0.5 * (where[1:] + where[:-1]), speed, "o-", color="#d55e00", markersize=4)
        ax.set_ylim(0.0, 1.1 * speed.max())
    ax.set_xlabel("equivalent radius [mm], closing to the right")
    ax.set_ylabel("front speed [um per step]")
    ax.invert_xaxis()
    ax.grid(alpha=0.3)
