"""Stretch viscous, wavy fibres cyclically (Guo, Mofrad & Buganza Tepole, Fig. 2): prints claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cicatrix.cases.laws import law_of
from cicatrix.kinds.material_point.build import control_of, first_of_last_cycle, instants_of, work
from cicatrix.kinds.registry import load_case
from cicatrix.mechanics.point_integration import integrate_all
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
SLOWER = {"slow": 100.0, "middle": 1.0, "fast": 0.01}  # factor on the period of the case
COLOURS = {"slow": "#009e73", "middle": "#0072b2", "fast": "#d55e00"}
TOLERANCE = 0.02  # relative difference between area of the loop and heat


def loop(slower: float, overrides: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Return the last cycle, with columns as in the ``history.csv`` of ``cicatrix run``."""
    case = load_case(HERE / "case.toml", overrides)
    times = [slower * time for time in case.loading.time_h]
    case = load_case(HERE / "case.toml", [*overrides, f"loading.time_h={times}"])
    points = integrate_all(
        law_of(case), control_of(case.loading), instants_of(case.loading), case.solver.relative_tolerance
    ).points
    stretch, stress = np.asarray(points.stretch), np.asarray(points.stress)
    rows = {f"lambda_{axis}": stretch[:, i] for i, axis in enumerate("xyz")}
    rows |= {f"sigma_{axis}_kPa": stress[:, i, i] for i, axis in enumerate("xyz")}
    rows |= {"sigma_xy_kPa": stress[:, 0, 1], "shear": np.asarray(points.shear)}
    rows |= {"time_s": np.asarray(points.time), "dissipation_kPa": np.asarray(points.dissipation)}
    return {name: values[first_of_last_cycle(case) :] for name, values in rows.items()}


def measure(overrides: Sequence[str] = ()) -> dict[str, dict[str, np.ndarray]]:
    """Return the last cycle at each rate."""
    return {name: loop(slower, overrides) for name, slower in SLOWER.items()}


def stiffening(rows: dict[str, np.ndarray], axis: str) -> float:
    """Return the ratio of the stress-stretch slopes over the last and the first eighth of loading."""
    up = len(rows["time_s"]) // 2 + 1
    stretch, stress = (rows[name][:up] for name in (f"lambda_{axis}", f"sigma_{axis}_kPa"))
    eighth = max((up - 1) // 8, 1)
    return float(
        (stress[-1] - stress[-1 - eighth])
        / (stretch[-1] - stretch[-1 - eighth])
        / ((stress[eighth] - stress[0]) / (stretch[eighth] - stretch[0]))
    )


def table(loops: dict[str, dict[str, np.ndarray]]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""
    stiffer = {name: (stiffening(rows, "x"), stiffening(rows, "y")) for name, rows in loops.items()}
    peak = {name: (rows["sigma_x_kPa"].max(), rows["sigma_y_kPa"].max()) for name, rows in loops.items()}
    area = {name: work(rows) for name, rows in loops.items()}
    heat = {name: float(np.ptp(rows["dissipation_kPa"])) for name, rows in loops.items()}
    share = {name: area[name] / area["middle"] for name in ("slow", "fast")}
    return [
        (
            "nonlinear: the tangent at the peak is more than twice that at the start (x and y, three rates)",
            "; ".join(f"{name}: x {x:.1f}, y {y:.1f}" for name, (x, y) in stiffer.items()),
            min(min(pair) for pair in stiffer.values()) > 2.0,
        ),
        (
            "anisotropic: at equal stretch, stress along the mean fibre direction is more than 1.5 times that across it",
            "; ".join(f"{name}: {x:.2f} / {y:.2f} kPa = {x / y:.2f}" for name, (x, y) in peak.items()),
            min(x / y for x, y in peak.values()) > 1.5,
        ),
        (
            f"viscoelastic: the area of the last loop is the heat of its cycle within {100 * TOLERANCE:.0f} % (middle)",
            f"area {area['middle']:.4f} kPa, heat {heat['middle']:.4f} kPa: "
            f"{100 * (area['middle'] / heat['middle'] - 1):+.2f} %",
            area["middle"] > 0.0 and abs(area["middle"] / heat["middle"] - 1.0) < TOLERANCE,
        ),
        (
            "the loop nearly vanishes for cycles a hundred times slower or faster (area below 10 % of the middle one)",
            "; ".join(f"{name}: {area[name]:.4f} kPa, {100 * part:.1f} %" for name, part in share.items()),
            max(share.values()) < 0.1,
        ),
        (
            "faster is stiffer: the peak stress along x rises with the rate",
            ", ".join(f"{name} {x:.2f}" for name, (x, _) in peak.items()) + " kPa",
            peak["slow"][0] < peak["middle"][0] < peak["fast"][0],
        ),
    ]


def draw(loops: dict[str, dict[str, np.ndarray]]) -> Figure:
    """Draw the last loops: both axes at the middle rate, and x at three rates."""
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    middle = loops["middle"]
    up = len(middle["time_s"]) // 2
    for axis, colour, words in (
        ("x", "#0072b2", "along x, the mean fibre direction"),
        ("y", "#cc79a7", "along y, across"),
    ):
        stretch, stress = middle[f"lambda_{axis}"], middle[f"sigma_{axis}_kPa"]
        left.plot(stretch, stress, color=colour, label=words)
        for at in (up // 2, up + up // 2):  # during loading, during unloading
            left.annotate(
                "", (stretch[at + 1], stress[at + 1]), (stretch[at], stress[at]), arrowprops={"arrowstyle": "-|>"}
            )
    left.set_title(f"along both axes, {np.ptp(middle['time_s']):.4g} s per cycle")
    left.set_ylabel("Cauchy stress [kPa]")
    left.set_xlabel(r"stretch $\lambda_x = \lambda_y$ [1]")
    for name, rows in loops.items():
        period = f"{name}: {np.ptp(rows['time_s']):.4g} s per cycle"
        right.plot(rows["lambda_x"], rows["sigma_x_kPa"], color=COLOURS[name], label=period)
    right.set_title("along x, at three rates")
    right.set_ylabel(r"Cauchy stress $\sigma_x$ [kPa]")
    right.set_xlabel(r"stretch $\lambda_x = \lambda_y$ [1]")
    for ax in (left, right):
        ax.grid(alpha=0.3)
        ax.legend()
    return figure


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    loops = measure()
    draw(loops).savefig(HERE / "fig2.png", dpi=110)
    return print_claims(HERE, table(loops))


if __name__ == "__main__":
    sys.exit(main())
