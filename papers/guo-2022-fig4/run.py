"""Bonds of a cell on a stiffening substrate with feedback (Guo, Mofrad & Buganza Tepole, Fig. 4): claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

import cicatrix
from cicatrix.biology.adhesion import Adhesion, steady_state
from cicatrix.biology.contraction import ConstantForce
from cicatrix.kinds.adhesion.build import law_and_notes
from cicatrix.kinds.adhesion.case import AdhesionCase
from cicatrix.kinds.adhesion.summary import mean_course
from cicatrix.kinds.registry import load_case
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
FEEDBACK, HELD = "#0072b2", "#d55e00"
COLLAGEN = (
    "{type='exponential-fibre', k1_MPa=0.0703966587326, k2=20.81811370546901, area_um2=0.017, length_um=0.1, "
    "stretch=[1.0, 1.1]}"
)


def curves(law: Adhesion, stretch: np.ndarray) -> dict[str, np.ndarray]:
    """Return stiffness [pN/um], force [pN], bound fraction [1] and traction [kPa] in the steady state at stretches (n,)."""
    at = steady_state(law, stretch)
    names = {"k": at.stiffness, "force": at.force, "bound": at.steady, "traction": at.traction}
    return {"stretch": stretch} | {name: np.asarray(values) for name, values in names.items()}


def held(law: Adhesion, force: float) -> Adhesion:
    """Return the same cell with a constant force [pN]."""
    return eqx.tree_at(lambda a: a.contraction, law, ConstantForce(force))


def measure(overrides: Sequence[str] = ()) -> dict[str, dict[str, np.ndarray]]:
    """Return steady states with feedback, with constant force and on collagen, and Monte Carlo samples with the ODE solution."""
    case = load_case(HERE / "case.toml", overrides)
    assert isinstance(case, AdhesionCase)
    law, _ = law_and_notes(case)
    given = case.substrate.stretch
    stretch = np.linspace(min(given), max(given), 41)
    feedback = curves(law, stretch)
    fibre, _ = law_and_notes(load_case(HERE / "case.toml", [*overrides, "law=[]", f"substrate={COLLAGEN}"]))
    history = cicatrix.simulate(case).history
    times, mean = mean_course(case, law)
    n_bonds = np.array(case.method.n_integrins * case.n_cells)
    sampled = {"time": times, "mean": mean, "n": n_bonds, "stretch": np.array(given)}
    return {
        "feedback": feedback,
        "held": curves(held(law, float(feedback["force"][len(stretch) // 2])), stretch),
        "collagen": curves(fibre, np.linspace(1.0, 1.1, 41)),
        "sampled": sampled | {"bound": history["bound_fraction"].reshape(len(times), -1)},
    }


def spread(values: np.ndarray) -> float:
    """Return the range of values relative to their mean [1]."""
    return float(np.ptp(values) / values.mean())


def table(m: dict[str, dict[str, np.ndarray]]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""
    feedback, fixed, fibre, sampled = (m[name] for name in ("feedback", "held", "collagen", "sampled"))
    t, k = feedback["traction"], feedback["k"]
    share = np.diff(np.log(t)) / np.diff(np.log(k))
    sigma = np.sqrt(sampled["mean"] * (1 - sampled["mean"]) / sampled["n"])
    away = np.abs(sampled["bound"] - sampled["mean"])[1:] / sigma[1:]
    stiff = fibre["k"][-1] / fibre["k"][0]
    return [
        (
            "under feedback the bond fraction is nearly independent of stretch: it changes by less than 10 %",
            f"{feedback['bound'].min():.4f} to {feedback['bound'].max():.4f}, {100 * spread(feedback['bound']):.1f} %",
            spread(feedback["bound"]) < 0.1,
        ),
        (
            "regulation of the force keeps it constant: with the fixed force of the middle stretch it changes more than five "
            "times as much",
            f"{fixed['bound'].min():.4f} to {fixed['bound'].max():.4f}, {100 * spread(fixed['bound']):.1f} %, at "
            f"{fixed['force'][0]:.2f} pN",
            spread(fixed["bound"]) > 5.0 * spread(feedback["bound"]),
        ),
        (
            "traction increases with the tangent stiffness of the substrate, by more than half",
            f"{t[0]:.4f} to {t.max():.4f} kPa (x {t.max() / t[0]:.2f}) while k_eff goes from {k[0]:.0f} to {k.max():.0f} pN/um "
            f"(x {k.max() / k[0]:.2f}); d ln t / d ln k {share.min():.2f} to {share.max():.2f}",
            bool(t.max() > 1.5 * t[0] and (share > 0.0).all()),
        ),
        (
            "the mean of the Monte Carlo samples agrees with the solution of the ODE (4 sigma, at all times and stretches)",
            f"{away.max():.2f} sigma at most, {np.sqrt((away**2).mean()):.2f} root mean square, {away.size} points, "
            f"{sampled['n']} bonds each",
            bool(away.max() < 4.0),
        ),
        (
            "the same on the collagen fibre of this group's tables: fraction within 10 %, traction up by more than half",
            f"{fibre['bound'][0]:.4f} to {fibre['bound'][-1]:.4f}, {100 * spread(fibre['bound']):.1f} %; traction x "
            f"{fibre['traction'][-1] / fibre['traction'][0]:.3f}, force x {fibre['force'][-1] / fibre['force'][0]:.3f}, "
            f"k_eff x {stiff:.0f} from {fibre['k'][0]:.3g} pN/um",
            bool(spread(fibre["bound"]) < 0.1 and fibre["traction"][-1] > 1.5 * fibre["traction"][0]),
        ),
    ]


def draw(m: dict[str, dict[str, np.ndarray]]) -> Figure:
    """Draw samples over time, and stiffness, bound fraction, force and traction over stretch."""
    figure = Figure(figsize=(14, 7.2), layout="constrained")
    axes = figure.subplots(2, 3)
    sampled, times = m["sampled"], axes[0, 0]
    n = sampled["mean"].shape[1]
    for i in range(n):
        colour = colormaps["viridis"](0.9 * i / max(n - 1, 1))
        label = f"stretch {sampled['stretch'][i]:g}"
        times.plot(sampled["time"], sampled["bound"][:, i], color=colour, label=label)
        times.plot(sampled["time"], sampled["mean"][:, i], "k--", linewidth=0.9, label="ODE" if i == n - 1 else None)
    times.set_xlabel("time [s]")
    times.set_ylabel("bound fraction [1]")
    times.legend(fontsize=8)
    times.grid(alpha=0.3)
    panels = (
        (axes[0, 1], "k", "tangent stiffness $k_{eff}$ [pN/um]"),
        (axes[0, 2], "force", "force of a bond [pN]"),
        (axes[1, 0], "bound", "bound fraction [1]"),
        (axes[1, 1], "traction", "traction [kPa]"),
    )
    for ax, name, words in panels:
        ax.plot(m["feedback"]["stretch"], m["feedback"][name], color=FEEDBACK, label="feedback")
        if name != "k":
            ax.plot(m["held"]["stretch"], m["held"][name], color=HELD, linestyle="--", label="constant force")
            ax.legend(fontsize=8)
        _dress(ax, "stretch [1]", words)
    both = axes[1, 2]
    both.plot(m["feedback"]["k"], m["feedback"]["traction"], color=FEEDBACK)
    _dress(both, "tangent stiffness $k_{eff}$ [pN/um]", "traction under feedback [kPa]")
    return figure


def _dress(ax, x: str, y: str) -> None:
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.set_ylim(0.0, 1.05 * ax.get_ylim()[1])
    ax.grid(alpha=0.3)


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured = measure()
    draw(measured).savefig(HERE / "fig4.png", dpi=110)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
