"""Breast shape as the tissue heals (Garbey et al., Fig. 6): prints claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from cicatrix.coupling.cycle import run
from cicatrix.kinds.lumpectomy import figures_section as figures
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.lumpectomy.prepare import prepare, reseeded
from cicatrix.kinds.lumpectomy.visits import last_cycle
from cicatrix.kinds.registry import load_case
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
SEEDS = range(1, 6)
SHOWN = 4  # every fourth cycle is drawn


def measure(seeds: Iterable[int] = SEEDS, overrides: Sequence[str] = ()) -> tuple[dict[str, np.ndarray], tuple]:
    """Return the shape numbers of the fresh and the healed breast, one per seed, and the outlines of the last seed."""
    case = load_case(HERE / "case.toml", overrides)
    model, cycle = prepare(case, anatomy_of(case)[0])
    out: dict[str, list[float]] = {"area": [], "retraction": [], "nipple": [], "fresh": []}
    for seed in seeds:
        healing = reseeded(cycle, seed)
        fresh = state = healing.start()
        named = [("before surgery", cycle.x_intact), ("fresh", fresh.x)]
        for state in run(healing, fresh, last_cycle(case)):
            if state.cycle % SHOWN == 0:
                named.append((f"day {healing.days(state.cycle):.0f}", state.x))
        named.append(("healed" if state.is_closed else "last week", state.x))
        change, first = (model.change(cycle.x_intact, s.x) for s in (state, fresh))
        out["area"].append(change.volume_change_percent)
        out["retraction"].append(change.surface_retraction_max_mm)
        out["nipple"].append(change.nipple_displacement_mm)
        out["fresh"].append(first.surface_retraction_max_mm)
    return {n: np.array(v) for n, v in out.items()}, (model, case.coupling.healing_position, named)


def table(m: dict[str, np.ndarray]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""

    def show(name: str) -> str:
        return f"{m[name].mean():.3f} +- {m[name].std(ddof=1):.3f}"

    return [
        (
            "complete healing leaves the breast smaller (area in the section, every seed)",
            f"{show('area')} %",
            bool((m["area"] < 0).all()),
        ),
        (
            "the skin stays retracted after complete healing (more than 0.1 mm, every seed)",
            f"{show('retraction')} mm healed, {show('fresh')} mm fresh",
            bool((m["retraction"] > 0.1).all()),
        ),
        (
            "the nipple has moved (more than 0.1 mm, every seed)",
            f"{show('nipple')} mm",
            bool((m["nipple"] > 0.1).all()),
        ),
    ]


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured, (model, position, named) = measure()
    figure = figures.outline_figure(model, {position: named}, {position: named[-1][1]})
    figure.savefig(HERE / "fig6.png", dpi=110)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
