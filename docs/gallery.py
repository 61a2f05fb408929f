"""The page of the laws that case files may name, docs/laws.md and docs/laws.png: from the laws themselves and their examples.

`python docs/gallery.py` writes both; a test fails where the page is not that of the laws.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

from cicatrix.cases.laws import GROWTHS, LAWS, key_of, law_of
from cicatrix.core.units import inner_per_typed
from cicatrix.kinds.material_point.case import PointCase
from cicatrix.kinds.registry import load_case
from cicatrix.materials.constituent import Constituent
from cicatrix.materials.fibres import ORIENTATIONS, WAVINESSES, FibreViscosity
from cicatrix.materials.mixture import FORMS
from cicatrix.materials.viscoelastic import Viscoelastic
from cicatrix.mechanics.point import Control, control, history
from cicatrix.mechanics.point_walk import instants

DOCS = Path(__file__).parent
EXAMPLES = DOCS.parent / "examples" / "laws"
TOP, SHEAR = 1.3, 0.5  # stretch, and shear, at the top
N_STEPS = 40  # up, and again down
QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}  # each is compiled for one run
LOADINGS = {"along x": "#0072b2", "along x and y": "#d55e00", "shear": "#009e73"}
PARTS = {
    "Orientations": ORIENTATIONS,
    "Waviness": WAVINESSES,
    "Viscous branches along fibres": {"viscous": FibreViscosity},
    "Constituents": {"constituent": Constituent},
    "Memory of a mixture": FORMS,
    "Growth": GROWTHS,
}
TEXT = """# Laws that a case file may name

Written by `docs/gallery.py` from the laws themselves and from [examples/laws](../examples/laws); a change goes there. Each table
`[[law]]` has a `type`, several add up. A key that has a default may be left out.

![Stress of every law](laws.png)

Cauchy stress of the examples, stretched to 1.3 (along x alone and free along y; along x and y: the stress along x) or sheared by
0.5 between x and y (no stretch along x and y, the shear stress), up and down again in the time of the example. All but two keep
their volume; the thickness is free. Laws with a history come back another way.
"""


def examples() -> dict[str, PointCase]:
    """Name of a file in examples/laws -> its case, in the order of the laws."""
    order = list(LAWS)
    cases = {path.stem: load_case(path) for path in EXAMPLES.glob("*.toml")}
    return dict(sorted(cases.items(), key=lambda item: (order.index(item[1].law[0].type), len(item[0]), item[0])))


def response(case: PointCase) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Loading, stretch less 1 or shear (2 N_STEPS + 1,) [1], Cauchy stress (2 N_STEPS + 1,) [kPa]."""
    law, keeps_volume = law_of(case), case.loading.thickness == "incompressible"
    seconds = 3600.0 * (case.loading.time_h[-1] - case.loading.time_h[0])
    times = [0.0, 0.5 * seconds, seconds]
    led = jax.jit(history, compiler_options=QUICK)
    for name in LOADINGS:
        y = "stress" if name == "along x" else "stretch"
        by: Control = control(y=y, incompressible=keeps_volume)
        high = {"along x": (TOP, 0.0, 0.0), "along x and y": (TOP, TOP, 0.0), "shear": (1.0, 1.0, 0.0)}[name]
        low = (1.0, 0.0 if y == "stress" else 1.0, 0.0)
        shear = SHEAR if name == "shear" else 0.0
        points = led(law, by, instants(times, np.array([low, high, low]), [0.0, shear, 0.0], N_STEPS))
        if not points.converged.all():
            raise RuntimeError(f"no state of {case.law[0].type}, {name}")
        if name == "shear":
            yield name, np.asarray(points.shear), np.asarray(points.stress)[:, 0, 1]
        else:
            yield name, np.asarray(points.stretch)[:, 0] - 1.0, np.asarray(points.stress)[:, 0, 0]


