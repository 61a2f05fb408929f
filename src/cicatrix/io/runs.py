"""A case run from its file to its folder."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from ..study.sources import sources_of
from .cases import Case, case_table, input_files
from .progress import Progress
from .results import Results, RunFolder, read_results

RUNS = {"lumpectomy": (".lumpectomy_run", "LumpectomyRun"), "automaton": (".automaton_run", "AutomatonRun")}


def simulate(
    case: Case, out: str | Path | None = None, resume: bool = False, progress: Progress | None = None
) -> Results:
    """Run a case.

    Parameters
    ----------
    case : LumpectomyCase or AutomatonCase
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
    """
    if out is None:
        with tempfile.TemporaryDirectory() as folder:
            return replace(simulate(case, Path(folder) / "run", progress=progress), folder=None)
    progress = progress or Progress()
    with RunFolder.open(
        out,
        case_table(case),
        seed=case.run.seed,
        inputs=input_files(case),
        sources=sources_of(case),
        resume=resume,
        progress=progress,
    ) as folder:
        if not folder.already_finished:
            module, name = RUNS[case.kind]  # a kind loads only what it needs
            run = getattr(import_module(module, __package__), name)(case, folder, progress)
            folder.finish(run.go())
    return read_results(out)
