"""Wound closure without and with mechanical feedback (Garbey et al., Fig. 5): prints claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from cicatrix.coupling.cycle import HealingCycle, run
from cicatrix.geometry.hexgrid import Lattice
from cicatrix.kinds.lumpectomy import figures_section as figures
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.lumpectomy.prepare import prepare, reseeded
from cicatrix.kinds.lumpectomy.summary import history_row
from cicatrix.kinds.lumpectomy.visits import last_cycle
from cicatrix.kinds.registry import load_case
from cicatrix.outcome import closure
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
SEEDS = range(1, 6)


def heal(cycle: HealingCycle, last: int) -> tuple[list[dict], list[np.ndarray]]:
    """Return the history rows and open sites of a whole run."""
    fresh = cycle.start()
    rows, fronts = [history_row(cycle, fresh)], [cycle.open_sites(fresh)]
    for state in run(cycle, fresh, last):
        rows.append(history_row(cycle, state))
        fronts.append(cycle.open_sites(state))
    return rows, fronts


def at_half(rows: list[dict], name: str) -> float:
    """Interpolate a column of the history linearly to half closure."""
    return float(np.interp(0.5, [r["closed_fraction"] for r in rows], [r[name] for r in rows]))


def nearest_half(rows: list[dict], fronts: list[np.ndarray]) -> np.ndarray:
    """Return the open sites of the cycle nearest to half closure."""
    return fronts[int(np.argmin([abs(r["closed_fraction"] - 0.5) for r in rows]))]


def closed_alone(cycle: HealingCycle) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Run the automaton without feedback; return days, equivalent radius [mm] and open sites after every step."""
    automaton, ruler = cycle.healing.automaton, cycle.ruler
    state = automaton.initial_state()
    fronts = [ruler.open_sites(state.occupancy)]
    while fronts[-1].any():
        state = automaton.advance(state)
        fronts.append(ruler.open_sites(state.occupancy))
    area = np.array([closure.open_size(ruler.lattice, f) for f in fronts])
    return np.arange(len(fronts)) * cycle.healing.days_per_step, np.sqrt(area / np.pi), fronts


def speeds(days: np.ndarray, radius: np.ndarray) -> tuple[float, float]:
    """Return the front speed while the radius is above 3/4 and below 2/5 of the initial radius [mm/day]."""
    early, late = radius > 0.75 * radius[0], (radius < 0.4 * radius[0]) & (radius > 0.1 * radius[0])
    return tuple(float(-np.polyfit(days[part], radius[part], 1)[0]) for part in (early, late))


def relative_roundness(lattice: Lattice, fresh: np.ndarray, half: np.ndarray) -> float:
    """Return the roundness at half closure relative to that of the fresh wound."""
    return closure.roundness(lattice, half) / closure.roundness(lattice, fresh)


def measure(seeds: Iterable[int] = SEEDS, overrides: Sequence[str] = ()) -> tuple[dict[str, np.ndarray], tuple]:
    """Return all numbers, one per seed, and the data for the figure."""
    case = load_case(HERE / "case.toml", overrides)
    anatomy, _ = anatomy_of(case)
    model, cycle = prepare(case, anatomy)
    names = "round early late days_one days_two asym_one asym_two own_one own_two drift_one drift_two"
    out: dict[str, list[float]] = {name: [] for name in names.split()}
    for seed in seeds:
        one = reseeded(cycle, seed, 0.0)
        days, radius, fronts = closed_alone(one)
        centre = closure.wound_centre(fronts[0])
        half = next(f for f in fronts if f.sum() <= 0.5 * fronts[0].sum())
        two_rows, two_fronts = heal(reseeded(cycle, seed), last_cycle(case))
        early, late = speeds(days, radius)
        shift = np.linalg.norm(closure.centroid_shift(one.ruler.lattice, half, fronts[0]))
        values = (
            relative_roundness(one.ruler.lattice, fronts[0], half),
            early,
            late,
            days[-1],
            two_rows[-1]["time_days"],
        )
        values += (closure.asymmetry(half, centre), at_half(two_rows, "wound_asymmetry"))
        values += tuple(
            closure.asymmetry(f, closure.wound_centre(f)) for f in (half, nearest_half(two_rows, two_fronts))
        )
        values += (shift, at_half(two_rows, "wound_drift_mm"))
        for name, value in zip(out, values, strict=True):
            out[name].append(float(value))
    steps = max(1, round(case.coupling.days_per_cycle / cycle.healing.days_per_step))
    return {n: np.array(v) for n, v in out.items()}, (model, cycle, fronts[::steps], two_rows, two_fronts)


def table(m: dict[str, np.ndarray]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""

    def show(name: str) -> str:
        return f"{m[name].mean():.3f} +- {m[name].std(ddof=1) if m[name].size > 1 else 0:.3f}"

    return [
        (
            "without feedback the wound stays roughly circular (roundness at half closure within 10 % of the fresh wound's)",
            show("round"),
            bool((np.abs(m["round"] - 1) < 0.1).all()),
        ),
        (
            "without feedback closure speeds up as the curvature grows (late over early front speed above 1)",
            f"{show('late')} over {show('early')} mm/day",
            bool((m["late"] > m["early"]).all()),
        ),
        (
            "with feedback under gravity the symmetry is lost (asymmetry at half closure, every seed above all without)",
            f"{show('asym_two')} with, {show('asym_one')} without",
            bool(m["asym_two"].min() > m["asym_one"].max()),
        ),
        (
            "so is the symmetry about the wound's own, drifted centre (every seed above all without)",
            f"{show('own_two')} with, {show('own_one')} without",
            bool(m["own_two"].min() > m["own_one"].max()),
        ),
        (
            "with feedback the wound's centre drifts (at half closure, every seed above all without)",
            f"{show('drift_two')} mm with, {show('drift_one')} mm without",
            bool(m["drift_two"].min() > m["drift_one"].max()),
        ),
        (
            "a feedback of mean one closes faster than none",
            f"{show('days_two')} days with, {show('days_one')} without",
            bool(m["days_two"].max() < m["days_one"].min()),
        ),
    ]


def draw(model, cycle, one_fronts, two_rows, two_fronts) -> None:
    """Draw the outlines at the end of each cycle, without and with feedback."""
    lattice, per_step = cycle.ruler.lattice, cycle.healing.days_per_step
    days = max(1, round(cycle.days_per_cycle / per_step)) * per_step
    for name, fronts, title in (("left", one_fronts, "fixed rate"), ("right", two_fronts, "rate depends on energy")):
        rows = two_rows if name == "right" else None
        figure = figures.closure_figure(model, lattice, fronts, rows or _rows(cycle, fronts, days), title)
        figure.savefig(HERE / f"fig5-{name}.png", dpi=110)


def _rows(cycle: HealingCycle, fronts: list[np.ndarray], days: float) -> list[dict]:
    lattice, n0, centre = cycle.ruler.lattice, fronts[0].sum(), closure.wound_centre(fronts[0])
    return [
        {
            "time_days": i * days,
            "closed_fraction": 1 - f.sum() / n0,
            "open_area_mm2": closure.open_size(lattice, f),
            "wound_asymmetry": closure.asymmetry(f, centre),
        }
        for i, f in enumerate(fronts)
    ]


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured, picture = measure()
    draw(*picture)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
