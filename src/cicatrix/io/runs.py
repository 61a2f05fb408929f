"""A case run from its file to its folder."""

from __future__ import annotations

from pathlib import Path

from ..core.errors import InputError
from .cases import Case
from .progress import Progress
from .results import Results


def simulate(
    case: Case, out: str | Path | None = None, resume: bool = False, progress: Progress | None = None
) -> Results:
    """Run a case.

    Parameters
    ----------
    case : LumpectomyCase
        What to run.
    out : str or Path, optional
        The run's folder; without it nothing is kept on disk.
    resume : bool
        Go on from the last checkpoint in ``out``.
    progress : Progress, optional
        Hears of the stages.

    Raises
    ------
    InputError
        Always, until the mechanics and the healing are joined.
    """
    raise InputError(f'a case of kind "{case.kind}" can be checked, but not yet run')