def picture(cases: dict[str, PointCase]) -> Figure:
    """A panel for each example."""
    columns = 4
    rows = -(-len(cases) // columns)
    figure = Figure(figsize=(3.3 * columns, 2.7 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for ax in panels[len(cases) :]:
        ax.remove()
    for number, (ax, (name, case)) in enumerate(zip(panels, cases.items(), strict=False)):
        for loading, x, stress in response(case):
            ax.plot(x, stress, color=LOADINGS[loading], label=loading)
        ax.set_title(name, fontsize=10)
        ax.grid(alpha=0.3)
        if number % columns == 0:
            ax.set_ylabel("Cauchy stress [kPa]")
        if number + columns >= len(cases):
            ax.tick_params(labelbottom=True)
            ax.set_xlabel("stretch - 1, or shear [1]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def page() -> str:
    """The text of docs/laws.md."""
    named: dict[str, list[str]] = {}
    for stem, case in examples().items():
        named.setdefault(case.law[0].type, []).append(f"[{stem}](../examples/laws/{stem}.toml)")
    parts = [TEXT]
    for name, law in LAWS.items():
        parts.append(f"## `{name}`\n\n{_prose(law)}\n{_keys(law)}\nExamples: {', '.join(named[name])}.\n")
    branches = "`viscous = { beta = [0.5], relaxation_s = [10.0] }` in `neo-hookean`, `mooney-rivlin` and `ogden`."
    parts.append(f"## Viscous branches of isotropic laws\n\n{branches} {_prose(Viscoelastic)}")
    for title, types in PARTS.items():
        parts.append(f"## {title}\n")
        parts += [f"### `{name}`\n\n{_prose(law)}\n{_keys(law)}" for name, law in types.items()]
    return "\n".join(parts)


def _prose(law: type) -> str:
    """What a law's docstring says before its parameters, in Markdown."""
    text = inspect.cleandoc(law.__doc__ or "").partition("\nParameters\n")[0].partition("\nRaises\n")[0]
    text = re.sub(r"\.\. math::(.+?)(?=\n\n|\Z)", _block, text, flags=re.S)
    text = re.sub(r":math:`(.+?)`", lambda m: f"$`{' '.join(m[1].split())}`$", text, flags=re.S)
    text = re.sub(r":(?:class|mod|func):`([^`]+)`", lambda m: f"`{m[1].rpartition('.')[2]}`", text)
    return re.sub(r"``(.+?)``", r"`\1`", text).rstrip() + "\n"


def _block(found: re.Match) -> str:
    lines = [line.strip() for line in found[1].strip().splitlines()]
    return "```math\n" + "\n".join(lines) + "\n```"


def _keys(law: type) -> str:
    """A table of the keys, their meaning, range and default."""
    meanings = _meanings(law)
    rows = [_row(field, meanings.get(field.name, "")) for field in dataclasses.fields(law) if field.init]
    return "| key | what | range | default |\n|---|---|---|---|\n" + "".join(rows) if rows else ""


def _row(field: dataclasses.Field, meaning: str) -> str:
    low_high = "" if field.type in ("int", int) or "symbol" in field.metadata else "a table"
    if "symbol" in field.metadata:
        per = inner_per_typed(field.metadata["typed"], field.metadata["unit"])
        low, high = field.metadata["low"] / per, field.metadata["high"] / per
        low_high = _range(low, high, "above" if field.metadata["is_open"] else "from")
    elif "types" in field.metadata:
        low_high = "a table of type " + ", ".join(f"`{name}`" for name in field.metadata["types"])
    default = "" if field.default is dataclasses.MISSING else _shown(field)
    return f"| `{key_of(field)}` | {meaning} | {low_high} | {default} |\n"


def _range(low: float, high: float, least: str) -> str:
    if np.isfinite(low) and np.isfinite(high):
        return f"{low:.4g} to {high:.4g}"
    return f"{least} {low:.4g}" if np.isfinite(low) else f"to {high:.4g}" if np.isfinite(high) else "any"


def _shown(field: dataclasses.Field) -> str:
    """A default as it would be typed."""
    if field.default is None:
        return "left out"
    if isinstance(field.default, (int, float)) and "symbol" in field.metadata:
        return f"{field.default / inner_per_typed(field.metadata['typed'], field.metadata['unit']):g}"
    names = {made: name for name, made in field.metadata.get("types", {}).items()}
    return f"`{names[type(field.default)]}`" if type(field.default) in names else str(field.default)


def _meanings(law: type) -> dict[str, str]:
    """Field -> what the docstrings of the law and of those before it say of it."""
    found: dict[str, str] = {}
    for one in reversed(law.__mro__):
        _, _, text = inspect.cleandoc(one.__doc__ or "").partition("\nParameters\n----------\n")
        text = text.partition("\nRaises\n")[0]
        for names, words in re.findall(r"^(\S[^:\n]*) : [^\n]*\n((?:[ ]+[^\n]*\n?)+)", text, flags=re.M):
            joined = " ".join(textwrap.dedent(words).split())
            joined = re.sub(r":math:`(.+?)`", r"$`\1`$", joined).replace("|", r"\|")
            found |= {name.strip(): re.sub(r"``(.+?)``", r"`\1`", joined) for name in names.split(",")}
    return found


def main() -> int:
    """Write the page and its picture."""
    (DOCS / "laws.md").write_text(page(), encoding="utf-8")
    picture(examples()).savefig(DOCS / "laws.png", dpi=100)
    return 0


if __name__ == "__main__":
    sys.exit(main())
