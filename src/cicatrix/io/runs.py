"""A case run from its file to its folder."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from ..core.errors import InputError
from ..core.ranks import Ranks, world
from ..study.sources import sources_of
from .cases import Case, case_table, input_files
from .progress import Progress
from .results import Results, RunFolder, read_results

RUNS = {
    "lumpectomy": (".lumpectomy_run", "LumpectomyRun"),
    "automaton": (".automaton_run", "AutomatonRun"),
    "equilibrium": (".equilibrium_run", "EquilibriumRun"),
    "material-point": (".point_run", "PointRun"),
    "adhesion": (".adhesion_run", "AdhesionRun"),
    "signalling": (".signalling_run", "SignallingRun"),
    "tissue-cell": (".tissue_cell_run", "TissueCellRun"),
    "wound": (".wound_run", "WoundRun"),
}
FOLLOWERS = {  # what the other ranks of several do
    "automaton": (".automaton_run", "follow"),
    "equilibrium": (".equilibrium_run", "follow"),
}


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
            sources=sources_of(case),
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


def _part(parts: dict[str, tuple[str, str]], case: Case) -> Any:
    """Load what runs a kind, and nothing that another kind needs."""
    module, name = parts[case.kind]
    return getattr(import_module(module, __package__), name)
