"""Stretched tissue grows because its cells pull (Guo, Mofrad & Buganza Tepole, Fig. 5): claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import cicatrix
from cicatrix.kinds.registry import load_case
from cicatrix.kinds.tissue_cell.figures import tissue_cell_figure
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
NUMB = "signal.threshold_kPa=1e6"  # cells adhere and pull as in the other runs, but their signal is 0
RESPONSES = {"rho_per_mm3": "cells", "c_g_per_mm3": "cytokine", "m_f": "collagen", "traction_kPa": "contractility"}
History = dict[str, np.ndarray]


def measure(overrides: Sequence[str] = ()) -> dict[str, History]:
    """Return the histories of stretched tissue, with and without mechanosensing, and of unstretched tissue."""
    settings = {"stretched": [], "numb": [NUMB], "at rest": ["loading.stretch=[1.0, 1.0]"]}
    return {
        name: cicatrix.simulate(load_case(HERE / "case.toml", [*overrides, *more])).history
        for name, more in settings.items()
    }


def table(m: dict[str, History]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""
    all_of = m["stretched"]
    elastic, grown = all_of["lambda_s"], all_of["lambda_g"]
    left, back = (elastic[-1] - 1) / (elastic[0] - 1), np.max(elastic - np.minimum.accumulate(elastic))
    half = float(np.interp(0.5 * (grown[-1] - 1), grown[: np.argmax(grown)] - 1, all_of["time_h"][: np.argmax(grown)]))
    swings = {name: _swing(all_of[name][1:]) for name in RESPONSES}  # bonds close within the first row
    numb, rest = m["numb"]["lambda_g"][-1] - 1, np.abs(m["at rest"]["lambda_g"] - 1).max()
    return [
        (
            "the applied stretch is constant; the elastic strain decays to less than a tenth as growth increases",
            f"applied within {np.ptp(all_of['lambda']):.0e}; elastic {elastic[0]:.3f} to {elastic[-1]:.4f} ({100 * left:.1f} % "
            f"left, rises by {back:.1e} at most); grown {grown[-1]:.4f}, half of it by {half:.0f} h",
            bool(np.ptp(all_of["lambda"]) == 0.0 and left < 0.1 and back < 1e-3 and grown[-1] > grown[0]),
        ),
        (
            "cells, cytokine, collagen and contractility respond: each changes by more than 1 % of its largest value",
            ", ".join(f"{words} {100 * swings[name]:.1f} %" for name, words in RESPONSES.items()),
            min(swings.values()) > 0.01,
        ),
        (
            "traction of the cells is the link to stretch: without mechanosensing, tissue grows by less than 1 % of that",
            f"{numb:.1e} against {grown[-1] - 1:.4f}",
            abs(numb) < 0.01 * (grown[-1] - 1),
        ),
        (
            "tissue that is not stretched does not grow",
            f"at most {rest:.1e}",
            bool(rest < 1e-6),
        ),
    ]


def _swing(values: np.ndarray) -> float:
    return float(np.ptp(values) / values.max())


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured = measure()
    tissue_cell_figure(measured["stretched"]).savefig(HERE / "fig5.png", dpi=110)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
