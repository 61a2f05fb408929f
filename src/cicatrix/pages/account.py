"""What the folder of a run tells, finished or not; what is missing is said in a sentence, never passed over."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.version import __version__
from ..runs.manifest import MANIFEST, read_manifest
from ..runs.results import Quantity, Results, read_results


@dataclass(frozen=True, eq=False)
class Account:
    """A run as pages show it.

    Parameters
    ----------
    letter : str
        A, B, ... among runs side by side.
    name : str
        Of its folder.
    results : Results
        What could be read.
    missing : tuple of str
        A sentence for each thing that could not.
    """

    letter: str
    name: str
    results: Results
    missing: tuple[str, ...]

    @property
    def folder(self) -> Path:
        """Where it is."""
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

    def asked(self, *keys: str, default: Any = None) -> Any:
        """A key of the case, through its tables; the default where there is none."""
        found: Any = self.case
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        return default if found is None else found

    @property
    def is_closed(self) -> bool:
        """Whether the run tells when its wound closed."""
        closure = self.number("time_to_closure_days")
        return closure is not None and closure.value is not None

    @property
    def is_finished(self) -> bool:
        """Whether the run came to its end."""
        return self.results.status[0] == "finished"

    def number(self, name: str) -> Quantity | None:
        """A number of the outcome, if it is there."""
        return self.results.outcome.get(name)

    def column(self, name: str) -> np.ndarray:
        """A column of the history (n_rows,); empty if there is none."""
        return self.results.history.get(name, np.zeros(0))


def read_account(folder: Path, letter: str = "A") -> Account:
    """Read a run's folder as far as it goes.

    Raises
    ------
    InputError
        If it holds no run.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise InputError(f"{folder} {what}; give the folder of a run, the one with {MANIFEST}")
    manifest = read_manifest(folder)
    if manifest is None:
        raise InputError(f"{folder} holds no run: it has no {MANIFEST}; give a folder that cicatrix run has made")
    results, broken = _readable(folder, manifest)
    missing = [*_version_gap(manifest), *_unfinished(results), *(broken or _gaps(results))]
    return Account(letter, folder.resolve().name, results, tuple(missing))


def _readable(folder: Path, manifest: dict[str, Any]) -> tuple[Results, list[str]]:
    try:
        return read_results(folder), []
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        sentence = f"The numbers cannot be read ({type(error).__name__}): outcome.json or history.csv is damaged."
        return Results({}, {}, manifest, folder), [sentence]


def _version_gap(manifest: dict[str, Any]) -> list[str]:
    made_by = str(manifest["program"].get("version", "0"))
    if _order(made_by) <= _order(__version__):
        return []
    return [f"The run was made by cicatrix {made_by}; this is {__version__}, which may not know all that it holds."]


def _order(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".") if part.isdecimal())


def _unfinished(results: Results) -> list[str]:
    state, sentence = results.status
    return [] if state == "finished" else [f"The run is not finished: {sentence} What follows is as far as it came."]


def _gaps(results: Results) -> list[str]:
    gaps = []
    if not results.history:
        gaps.append("There is no history yet (history.csv), hence no curves.")
    if not results.outcome:
        gaps.append("There are no numbers yet (outcome.json); they come with the end of a run.")
    return gaps
