"""The report: a folder of pages about one run that opens without a network, and about several side by side."""

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
from .account import Account, read_account
from .bodies import Shape, scene, shapes_of
from .checks import checks_of
from .cosmesis import Line, lines_of
from .curves import closing_of, curves_of
from .packing import write_data
from .printed import write_pdf
from .slices import slices_of
from .writing import copy_assets, write_page

LETTERS = "ABCDEFGH"  # as many runs as fit side by side
MARK = "cicatrix-report.txt"  # tells a folder that a report made, which a new one may replace
FILES = ("history.csv", "outcome.json", MANIFEST)
MAPS = ("viridis", "cividis", "plasma")  # read by the colour-blind as well
STOPS = 33  # colours of a map that a page is given
Told = Callable[[str], None]


@dataclass(frozen=True)
class Contents:
    """What a report says of one run, besides its data files."""

    account: Account
    shapes: list[Shape]
    lines: list[Line]
    missing: tuple[str, ...]
    sections: dict[str, bool]


def write_report(folder: Path, out: Path | None = None, tell: Told = lambda words: None) -> Path:
    """Write the pages of one run.

    Parameters
    ----------
    folder : Path
        Of the run, finished or not.
    out : Path, optional
        Where they go; ``report`` in the run's folder if left out. A report that is there already is replaced.
    tell : callable
        Hears what is being done.

    Returns
    -------
    Path
        The first page.

    Raises
    ------
    InputError
        If ``folder`` holds no run, or ``out`` something else than a report.
    """
    account = read_account(folder)
    with _replaced(out or folder / "report") as (half, final):
        copy_assets(half / "assets")
        _write_run(half, account, tell)
    return final / "index.html"


def write_comparison(folders: Sequence[Path], out: Path, tell: Told = lambda words: None) -> Path:
    """Write the pages of several runs and one that lays them side by side; returns that one.

    Raises
    ------
    InputError
        If one of ``folders`` holds no run, there are too many, or ``out`` holds something else than a report.
    """
    if len(folders) > len(LETTERS):
        raise InputError(f"{len(folders)} runs do not fit side by side; give {len(LETTERS)} at most")
    accounts = [read_account(folder, letter) for folder, letter in zip(folders, LETTERS)]
    with _replaced(out) as (half, final):
        copy_assets(half / "assets")
        contents = []
        for account in accounts:
            tell(f"{account.letter}: {account.name}")
            contents.append(_write_run(half / account.letter, account, tell, assets="../assets", up="../index.html"))
        write_page(half / "index.html", "compare.html", _comparison(contents))
    return final / "index.html"


def _write_run(page: Path, account: Account, tell: Told, assets: str = "assets", up: str = "") -> Contents:
    contents = _write_data(page, account, tell)
    (page / "figures").mkdir(parents=True, exist_ok=True)
    figures = sorted((account.folder / "figures").glob("*.png"))
    for figure in figures:
        shutil.copyfile(figure, page / "figures" / figure.name)
    for name in _files(account):
        (page / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(account.folder / name, page / name)
    tell("pages and PDF")
    write_pdf(page / "figures.pdf", account, contents.lines)
    common = {**_common(account, contents), "assets": assets, "up": up, "figures": [f.name for f in figures]}
    write_page(page / "index.html", "patient.html", {**common, "numbers": _numbers(account)})
    write_page(page / "research.html", "research.html", {**common, **_research(account, contents)})
    return contents


def _write_data(page: Path, account: Account, tell: Told) -> Contents:
    """Write what scripts draw; a part that cannot be read is missing, with its sentence."""
    missing = list(account.missing)
    tell("image")
    slices, gaps = slices_of(account)
    missing += gaps
    tell("bodies")
    shapes: list[Shape] = []
    try:
        shapes = shapes_of(account)
    except (InputError, ParseError) as error:
        missing.append(f"The bodies cannot be read: {error}")
    if not shapes and not any("bodies" in gap for gap in missing) and account.kind == "lumpectomy":
        missing.append("There are no bodies yet (shapes, fields), so none is drawn.")
    parts = {
        "slices": slices,
        "body": scene(shapes, account) if shapes else None,
        "closing": closing_of(account),
        "curves": curves_of(account),
    }
    for name, content in parts.items():
        if content is not None:
            write_data(page / "data" / f"{name}.js", account.letter, name, content)
    write_data(page / "data" / "maps.js", account.letter, "maps", map_stops())
    sections = {name: content is not None for name, content in parts.items()}
    return Contents(account, shapes, lines_of(account, shapes), tuple(missing), sections)


def map_stops() -> dict[str, list[list[float]]]:
    """Colours of each map from low to high, red, green and blue from 0 to 1."""
    return {
        name: [[round(float(c), 4) for c in colormaps[name](k / (STOPS - 1))[:3]] for k in range(STOPS)]
        for name in MAPS
    }


def _common(account: Account, contents: Contents) -> dict[str, Any]:
    state, sentence = account.results.status
    return {
        "version": __version__,
        "letter": account.letter,
        "name": account.name,
        "kind": account.kind,
        "case": account.case,
        "state": state,
        "sentence": sentence,
        "missing": contents.missing,
        "lines": contents.lines,
        "sections": contents.sections,
        "is_solid": bool(contents.shapes) and contents.shapes[0].is_solid,
        "positions": list(dict.fromkeys(shape.position for shape in contents.shapes)),
    }


def _numbers(account: Account) -> list[dict[str, Any]]:
    """Single numbers of the outcome, for the page of a run that is no lumpectomy."""
    return [
        {"name": name, "value": _told(asked.value), "unit": asked.unit, "note": asked.note}
        for name, asked in account.results.outcome.items()
        if asked.value is None or isinstance(asked.value, (int, float, str))
    ]


def _told(value: Any) -> str:
    if value is None:
        return "not available"
    return f"{value:.4g}" if isinstance(value, (int, float)) else str(value)


def _research(account: Account, contents: Contents) -> dict[str, Any]:
    manifest = account.manifest
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
        "checks": checks_of(account, contents.shapes),
        "numbers": _numbers(account),
        "files": _files(account),
    }


