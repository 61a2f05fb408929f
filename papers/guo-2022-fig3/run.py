"""Creep and growth under constant biaxial stress (Guo, Mofrad & Buganza Tepole, Fig. 3): prints claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cicatrix.cases.laws import law_of
from cicatrix.kinds.material_point.build import control_of, instants_of
from cicatrix.kinds.material_point.case import PointCase
from cicatrix.kinds.registry import load_case
from cicatrix.mechanics.point_integration import integrate_all
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
COLOURS = {"lambda": "#000000", "elastic": "#0072b2", "growth": "#d55e00"}
WORDS = {"lambda": r"total stretch $\lambda$", "elastic": r"$\lambda / F_g$: elastic and viscous", "growth": "$F_g$"}
NEVER_H = 1e9  # growth time of the comparison run without growth


def history(case: PointCase) -> dict[str, np.ndarray]:
    """Return time (n,) [s] and, along x and y (n, 2), total stretch, growth stretch and their quotient [1]."""
    points = integrate_all(
        law_of(case), control_of(case.loading), instants_of(case.loading), case.solver.relative_tolerance
    ).points
    stretch, growth = np.asarray(points.stretch)[:, :2], np.asarray(points.growth)[:, [0, 1], [0, 1]]
    return {"time_s": np.asarray(points.time), "lambda": stretch, "growth": growth, "elastic": stretch / growth}


def measure(overrides: Sequence[str] = ()) -> dict[str, dict[str, np.ndarray]]:
    """Return the histories with and without growth, and the time constants of the case [s]."""
    case = load_case(HERE / "case.toml", overrides)
    without_growth = load_case(HERE / "case.toml", [*overrides, f"law.1.growth.tau_h={NEVER_H}"])
    fibres = case.law[1]
    told = {"relaxation": np.array(fibres.viscous.relaxation_s), "tau_g": np.array(3600.0 * fibres.growth.tau_h)}
    return {"growing": history(case), "without_growth": history(without_growth), "case": told}


def table(m: dict[str, dict[str, np.ndarray]]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""
    growing, without_growth, relaxation = m["growing"], m["without_growth"], float(m["case"]["relaxation"])
    t = growing["time_s"]
    crept = np.log(without_growth["lambda"] / without_growth["lambda"][0])  # without growth
    creep = _when(t, crept.sum(axis=1), (1 - np.exp(-1)) * crept[-1].sum())
    grown, whole = np.log(growing["growth"]).sum(axis=1), np.log(growing["lambda"]).sum(axis=1)
    early, late = int(np.searchsorted(t, 3.0 * creep)), int(np.searchsorted(t, 10.0 * creep))
    before = (grown[early] - grown[0]) / (whole[early] - whole[0])
    after = (grown[-1] - grown[late]) / (whole[-1] - whole[late])
    as_much = _when(t, grown, crept[-1].sum())
    rate = np.diff(growing["growth"], axis=0) / np.diff(t)[:, None]
    ratio = rate[-1] / rate[late]
    return [
        (
            "viscous creep comes first: 63 % of it within 1 to 3 relaxation times; by 3 times that, growth is less than 10 % of "
            "the deformation",
            f"{creep:.1f} s = {creep / relaxation:.2f} relaxation times; growth's share by {t[early]:.0f} s: "
            f"{100 * before:.1f} %",
            1.0 < creep / relaxation < 3.0 and before < 0.1,
        ),
        (
            "then growth drives the deformation (more than 95 % of the change after ten times that)",
            f"{100 * after:.2f} % of the change of area between {t[late]:.0f} and {t[-1]:.0f} s (logarithms)",
            after > 0.95,
        ),
        (
            "the scales are separated: growth takes more than ten times as long as creep for the same change of area",
            f"{as_much:.0f} s / {creep:.1f} s = {as_much / creep:.0f}; tau_g / relaxation time = "
            f"{float(m['case']['tau_g']) / relaxation:.0f}",
            as_much > 10.0 * creep,
        ),
        (
            "growth continues: its rate at the end equals that after the creep within 1 %, and the elastic stretch is above 1",
            f"rate {3600 * rate[-1, 0]:.4f}, {3600 * rate[-1, 1]:.4f} /h along x, y: {ratio[0]:.4f}, {ratio[1]:.4f} of the "
            f"earlier one; stretch {growing['elastic'][-1, 0]:.4f}, {growing['elastic'][-1, 1]:.4f}",
            bool((np.abs(ratio - 1.0) < 0.01).all() and (rate[-1] > 0).all() and (growing["elastic"][-1] > 1).all()),
        ),
    ]


def draw(m: dict[str, dict[str, np.ndarray]]) -> Figure:
    """Draw total stretch, elastic stretch and growth over time along both axes."""
    growing = m["growing"]
    t = growing["time_s"]
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for i, (ax, title) in enumerate(zip(axes, ("along x, the mean fibre direction", "along y, across"), strict=True)):
        for name, words in WORDS.items():
            ax.plot(t[1:], growing[name][1:, i], color=COLOURS[name], label=words)
        ax.plot(
            t[1:],
            m["without_growth"]["lambda"][1:, i],
            color="#888888",
            linestyle="--",
            label=r"$\lambda$ without growth",
        )
        for when, words in (("relaxation", "relaxation"), ("tau_g", r"$\tau_g$")):
            at = float(m["case"][when])
            ax.axvline(at, color="#888888", linewidth=0.8, linestyle=":")
            ax.text(at, 0.985, f"{words} ", transform=ax.get_xaxis_transform(), ha="right", va="top", rotation=90)
        ax.set_xscale("log")
        ax.set_title(title)
        ax.set_xlabel("time [s]")
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("stretch [1]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    return figure


def _when(t: np.ndarray, rising: np.ndarray, value: float) -> float:
    """Return the time at which a rising curve reaches a value."""
    return float(np.interp(value, rising, t))


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured = measure()
    draw(measured).savefig(HERE / "fig3.png", dpi=110)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
