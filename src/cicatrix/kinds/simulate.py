"""Run a case and write its folder, or build its simulation so that the caller can step it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ..cases.reading import case_table, input_files
from ..cases.table import Case
from ..core.errors import InputError
from ..core.ranks import world
from ..runs.driver import drive
from ..runs.kind import Simulation
from ..runs.progress import Progress
from ..runs.results import Results, RunFolder, open_run
from ..runs.scratch import ScratchFolder
from .registry import case_from, load_case, simulation_type

CaseLike = Case | str | Path | Mapping[str, Any]


def simulate(
    case: CaseLike, out: str | Path | None = None, resume: bool = False, progress: Progress | None = None
) -> Results:
    """Run a case.

    Parameters
    ----------
    case : Case, str, Path or mapping
        What to run: a case, the path of a case file, or nested tables as a case file holds them; paths in such tables
        are relative to the working folder.
    out : str or Path, optional
        The run's folder; without it a temporary one, which is removed with the results.
    resume : bool
        Continue from the last checkpoint in ``out``; the results are bitwise those of an uninterrupted run.
    progress : Progress, optional
        Receives the progress of the stages.

    Raises
    ------
    InputError
        If the case, an image or the folder is at fault.
    ConvergenceError
        If no equilibrium is found; the last good state is kept in ``out``.
    StorageError
        If the disk is full or reports an error; ``resume`` goes on once there is room.

    Notes
    -----
    Under ``mpiexec`` all ranks must call this function with the same arguments; the first one writes, and all return the results.
    """
    case = as_case(case)
    if out is None:
        scratch = ScratchFolder()
        results = simulate(case, scratch.path / "run", progress=progress)
        return replace(results, _scratch=scratch) if world().is_first else replace(results, folder=None)
    ranks, progress, kind = world(), progress or Progress(), simulation_type(case.kind).of(case)
    if ranks.size > 1 and not kind.on_ranks:
        raise InputError(f'this case of kind = "{case.kind}" runs in one process: start it without mpiexec')

    def opened() -> RunFolder:
        inputs, sources = input_files(case), case.sources()
        return RunFolder.open(
            out, case_table(case), seed=case.seed, inputs=inputs, sources=sources, resume=resume, progress=progress
        )

    def led(folder: RunFolder) -> Results:
        with folder:
            if ranks.share(not folder.already_finished):
                drive(kind, case, folder, progress, ranks)
        return open_run(folder.path)

    def followed() -> None:
        if ranks.share(True):  # decided by the first rank
            drive(kind, case, None, Progress(), ranks)

    with ranks.uninterrupted():
        folder = ranks.agree(lambda: opened() if ranks.is_first else None)
        results: Any = ranks.agree(partial(led, folder) if folder else followed)
        return ranks.share(results)


def build(case: CaseLike) -> Simulation:
    """Build the simulation that ``simulate`` would integrate, so that the caller can step it.

    Parameters
    ----------
    case : Case, str, Path or mapping
        As for :func:`simulate`.

    Raises
    ------
    InputError
        If the case or its files are at fault.

    Examples
    --------
    >>> simulation = cicatrix.build("case.toml")
    >>> for state in simulation.march(simulation.start()):
    ...     print(simulation.rows(state))
    """
    case = as_case(case)
    return simulation_type(case.kind).of(case)(case)


def as_case(case: CaseLike) -> Any:
    """Return a case: as given, read from a file, or checked from nested tables."""
    if isinstance(case, Case):
        return case
    if not isinstance(case, (str, Path, Mapping)):
        raise TypeError(f"a case, the path of a case file or nested tables are needed; got {type(case).__name__}")
    return case_from(case) if isinstance(case, Mapping) else load_case(case)
