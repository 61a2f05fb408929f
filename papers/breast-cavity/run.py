"""Compute a breast cavity over 26 weeks with the continuum model and compare with clinical data: claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import cicatrix
from cicatrix.kinds.registry import load_case
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
MRI = {23.0: 1.0, 32.0: 0.60, 39.0: 0.48, 45.0: 0.40}  # day after surgery: volume relative to the first image
WEEKS = {3.0: 47.0, 8.0: 30.0, 11.5: 21.0, 20.0: 9.0}  # week: volume on planning CT [ml], README.md
History = dict[str, np.ndarray]


def measure(overrides: Sequence[str] = ()) -> History:
    """Run the case and return its history."""
    return cicatrix.simulate(load_case(HERE / "case.toml", overrides)).history


def volume(history: History, days: float) -> float:
    """Return the volume of the initially wounded material relative to its initial volume."""
    return float(np.interp(days, history["time_h"] / 24.0, history["cavity_volume_ratio"]))


def table(h: History) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""
    ratio, days = h["cavity_volume_ratio"], h["time_h"] / 24.0
    least = int(ratio.argmin())
    images = {day: volume(h, day) / volume(h, 23.0) for day in MRI}
    told = ", ".join(f"day {day:g}: {100 * images[day]:.0f} % against {100 * MRI[day]:.0f} %" for day in MRI)
    return [
        (
            "the cavity shrinks, and most of the loss occurs in the first eight weeks",
            f"to {100 * volume(h, 56.0):.1f} % in 8 weeks, {100 * ratio[least]:.1f} % at least, {100 * ratio[-1]:.1f} % after 26",
            bool(1 - volume(h, 56.0) > 0.5 * (1 - ratio[least]) and ratio[least] < 0.95),
        ),
        (
            "part of the contraction is permanent: after 26 weeks 10 % of the volume or more is lost, with permanent stretch",
            f"{100 * (1 - ratio[-1]):.1f} %; permanent volume stretch {h['lamP_volume_edge'][-1]:.2f} at the edge",
            bool(ratio[-1] < 0.9 and h["lamP_volume_edge"][-1] < 0.95),
        ),
        (
            "cells fill it from its edge, and collagen follows",
            f"half the healthy density on day {_half(h, 'edge'):.0f} at the edge, {_half(h, 'centre'):.0f} at the centre; "
            f"collagen {h['phi_edge'][-1]:.2f} and {h['phi_centre'][-1]:.2f} after 26 weeks",
            bool(_half(h, "edge") < _half(h, "centre") < days[-1] and h["phi_centre"][-1] > 0.3),
        ),
        (
            "it shrinks as in clinical images: within 10 points of 100, 60, 48 and 40 % on days 23, 32, 39 and 45",
            told,
            max(abs(images[day] - MRI[day]) for day in MRI) < 0.1,
        ),
        (
            "it shrinks as the clinical means: to less than half by weeks 14 to 26",
            f"{100 * volume(h, 18 * 7):.0f} % in week 18 against {100 * 9 / 47:.0f} %",
            volume(h, 18 * 7) < 0.5,
        ),
    ]


def _half(h: History, where: str) -> float:
    reached = h[f"rho_{where}"] >= 0.5
    return float(h["time_h"][reached][0] / 24.0) if reached.any() else float("inf")


def picture(h: History) -> Figure:
    """Draw the volume next to the clinical data, and cells, collagen and permanent stretch at centre and edge."""
    figure = Figure(figsize=(13, 3.6), layout="constrained")
    ax, *others = figure.subplots(1, 4)
    days = h["time_h"] / 24.0
    ax.plot(days, h["cavity_volume_ratio"], color="black", label="model")
    first = volume(h, 23.0)
    ax.plot(
        list(MRI),
        [first * value for value in MRI.values()],
        "o",
        color="#d55e00",
        label="MRI, scaled to the model on day 23",
    )
    at_start = volume(h, 3.0 * 7)
    weeks = [week * 7 for week in WEEKS]
    ax.plot(
        weeks,
        [at_start * ml / 47.0 for ml in WEEKS.values()],
        "s",
        color="#0072b2",
        label="planning CT, scaled to the model in week 3",
    )
    ax.set_ylabel("volume of the cavity, relative to the start [1]")
    ax.set_ylim(0.0, 1.05)
    ax.legend(frameon=False, fontsize=8)
    titles = {
        "rho": "cells, healthy tissue = 1",
        "phi": "collagen, healthy tissue = 1",
        "lamP_volume": "permanent volume ratio [1]",
    }
    for ax, (key, title) in zip(others, titles.items()):
        for where, colour in {"centre": "#d55e00", "edge": "#0072b2"}.items():
            ax.plot(days, h[f"{key}_{where}"], color=colour, label=where)
        ax.set_ylabel(title)
        ax.legend(frameon=False, fontsize=8)
    for ax in figure.axes:
        ax.set_xlabel("time [d]")
        ax.grid(alpha=0.3)
    return figure


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured = measure()
    picture(measured).savefig(HERE / "breast-cavity.png", dpi=110)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
