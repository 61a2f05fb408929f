"""Strain energy along the resection edge before and after surgery (Garbey et al., Fig. 2): claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from cicatrix.core.units import STANDARD_GRAVITY_M_S2, acceleration_mm_s2
from cicatrix.kinds.lumpectomy import figures_section as figures
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.lumpectomy.prepare import loaded_in, prepare
from cicatrix.kinds.lumpectomy.summary import edge_profile
from cicatrix.kinds.registry import load_case
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
ANGLES = (0, 60, 120, 180, 240, 300)  # direction of gravity in the section [degrees]: 0 = left, 90 = posterior
SEEDS = range(1, 6)


def directions() -> dict[str, np.ndarray]:
    """Return gravity (3,) [mm/s^2] by name: six directions in the section, and upright, which is along its normal."""
    g = acceleration_mm_s2(STANDARD_GRAVITY_M_S2)
    turned = {
        f"gravity at {a} degrees": g * np.array([np.cos(np.radians(a)), np.sin(np.radians(a)), 0.0]) for a in ANGLES
    }
    return turned | {"upright": np.array([0.0, 0.0, -g])}


def measure(seeds: Iterable[int] = SEEDS, overrides: Sequence[str] = ()) -> tuple[dict[str, np.ndarray], dict]:
    """Return mean energies along the edge (n_seeds, n_directions), before and after, and the profiles of the first phantom."""
    before, after, spread, pictures = [], [], [], {}
    for seed in seeds:
        case = load_case(HERE / "case.toml", [*overrides, f"run.seed={seed}"])
        model, cycle = prepare(case, anatomy_of(case)[0])
        rows = []
        for name, gravity in directions().items():
            x, x_fresh = loaded_in(model, cycle, gravity)
            before_it = edge_profile(model, model.intact, cycle.X, x)
            profiles = before_it, edge_profile(model, cycle.opened, cycle.X, x_fresh)
            rows.append([profiles[0][1].mean(), profiles[1][1].mean(), profiles[1][1].max() / profiles[1][1].mean()])
            pictures.setdefault(name, profiles)
        a, b, c = np.array(rows).T
        before.append(a)
        after.append(b)
        spread.append(c)
    return {"before": np.array(before), "after": np.array(after), "peak": np.array(spread)}, pictures


def table(m: dict[str, np.ndarray]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""
    ratio = m["after"] / m["before"]
    by_direction = m["after"][:, :6].max(axis=1) / m["after"][:, :6].min(axis=1)
    return [
        (
            "surgery changes the energy along the edge (mean after over before, every direction by more than 20 %)",
            f"{ratio.mean():.2f} +- {ratio.mean(axis=1).std(ddof=1):.2f} (from {ratio.min():.2f} to {ratio.max():.2f})",
            bool((np.abs(ratio - 1) > 0.2).all()),
        ),
        (
            "the direction of gravity changes it (largest over smallest mean of six directions above 1.5, every phantom)",
            f"{by_direction.mean():.2f} +- {by_direction.std(ddof=1):.2f}",
            bool((by_direction > 1.5).all()),
        ),
        (
            "after surgery the energy is uneven along the edge (peak over mean above 1.5 in every direction)",
            f"{m['peak'].mean():.2f} +- {m['peak'].mean(axis=1).std(ddof=1):.2f} (least {m['peak'].min():.2f})",
            bool((m["peak"] > 1.5).all()),
        ),
    ]


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured, pictures = measure()
    figures.edge_figure(pictures).savefig(HERE / "fig2.png", dpi=110)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
