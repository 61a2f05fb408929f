"""Measure where daughters appear when only the left half of the layer divides: prints claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from cicatrix.geometry.hexgrid import Lattice
from cicatrix.healing.automaton import Automaton
from cicatrix.healing.cue import Cue
from cicatrix.healing.rules import AutomatonRules
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
SEEDS = range(1, 6)
SUBSTEPS = (4, 6, 8)
VARIANTS = ("level-set", "route")
LATTICE = Lattice((310, 310), 0.01, (0.0, 0.0))
X = LATTICE.positions() - LATTICE.position(np.array([154.5, 154.5]))
WOUND = (X**2).sum(axis=-1) < 1.0  # a disc with a radius of 100 sites


def automaton(variant: str, n_substeps: int, p_layer: float, seed: int) -> Automaton:
    """Return the automaton of the disc with division in the layer only."""
    rules = AutomatonRules(
        p_edge=0.0,
        p_layer=p_layer,
        layer_sites=8,
        motility_substeps=n_substeps,
        redistribution=variant,
        feedback=1.0,
    )
    return Automaton(LATTICE, np.ones_like(WOUND), WOUND, rules, seed)


def change(variant: str, n_substeps: int, seed: int, p_layer: float = 0.1) -> tuple[np.ndarray, int]:
    """Return the effect of division in one step per site (+1 gained, -1 lost, 0) and the number of daughters.

    The step is compared with the same step without division.
    """
    quiet = automaton(variant, n_substeps, 0.0, seed)
    settled = quiet.advance(quiet.initial_state(), n_steps=3)
    left_only = Cue(np.where(X[..., 0] < 0, 0.0, -1.0), 1.0)  # F = -1 on the right: p = 0 there
    with_division = automaton(variant, n_substeps, p_layer, seed).advance(settled, left_only)
    without = quiet.advance(settled)
    gained = with_division.occupancy.astype(int) - without.occupancy.astype(int)
    return gained, with_division.n_layer_divisions


def measure(seeds: Iterable[int] = SEEDS) -> dict[str, np.ndarray]:
    """Return the fraction of daughters that appear on the right, (seeds, sub-steps) for each variant."""
    shares = {name: [] for name in VARIANTS}
    for seed in seeds:
        for name in VARIANTS:
            found = [change(name, n, seed) for n in SUBSTEPS]
            shares[name].append([gained[X[..., 0] > 0].sum() / n_new for gained, n_new in found])
    return {name: np.array(values) for name, values in shares.items()}


def table(m: dict[str, np.ndarray]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""

    def show(name: str) -> str:
        means = ", ".join(f"{100 * share:.1f} % ({n} sub-steps)" for n, share in zip(SUBSTEPS, m[name].mean(axis=0)))
        return f"{means}; from {100 * m[name].min():.1f} to {100 * m[name].max():.1f} %"

    return [
        (
            "one level set for the whole wound places 35 to 60 % of the daughters of its left half on the right side",
            show("level-set"),
            bool((m["level-set"] > 0.35).all() and (m["level-set"] < 0.6).all()),
        ),
        ("with paths, at most 2 % appear there", show("route"), bool((np.abs(m["route"]) < 0.02).all())),
    ]


def draw() -> None:
    """Draw the sites that gained or lost a cell by division, for both variants."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 5), layout="constrained", sharey=True)
    for ax, name in zip(axes, VARIANTS):
        gained, n_new = change(name, 8, 1)
        for value, colour, words in ((1, "#d62728", "gained"), (-1, "#0072b2", "lost")):
            at = X[gained == value]
            if not len(at):
                continue
            ax.scatter(at[:, 0], at[:, 1], s=3, color=colour, label=f"{words}: {len(at)} sites")
        ax.axvspan(-1.25, 0, color="#f0e442", alpha=0.15, linewidth=0)
        ax.add_patch(plt.Circle((0, 0), 1.0, fill=False, color="#888888", linewidth=0.6))
        right = gained[X[..., 0] > 0].sum() / n_new
        ax.set_title(f'redistribution = "{name}": {100 * right:.0f} % on the right')
        ax.set_aspect("equal")
        ax.set_xlim(-1.25, 1.25)
        ax.set_ylim(-1.25, 1.25)
        ax.set_xlabel("x [mm]")
        ax.legend(loc="center", fontsize=8)
    axes[0].set_ylabel("y [mm]")
    figure.savefig(HERE / "daughters.png", dpi=110)


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    draw()
    return print_claims(HERE, table(measure()))


if __name__ == "__main__":
    sys.exit(main())
