"""Compute the circular wound in a sheet over two weeks with the continuum model: claim | measured | holds."""

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
RUNS = {
    "as it is": [],
    "numb cells": ['mechanosensing.type="none"'],
    "no pull": ["parameters.t_rho_MPa=0.0", "parameters.t_rho_c_MPa=0.0"],
    "stays in shape": ["parameters.tau_P=1e9"],
    "ten times the exactness": ["solver.time_tolerance=1e-5"],
    "twice the elements": ["elements=80"],
}
STYLES = {"as it is": "-", "numb cells": "--", "stays in shape": ":", "twice the elements": "-."}
PANELS = {
    "rho": "cells, healthy tissue = 1",
    "phi": "collagen, healthy tissue = 1",
    "c": "cytokine, maximum = 1",
}
History = dict[str, np.ndarray]


def measure(overrides: Sequence[str] = (), runs: Sequence[str] = tuple(RUNS)) -> dict[str, History]:
    """Run the reference case and one variant per changed parameter."""
    return {name: cicatrix.simulate(load_case(HERE / "case.toml", [*overrides, *RUNS[name]])).history for name in runs}


def at(history: History, name: str, days: np.ndarray | float) -> np.ndarray:
    """Interpolate a column of the history linearly to given times [days]."""
    return np.interp(days, history["time_h"] / 24.0, history[name])


def apart(one: History, other: History, name: str = "ring_area_ratio") -> float:
    """Return the largest difference of two histories at the ends of days 1 to 14."""
    days = np.arange(1.0, 15.0)
    return float(np.abs(at(one, name, days) - at(other, name, days)).max())


def table(m: dict[str, History]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""
    own = m["as it is"]
    ring, days = own["ring_area_ratio"], own["time_h"] / 24.0
    least = int(ring.argmin())
    numb, stays, exact, fine = (
        m[name] for name in ("numb cells", "stays in shape", "ten times the exactness", "twice the elements")
    )
    half = {where: float(np.interp(0.5, own[f"rho_{where}"], days)) for where in ("edge", "centre")}
    return [
        (
            "the ring shrinks at first and recovers a little before two weeks",
            f"to {100 * ring[least]:.1f} % on day {days[least]:.1f}, {100 * ring[-1]:.1f} % on day 14",
            bool(
                3.0 < days[least] < 14.0
                and ring[least] < 0.95
                and 1e-3 < ring[-1] - ring[least] < 0.5 * (1 - ring[least])
            ),
        ),
        (
            "cells migrate from the edge, and their density at the centre exceeds that of healthy tissue within two weeks",
            f"half of it on day {half['edge']:.1f} at the edge, {half['centre']:.1f} at the centre; in the end "
            f"{own['rho_edge'][-1]:.2f} and {own['rho_centre'][-1]:.2f}",
            bool(half["edge"] < half["centre"] < 14.0 and own["rho_centre"][-1] > 1.0),
        ),
        (
            "collagen follows, later at the centre than at the edge, and is below that of healthy tissue after two weeks",
            f"{own['phi_edge'][-1]:.2f} at the edge, {own['phi_centre'][-1]:.2f} at the centre",
            bool(own["phi_centre"][-1] < own["phi_edge"][-1] < 1.0),
        ),
        (
            "traction of cells closes the wound: without traction the ring does not change",
            f"changes by {np.abs(m['no pull']['ring_area_ratio'] - 1).max():.0e}",
            bool(np.abs(m["no pull"]["ring_area_ratio"] - 1).max() < 1e-9),
        ),
        (
            "part of the contraction is permanent: the wound shrinks more with than without permanent deformation",
            f"least area {100 * ring.min():.1f} % against {100 * stays['ring_area_ratio'].min():.1f} %; permanent area stretch "
            f"at the edge {own['lamP_area_edge'][-1]:.3f}",
            bool(ring.min() < stays["ring_area_ratio"].min() - 0.01 and own["lamP_area_edge"][-1] < 0.99),
        ),
        (
            "mechanosensing increases contraction: the smallest area is lower by more than 1 % of the initial area",
            f"{100 * ring.min():.2f} % against {100 * numb['ring_area_ratio'].min():.2f} %",
            bool(numb["ring_area_ratio"].min() - ring.min() > 0.01),
        ),
        (
            "converged in time: a tenth of the tolerance changes the area of the ring by less than 1e-3",
            f"{apart(own, exact):.1e}, {len(ring) - 1} steps against {len(exact['step']) - 1}",
            apart(own, exact) < 1e-3,
        ),
        (
            "converged in space: twice the elements per side change the area of the ring by less than 1 %",
            f"{apart(own, fine):.1e}; collagen at the edge by {apart(own, fine, 'phi_edge'):.1e}",
            apart(own, fine) < 0.01,
        ),
    ]


def picture(m: dict[str, History]) -> Figure:
    """Draw the area of the ring, and cells, collagen and cytokine at centre and edge."""
    figure = Figure(figsize=(13, 3.6), layout="constrained")
    ax, *others = figure.subplots(1, 4)
    for name, style in STYLES.items():
        ax.plot(m[name]["time_h"] / 24.0, m[name]["ring_area_ratio"], style, color="black", linewidth=1.4, label=name)
    ax.set_ylabel("area of the ring, relative to the start [1]")
    ax.legend(frameon=False, fontsize=8)
    for ax, (key, title) in zip(others, PANELS.items()):
        for where, colour in {"centre": "#d55e00", "edge": "#0072b2"}.items():
            for name in ("as it is", "twice the elements"):
                label = where if name == "as it is" else None
                ax.plot(m[name]["time_h"] / 24.0, m[name][f"{key}_{where}"], STYLES[name], color=colour, label=label)
        ax.set_ylabel(title)
        ax.legend(frameon=False, fontsize=8)
    for ax in figure.axes:
        ax.set_xlabel("time [d]")
        ax.grid(alpha=0.3)
    return figure


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured = measure()
    picture(measured).savefig(HERE / "circular-wound.png", dpi=110)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
