"""Report: a folder of web pages about one run, or comparing several runs, that opens offline."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import ParseError

from matplotlib import colormaps

from ..core.errors import InputError
from ..core.version import __version__
from ..files.atomic import TEMPORARY
from ..files.toml import toml_text
from ..runs.manifest import MANIFEST, flat
from .bodies import Shape, scene, shapes_of
from .checks import checks_of
from .cosmesis import Line, lines_of
from .curves import closing_of, curves_of
from .packing import write_data
from .printed import write_pdf
from .run_view import RunView, read_run_view
from .slices import slices_of
from .writing import copy_assets, write_page

LETTERS = "ABCDEFGH"  # one letter per run in a comparison
MARK = "cicatrix-report.txt"  # file that marks a folder as a report, which a new report may replace
FILES = ("history.csv", "outcome.json", MANIFEST)
MAPS = ("viridis", "cividis", "plasma")  # colour maps that colour-blind readers can read too
# figures of a run that stand in for what a browser without WebGL2 cannot draw, the best first
STILLS = {"body": ("surface", "outline", "shape", "fields", "section"), "slices": ("section",)}
STOPS = 33  # number of colours per map on a page
OnStep = Callable[[str], None]


@dataclass(frozen=True)
class ReportContents:
    """Contents of the report of one run, without its data files."""

    view: RunView
    shapes: list[Shape]
    lines: list[Line]
    missing: tuple[str, ...]
    sections: dict[str, bool]


def write_report(folder: Path, out: Path | None = None, on_step: OnStep = lambda words: None) -> Path:
    """Write the pages of one run.

    Parameters
    ----------
    folder : Path
        Folder of the run, finished or not.
    out : Path, optional
        Folder for the pages (default: ``report`` in the run's folder). An existing report is replaced.
    on_step : callable
        Called with the name of each step.

    Returns
    -------
    Path
        The first page.

    Raises
    ------
    InputError
        If ``folder`` does not hold a run, or ``out`` holds something other than a report.
    """
    view = read_run_view(folder)
    with _replaced(out or folder / "report") as (half, final):
        copy_assets(half / "assets")
        _write_run(half, view, on_step)
    return final / "index.html"


def write_comparison(folders: Sequence[Path], out: Path, on_step: OnStep = lambda words: None) -> Path:
    """Write the pages of several runs and a page that compares them; return the path of that page.

    Raises
    ------
    InputError
        If one of ``folders`` does not hold a run, there are too many, or ``out`` holds something other than a report.
    """
    if len(folders) > len(LETTERS):
        raise InputError(f"{len(folders)} runs are too many to compare; give {len(LETTERS)} at most")
    views = [read_run_view(folder, letter) for folder, letter in zip(folders, LETTERS)]
    with _replaced(out) as (half, final):
        copy_assets(half / "assets")
        contents = []
        for view in views:
            on_step(f"{view.letter}: {view.name}")
            contents.append(_write_run(half / view.letter, view, on_step, assets="../assets", up="../index.html"))
        write_page(half / "index.html", "compare.html", _comparison(contents))
    return final / "index.html"


def _write_run(page: Path, view: RunView, on_step: OnStep, assets: str = "assets", up: str = "") -> ReportContents:
    contents = _write_data(page, view, on_step)
    (page / "figures").mkdir(parents=True, exist_ok=True)
    figures = sorted((view.folder / "figures").glob("*.png"))
    for figure in figures:
        shutil.copyfile(figure, page / "figures" / figure.name)
    for name in _files(view):
        (page / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(view.folder / name, page / name)
    on_step("pages and PDF")
    write_pdf(page / "figures.pdf", view, contents.lines)
    common = {**_common(view, contents), "assets": assets, "up": up, "figures": [f.name for f in figures]}
    write_page(page / "index.html", "patient.html", {**common, "numbers": _numbers(view)})
    write_page(page / "research.html", "research.html", {**common, **_research(view, contents)})
    return contents


def _write_data(page: Path, view: RunView, on_step: OnStep) -> ReportContents:
    """Write the data that the page's scripts draw; report each part that cannot be read in a sentence."""
    missing = list(view.missing)
    on_step("image")
    slices, gaps = slices_of(view)
    missing += gaps
    on_step("bodies")
    shapes: list[Shape] = []
    try:
        shapes = shapes_of(view)
    except (InputError, ParseError) as error:
        missing.append(f"The bodies cannot be read: {error}")
    if not shapes and not any("bodies" in gap for gap in missing) and view.kind == "lumpectomy":
        missing.append("There are no bodies yet (shapes/, fields/), so none are drawn.")
    parts = {
        "slices": slices,
        "body": scene(shapes, view) if shapes else None,
        "closing": closing_of(view),
        "curves": curves_of(view),
    }
    for name, content in parts.items():
        if content is not None:
            write_data(page / "data" / f"{name}.js", view.letter, name, content)
    write_data(page / "data" / "maps.js", view.letter, "maps", map_stops())
    sections = {name: content is not None for name, content in parts.items()}
    return ReportContents(view, shapes, lines_of(view, shapes), tuple(missing), sections)


def stills_of(figures: Path) -> dict[str, str]:
    """Return the name of the picture that stands in for each part of the page; empty where the folder has none for it."""
    found = {
        part: [f"{name}.png" for name in names if (figures / f"{name}.png").is_file()] for part, names in STILLS.items()
    }
    return {part: next(iter(names), "") for part, names in found.items()}


def map_stops() -> dict[str, list[list[float]]]:
    """Return the colours of each map from low to high, as red, green and blue between 0 and 1."""
    return {
        name: [[round(float(c), 4) for c in colormaps[name](k / (STOPS - 1))[:3]] for k in range(STOPS)]
        for name in MAPS
    }


def _common(view: RunView, contents: ReportContents) -> dict[str, Any]:
    state, sentence = view.results.status
    return {
        "version": __version__,
        "letter": view.letter,
        "name": view.name,
        "kind": view.kind,
        "case": view.case,
        "state": state,
        "sentence": sentence,
        "assumption": view.assumption,
        "missing": contents.missing,
        "lines": contents.lines,
        "sections": contents.sections,
        "stills": stills_of(view.folder / "figures"),
        "is_solid": bool(contents.shapes) and contents.shapes[0].is_solid,
        "positions": list(dict.fromkeys(shape.position for shape in contents.shapes)),
    }


def _numbers(view: RunView) -> list[dict[str, Any]]:
    """Return the scalar outcomes with value, unit and note as text."""
    return [
        {"name": name, "value": _as_text(asked.value), "unit": asked.unit, "note": asked.note}
        for name, asked in view.results.outcome.items()
        if asked.value is None or isinstance(asked.value, (int, float, str))
    ]


def _as_text(value: Any) -> str:
    if value is None:
        return "not available"
    return f"{value:.4g}" if isinstance(value, (int, float)) else str(value)


def _research(view: RunView, contents: ReportContents) -> dict[str, Any]:
    manifest = view.manifest
    seconds = [(name, spent["wall"], spent["cpu"]) for name, spent in manifest.get("seconds", {}).items()]
    return {
        "case_text": toml_text(_without_defaults(manifest["case"])),
        "program": manifest["program"],
        "versions": {"python": manifest.get("python", ""), **manifest.get("libraries", {})},
        "platform": manifest.get("platform", ""),
        "seed": manifest.get("seed"),
        "inputs": manifest["inputs"],
        "found": manifest.get("found", {}),
        "seconds": seconds,
        "total": (sum(s[1] for s in seconds), sum(s[2] for s in seconds)),
        "notes": manifest.get("notes", []),
        "sources": manifest.get("sources", {}),
        "checks": checks_of(view, contents.shapes),
        "numbers": _numbers(view),
        "files": _files(view),
    }


def _files(view: RunView) -> list[str]:
    """Return the data files that the report offers for download, relative to the run's folder."""
    tables = sorted(path.relative_to(view.folder).as_posix() for path in view.folder.glob("tables/*.csv"))
    return [*(name for name in FILES if (view.folder / name).is_file()), *tables]


def _without_defaults(case: dict[str, Any]) -> dict[str, Any]:
    """Remove keys without a value and empty tables."""
    said = {key: _without_defaults(v) if isinstance(v, dict) else v for key, v in case.items() if v is not None}
    return {key: value for key, value in said.items() if value != {}}


def _comparison(contents: list[ReportContents]) -> dict[str, Any]:
    names = list(dict.fromkeys(line.name for one in contents for line in one.lines))
    tables = [{line.name: line for line in one.lines} for one in contents]
    return {
        "version": __version__,
        "assets": "assets",
        "runs": [_common(one.view, one) for one in contents],
        "rows": [(name, [table.get(name) for table in tables]) for name in names],
        "differences": _differences([one.view for one in contents]),
        "numbers": _side_by_side([one.view for one in contents]) if not names else [],
    }


def _side_by_side(views: list[RunView]) -> list[tuple[str, str, list[str]]]:
    tables = [{number["name"]: number for number in _numbers(view)} for view in views]
    names = list(dict.fromkeys(name for table in tables for name in table))
    unit = {name: table[name]["unit"] for table in tables for name in table}
    return [(name, unit[name], [table[name]["value"] if name in table else "" for table in tables]) for name in names]


def _differences(views: list[RunView]) -> list[tuple[str, list[str]]]:
    """Return the keys of the case in which runs differ, with the value in each run."""
    tables = [dict(flat(view.case)) for view in views]
    keys = list(dict.fromkeys(key for table in tables for key in table))
    differing = [key for key in keys if len({repr(table.get(key)) for table in tables}) > 1]
    return [(key, [str(table.get(key, "")) for table in tables]) for key in differing]


@contextmanager
def _replaced(out: Path) -> Iterator[tuple[Path, Path]]:
    """Yield a temporary folder for a report, and ``out``.

    On success the temporary folder replaces ``out``; on an error it is deleted and ``out`` is left as it was.
    """
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not (out / MARK).is_file()):
        raise InputError(f"{out} holds something other than a report; give another --out")
    half = out.with_name(TEMPORARY + out.name)
    shutil.rmtree(half, ignore_errors=True)
    try:
        half.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{out} cannot be created: {error.strerror}") from None
    try:
        (half / MARK).write_text(
            f"A report by cicatrix {__version__}; open index.html. Writing the report again replaces this folder.\n"
        )
        yield half, out
        shutil.rmtree(out, ignore_errors=True)
        half.replace(out)
    except BaseException:
        shutil.rmtree(half, ignore_errors=True)
        raise
