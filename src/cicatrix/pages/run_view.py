"""Read the folder of a run, finished or not, for the pages; every missing part is reported in a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.version import __version__
from ..runs.manifest import MANIFEST, read_manifest
from ..runs.quantity import Quantity
from ..runs.results import Results, open_run

ASSUMPTION = (
    'By default (healing.deposition = "unloaded") new tissue is assumed to restore the unloaded shape from before surgery. '
    "The closed wound therefore keeps the volume of the hole by assumption, apart from any contraction of the scar, "
    "and the healed shape is not a prediction of the cosmetic result."
)


@dataclass(frozen=True, eq=False)
class RunView:
    """Contents of a run's folder, as the pages show them.

    Parameters
    ----------
    letter : str
        Letter of the run in a comparison: A, B, ...
    name : str
        Name of the run's folder.
    results : Results
        History, outcome and manifest, as far as they could be read.
    missing : tuple of str
        One sentence for each part that could not be read.
    """

    letter: str
    name: str
    results: Results
    missing: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        assert self.results.folder is not None
        return self.results.folder

    @property
    def manifest(self) -> dict[str, Any]:
        """The case as run, versions, seed, hashes, seconds per stage, notes."""
        return self.results.manifest

    @property
    def case(self) -> dict[str, Any]:
        """The case as run."""
        return self.manifest["case"]

    @property
    def kind(self) -> str:
        """Kind of the case."""
        return str(self.case.get("kind", "unknown"))

    def case_value(self, *keys: str, default: Any = None) -> Any:
        """Return a value of the case by the names of its nested tables and its key; the default if it is missing."""
        found: Any = self.case
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        return default if found is None else found

    @property
    def assumption(self) -> str:
        """Sentence on the assumptions behind the healed shape; empty if it does not apply."""
        return assumption_of(self.case)

    @property
    def is_closed(self) -> bool:
        """Whether the outcome has a time to closure."""
        closure = self.number("time_to_closure_days")
        return closure is not None and closure.value is not None

    @property
    def is_finished(self) -> bool:
        """Whether the run is finished."""
        return self.results.status[0] == "finished"

    def number(self, name: str) -> Quantity | None:
        """Return a quantity of the outcome; None if it is missing."""
        return self.results.outcome.get(name)

    def column(self, name: str) -> np.ndarray:
        """Return a column of the history (n_rows,); empty if it is missing."""
        return self.results.history.get(name, np.zeros(0))


def assumption_of(case: Mapping[str, Any]) -> str:
    """Return the sentence on the assumptions behind the healed shape of a lumpectomy; empty where it does not apply."""
    healing = case.get("healing")
    deposition = healing.get("deposition", "unloaded") if isinstance(healing, Mapping) else "unloaded"
    return ASSUMPTION if case.get("kind") == "lumpectomy" and deposition == "unloaded" else ""


def read_run_view(folder: Path, letter: str = "A") -> RunView:
    """Read all readable parts of a run's folder.

    Raises
    ------
    InputError
        If the folder does not hold a run.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise InputError(f"{folder} {what}; give the folder of a run (it contains {MANIFEST})")
    manifest = read_manifest(folder)
    if manifest is None:
        raise InputError(f"{folder} holds no run: it has no {MANIFEST}; give a folder written by cicatrix run")
    results, broken = _readable(folder, manifest)
    missing = [*_version_gap(manifest), *_unfinished(results), *(broken or _gaps(results))]
    return RunView(letter, folder.resolve().name, results, tuple(missing))


def _readable(folder: Path, manifest: dict[str, Any]) -> tuple[Results, list[str]]:
    try:
        return open_run(folder), []
    except InputError:
        sentence = "The numbers cannot be read: outcome.json or history.csv is damaged."
        return Results({}, {}, manifest, folder), [sentence]


def _version_gap(manifest: dict[str, Any]) -> list[str]:
    made_by = str(manifest["program"].get("version", "0"))
    if _order(made_by) <= _order(__version__):
        return []
    return [
        f"The run was made by cicatrix {made_by}; this is version {__version__}, which may not know all of its contents."
    ]


def _order(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".") if part.isdecimal())


def _unfinished(results: Results) -> list[str]:
    state, sentence = results.status
    return [] if state == "finished" else [f"The run is not finished: {sentence} This page shows the results so far."]


def _gaps(results: Results) -> list[str]:
    gaps = []
    if not results.history:
        gaps.append("There is no history yet (history.csv), so no curves are drawn.")
    if not results.outcome and results.status[0] == "finished":
        gaps.append(
            "There are no numbers yet (outcome.json), though it is finished; cicatrix run --resume writes them."
        )
    elif not results.outcome:
        gaps.append("There are no numbers yet (outcome.json); they are written when a run ends.")
    return gaps
