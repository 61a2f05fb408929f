"""Compare the automaton and the continuum model on the same cavity: prints claim | measured | holds."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from cicatrix.coupling.cycle import run
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.lumpectomy.build import healing_cycle
from cicatrix.kinds.lumpectomy.prepare import prepare
from cicatrix.kinds.lumpectomy.summary import history_row
from cicatrix.kinds.lumpectomy.visits import last_cycle
from cicatrix.kinds.registry import load_case
from cicatrix.runs.claims import print_claims

HERE = Path(__file__).parent
MRI = {23.0: 1.0, 32.0: 0.60, 39.0: 0.48, 45.0: 0.40}  # day after surgery: volume relative to the first image
AUTOMATON, FIELDS = 'healing.model="automaton"', 'healing.model="fields"'
ONE_WAY = 'coupling.mode="one-way"'
NO_PULL = ["healing.parameters.t_rho_MPa=0.0", "healing.parameters.t_rho_c_MPa=0.0"]
RUNS = {
    "automaton, one-way": [AUTOMATON, ONE_WAY],
    "automaton": [AUTOMATON],
    "automaton, pull of 1 kPa": [AUTOMATON, "healing.contraction_kPa=1.0"],
    "fields, one-way": [FIELDS, ONE_WAY],
    "fields": [FIELDS],
    "fields, no pull": [FIELDS, *NO_PULL],
    "fields, all of the pull": [FIELDS, "healing.parameters.T_0_MPa=0.0"],
}
COLOURS = {"automaton": "#0072b2", "fields": "#d55e00"}
LINES = {"one-way": ":", "no pull": "--", "pull of 1 kPa": "-.", "all of the pull": "-."}


class Healed:
    """Results of one run."""

    def __init__(self, model, cycle, last: int) -> None:
        fresh = cycle.start()
        states = [fresh, *run(cycle, fresh, last)]
        state = states[-1]
        rows = [history_row(cycle, s) for s in states]
        self.days = np.array([row["time_days"] for row in rows])
        self.open = np.array([row["open_area_mm2"] for row in rows])
        self.asymmetry = np.array([row["wound_asymmetry"] for row in rows])
        self.closed = np.array([row["closed_fraction"] for row in rows])
        self.closure = state.closure_days if state.is_closed else np.inf
        changes = [asdict(model.change(cycle.x_intact, s.x)) for s in states]
        self.retraction = np.array([change["surface_retraction_max_mm"] for change in changes])
        self.area = np.array([change["volume_change_percent"] for change in changes])
        self.cavity = np.array([cavity_area(cycle, s.x) for s in states])
        self.fronts = [(s.cycle, cycle.open_sites(s)) for s in states]
        self.lattice = cycle.ruler.lattice.positions()


def cavity_area(cycle, x: np.ndarray) -> float:
    """Return the present area of the elements of the cavity [mm^2]."""
    corners = x[cycle.intact.discretization.space.corners[cycle.cavity.elements]][..., :2]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * float(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum())


def measure(overrides: Sequence[str] = (), names: Sequence[str] = tuple(RUNS)) -> dict[str, Healed]:
    """Run all cases on the same body."""
    case = load_case(HERE / "case.toml", overrides)
    model, ready = prepare(case, anatomy_of(case)[0])
    out = {}
    for name in names:
        own = load_case(HERE / "case.toml", [*overrides, *RUNS[name]])
        cycle = healing_cycle(own, model, ready.X, ready.x_intact, ready.equilibrium)
        out[name] = Healed(model, cycle, last_cycle(own))
    return out


def share(healed: Healed, day: float) -> float:
    """Return the open area on a day relative to day 23."""
    left = np.interp([day, 23.0], healed.days, healed.open)
    return float(left[0] / left[1]) if left[1] > 0 else 0.0


def table(m: dict[str, Healed]) -> list[tuple[str, str, bool]]:
    """Return the rows of the table: claim, measured value, whether it holds."""
    automaton, fields = m["automaton"], m["fields"]
    smallest = {name: 100 * float((h.cavity / h.cavity[0]).min()) for name, h in m.items()}
    images = {name: [share(m[name], day) for day in MRI] for name in ("automaton", "automaton, one-way", "fields")}
    clinic = list(MRI.values())
    half = {name: float(np.interp(0.5, m[name].closed, m[name].asymmetry)) for name in ("automaton", "fields")}
    return [
        (
            "both models close the cavity, and their times to closure differ by less than a factor of two",
            f"automaton {automaton.closure:.0f} d ({m['automaton, one-way'].closure:.0f} one-way); fields {fields.closure:.0f}",
            bool(0.5 < automaton.closure / fields.closure < 2.0),
        ),
        (
            "both fronts stay nearly point-symmetric: asymmetry at half closed below 0.1",
            f"automaton {half['automaton']:.3f}, fields {half['fields']:.3f}",
            max(half.values()) < 0.1,
        ),
        (
            "coupling both ways changes the time to closure by 5 % or more, in both models",
            f"automaton {change(m, 'automaton'):+.1f} %, fields {change(m, 'fields'):+.1f} %",
            min(abs(change(m, model)) for model in ("automaton", "fields")) >= 5,
        ),
        (
            "contraction makes the cavity smaller during healing, by 1 % or more, in both models",
            f"automaton {smallest['automaton, pull of 1 kPa']:.1f} % at its smallest, {smallest['automaton']:.1f} % without; "
            f"fields {smallest['fields']:.1f} % ({smallest['fields, all of the pull']:.1f} % with the full traction), "
            f"{smallest['fields, no pull']:.1f} % without",
            bool(
                smallest["automaton, pull of 1 kPa"] < smallest["automaton"] - 1
                and smallest["fields"] < smallest["fields, no pull"] - 1
            ),
        ),
        (
            "contraction deepens the dent in the skin after 26 weeks, by 0.1 mm or more, in both models",
            f"automaton {m['automaton, pull of 1 kPa'].retraction[-1]:.2f} mm against {automaton.retraction[-1]:.2f}; "
            f"fields {fields.retraction[-1]:.2f} mm ({m['fields, all of the pull'].retraction[-1]:.2f} with the full traction) "
            f"against {m['fields, no pull'].retraction[-1]:.2f}",
            bool(
                m["automaton, pull of 1 kPa"].retraction[-1] > automaton.retraction[-1] + 0.1
                and fields.retraction[-1] > m["fields, no pull"].retraction[-1] + 0.1
            ),
        ),
        (
            "the open area shrinks as in clinical images, within 10 points on days 32, 39 and 45: automaton, two-way",
            told(images["automaton"]),
            near(images["automaton"], clinic),
        ),
        (
            "the same: automaton, one-way",
            told(images["automaton, one-way"]),
            near(images["automaton, one-way"], clinic),
        ),
        ("the same: fields", told(images["fields"]), near(images["fields"], clinic)),
    ]


def change(m: dict[str, Healed], model: str) -> float:
    """Return the relative change of the time to closure from one-way to two-way coupling [%]."""
    return 100.0 * (m[model].closure / m[f"{model}, one-way"].closure - 1.0)


def told(shares: list[float]) -> str:
    """Format fractions next to the clinical ones as text."""
    pairs = zip(MRI, shares, MRI.values())
    return ", ".join(f"day {day:g}: {100 * own:.0f} % against {100 * seen:.0f} %" for day, own, seen in list(pairs)[1:])


def near(one: list[float], other: list[float]) -> bool:
    """Return whether two series differ by less than 10 percentage points."""
    return max(abs(a - b) for a, b in zip(one, other)) < 0.1


def picture(m: dict[str, Healed]) -> Figure:
    """Draw the fronts of both models, and open area, size of the cavity, retraction and asymmetry over time."""
    figure = Figure(figsize=(16, 8.4), layout="constrained")
    axes = figure.subplots(2, 3)
    for ax, name in zip(axes[0], ("automaton", "fields")):
        fronts(ax, m[name], name)
    titles = {
        "open": "open area, relative to the start [1]",
        "cavity": "area of the cavity's elements, relative to the start [1]",
        "retraction": "largest retraction of the skin [mm]",
        "asymmetry": "asymmetry of the open region [1]",
    }
    for ax, (key, title) in zip((axes[0, 2], *axes[1]), titles.items()):
        for name, healed in m.items():
            model, _, kind = name.partition(", ")
            values = getattr(healed, key)
            values = values / values[0] if key in ("open", "cavity") else values
            shown = slice(None) if key != "asymmetry" else healed.open > 0.05 * healed.open[0]
            style = {"color": COLOURS[model], "linestyle": LINES.get(kind, "-"), "label": name}
            ax.plot(healed.days[shown], values[shown], **style)
        ax.set_ylabel(title)
        ax.set_xlabel("time [days]")
        ax.grid(alpha=0.3)
    at_first = np.interp(23.0, m["automaton"].days, m["automaton"].open / m["automaton"].open[0])
    seen = [at_first * value for value in MRI.values()]
    axes[0, 2].plot(list(MRI), seen, "o", color="black", label="clinical images, scaled to the automaton on day 23")
    axes[0, 2].set_xlim(-2, 120)
    axes[0, 2].legend(frameon=False, fontsize=8)
    return figure


def fronts(ax, healed: Healed, name: str) -> None:
    """Draw outlines of the open region, a week apart."""
    last = max(day for day, front in zip(healed.days, healed.fronts) if front[1].any())
    for day, (_, is_open) in zip(healed.days, healed.fronts):
        if is_open.any() and day % 7 == 0:
            colour = colormaps["viridis"](0.9 * day / max(last, 1.0))
            ax.contour(
                healed.lattice[..., 0],
                healed.lattice[..., 1],
                is_open.astype(float),
                [0.5],
                colors=[colour],
                linewidths=1.0,
            )
    ax.set_title(f"{name}: open region every week, to day {last:.0f}")
    ax.set_aspect("equal")
    ax.set_xlabel("left, unloaded [mm]")
    ax.set_ylabel("posterior, unloaded [mm]")
    ax.invert_yaxis()


def main() -> int:
    """Print the table and draw the figure; return 0 if every row agrees with expected.csv."""
    measured = measure()
    picture(measured).savefig(HERE / "automaton-and-fields.png", dpi=110)
    return print_claims(HERE, table(measured))


if __name__ == "__main__":
    sys.exit(main())
