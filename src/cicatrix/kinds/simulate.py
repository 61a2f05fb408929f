"""A case run from its file to its folder."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from ..cases.reading import case_table, input_files
from ..cases.table import Case
from ..core.errors import InputError
from ..core.ranks import Ranks, world
from ..runs.progress import Progress
from ..runs.results import Results, RunFolder, read_results

RUNS = {
    "lumpectomy": "LumpectomyRun",
    "automaton": "AutomatonRun",
    "equilibrium": "EquilibriumRun",
    "material-point": "PointRun",
    "adhesion": "AdhesionRun",
    "signalling": "SignallingRun",
    "tissue-cell": "TissueCellRun",
    "wound": "WoundRun",
}
FOLLOWERS = {"automaton": "follow", "equilibrium": "follow"}  # what the other ranks of several do


def simulate(
    case: Case, out: str | Path | None = None, resume: bool = False, progress: Progress | None = None
) -> Results:
    """Run a case.

    Parameters
    ----------
    case : LumpectomyCase, AutomatonCase, EquilibriumCase, PointCase, AdhesionCase, SignallingCase, TissueCellCase or WoundCase
        What to run.
    out : str or Path, optional
        The run's folder; without it nothing is kept on disk.
    resume : bool
        Go on from the last checkpoint in ``out``: to the same bytes as a run that was never stopped.
    progress : Progress, optional
        Hears of the stages.

    Raises
    ------
    InputError
        If the case, an image or the folder is at fault.
    ConvergenceError
        If no equilibrium is found; the last good state is kept in ``out``.

    Notes
    -----
    Where ``mpiexec`` started several ranks all of them call this alike: the first one writes, and all get the results.
    """
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            return replace(simulate(case, Path(folder) / "run", progress=progress), folder=None)
    ranks, progress = world(), progress or Progress()
    if ranks.size > 1 and case.kind not in FOLLOWERS:
        raise InputError(f'kind = "{case.kind}" runs in one process: start it without mpiexec')

    def opened() -> RunFolder:
        return RunFolder.open(
            out,
            case_table(case),
            seed=case.seed,
            inputs=input_files(case),
            sources=case.sources(),
            resume=resume,
            progress=progress,
        )

    with ranks.uninterrupted():
        folder = ranks.agree(lambda: opened() if ranks.is_first else None)
        results: Any = ranks.agree(lambda: _lead(case, folder, progress, ranks) if folder else _follow(case, ranks))
        return ranks.share(results)


def _lead(case: Case, folder: RunFolder, progress: Progress, ranks: Ranks) -> Results:
    with folder:
        if ranks.share(not folder.already_finished):
            run = _part(RUNS, case)(case, folder, progress)
            folder.finish(run.go())
    return read_results(folder.path)


def _follow(case: Case, ranks: Ranks) -> None:
    if ranks.share(True):
        _part(FOLLOWERS, case)(case, ranks)


def _part(parts: dict[str, str], case: Case) -> Any:
    """Load what runs a kind, and nothing that another kind needs."""
    return getattr(import_module(f".{case.kind.replace('-', '_')}.run", __package__), parts[case.kind])
