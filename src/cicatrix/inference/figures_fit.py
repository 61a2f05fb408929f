"""Figure of a fit: measured and fitted stress, and their difference."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

AXES = {"sigma_x_kPa": "lambda_x", "sigma_y_kPa": "lambda_y", "sigma_z_kPa": "lambda_z", "sigma_xy_kPa": "shear"}
NAMES = {
    "sigma_x_kPa": r"$\sigma_x$",
    "sigma_y_kPa": r"$\sigma_y$",
    "sigma_z_kPa": r"$\sigma_z$",
    "sigma_xy_kPa": r"$\sigma_{xy}$",
    "lambda_x": r"stretch $\lambda_x$ [1]",
    "lambda_y": r"stretch $\lambda_y$ [1]",
    "lambda_z": r"stretch $\lambda_z$ [1]",
    "shear": r"shear $F_{xy}$ [1]",
}
JUMP = 4.0  # step over the median step, beyond which a curve is interrupted
MEASURED, FITTED = "#0072b2", "#d55e00"


def fit_figure(columns: Mapping[str, np.ndarray], stresses: Mapping[str, np.ndarray]) -> Figure:
    """Draw Cauchy stress against stretch, and below it the residual over time, with one column of panels for each stress.

    ``columns``: measured times, stretches and stresses by name; ``stresses``: stresses of the fitted law [kPa]; arrays (n,).
    """
    figure = Figure(figsize=(5.2 * len(stresses), 6.4), layout="constrained")
    axes = figure.subplots(2, len(stresses), squeeze=False, height_ratios=[2, 1])
    for (above, below), (name, fitted) in zip(axes.T, stresses.items()):
        data, along = columns[name], columns[AXES[name]]
        above.plot(along, data, "o", color=MEASURED, markersize=4, markerfacecolor="none", label="measured")
        above.plot(*_broken(along, fitted), "-", color=FITTED, linewidth=1.5, label="fitted law")
        above.set_xlabel(NAMES[AXES[name]])
        above.set_ylabel(f"Cauchy stress {NAMES[name]} [kPa]")
        above.legend(frameon=False)
        below.axhline(0.0, color="black", linewidth=0.8)
        below.plot(columns["time_h"], fitted - data, "o", color=FITTED, markersize=3)
        below.set_xlabel("time [h]")
        below.set_ylabel(f"fitted - measured {NAMES[name]} [kPa]")
        for ax in (above, below):
            ax.grid(alpha=0.3)
    return figure


def _broken(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a curve, with NaN inserted where x jumps, as between two successive loadings."""
    steps = np.abs(np.diff(x))
    if not np.any(steps > 0.0):
        return x, y
    jumps = np.flatnonzero(steps > JUMP * np.median(steps[steps > 0.0])) + 1
    return np.insert(x, jumps, np.nan), np.insert(y, jumps, np.nan)