def _files(account: Account) -> list[str]:
    """What the figures are drawn from, relative to the run's folder."""
    tables = sorted(path.relative_to(account.folder).as_posix() for path in account.folder.glob("tables/*.csv"))
    return [*(name for name in FILES if (account.folder / name).is_file()), *tables]


def _without_defaults(case: dict[str, Any]) -> dict[str, Any]:
    """Tables without what is not said."""
    said = {key: _without_defaults(v) if isinstance(v, dict) else v for key, v in case.items() if v is not None}
    return {key: value for key, value in said.items() if value != {}}


def _comparison(contents: list[Contents]) -> dict[str, Any]:
    names = list(dict.fromkeys(line.name for one in contents for line in one.lines))
    tables = [{line.name: line for line in one.lines} for one in contents]
    return {
        "version": __version__,
        "assets": "assets",
        "runs": [_common(one.account, one) for one in contents],
        "rows": [(name, [table.get(name) for table in tables]) for name in names],
        "differences": _differences([one.account for one in contents]),
        "numbers": _side_by_side([one.account for one in contents]) if not names else [],
    }


def _side_by_side(accounts: list[Account]) -> list[tuple[str, str, list[str]]]:
    tables = [{number["name"]: number for number in _numbers(account)} for account in accounts]
    names = list(dict.fromkeys(name for table in tables for name in table))
    unit = {name: table[name]["unit"] for table in tables for name in table}
    return [(name, unit[name], [table[name]["value"] if name in table else "" for table in tables]) for name in names]


def _differences(accounts: list[Account]) -> list[tuple[str, list[str]]]:
    """Keys of the case in which runs differ, and what each says."""
    tables = [dict(flat(account.case)) for account in accounts]
    keys = list(dict.fromkeys(key for table in tables for key in table))
    differing = [key for key in keys if len({repr(table.get(key)) for table in tables}) > 1]
    return [(key, [str(table.get(key, "")) for table in tables]) for key in differing]


@contextmanager
def _replaced(out: Path) -> Iterator[tuple[Path, Path]]:
    """A folder to write a report to; on success it takes the place of ``out``, on an error nothing is left of it."""
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not (out / MARK).is_file()):
        raise InputError(f"{out} holds something else than a report; give another --out")
    half = out.with_name(TEMPORARY + out.name)
    shutil.rmtree(half, ignore_errors=True)
    try:
        half.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{out} cannot be made: {error.strerror}") from None
    try:
        (half / MARK).write_text(
            f"A report by cicatrix {__version__}; open index.html. A new report replaces this folder.\n"
        )
        yield half, out
        shutil.rmtree(out, ignore_errors=True)
        half.replace(out)
    except BaseException:
        shutil.rmtree(half, ignore_errors=True)
        raise
