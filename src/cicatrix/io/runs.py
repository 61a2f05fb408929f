"""A case run from its file to its folder."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from ..coupling.cycle import HealingCycle, TissueState, run
from ..healing.automaton import AutomatonState
from ..image.phantom import phantom
from ..image.segment import Segmentation, from_labels, segment
from ..study.case import LumpectomyCase
from ..study.lumpectomy import Anatomy, Plan, equilibrium_of, healing_cycle, last_cycle, plan, visit_cycles
from ..study.sources import sources_of
from ..study.summary import (
    Number,
    closing_sentence,
    closure_numbers,
    edge_profile,
    history_row,
    outcome_numbers,
    shape_numbers,
    visit_name,
)
from . import figures
from .cases import Case, case_table, input_files
from .images import read_image, read_labels
from .progress import Progress
from .results import Quantity, Results, RunFolder, read_results

FRESH, HEALED = "fresh", "healed"


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
            folder.finish(_Lumpectomy(case, folder, progress).go())
    return read_results(out)


@dataclass
class _Lumpectomy:
    """The stages of one run, in order; everything a checkpoint must hold is in ``shapes``, ``rows`` and the state."""

    case: LumpectomyCase
    folder: RunFolder
    progress: Progress
    shapes: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)  # (position, moment) -> x (n_nodes, 3)
    fronts: list[np.ndarray] = field(default_factory=list)
    rows: list[dict] = field(default_factory=list)

    def go(self) -> str:
        """Run all stages; returns the sentence that ends the run."""
        anatomy = self._anatomy()
        with self.progress.stage("mesh"):
            planned = plan(self.case, anatomy)
            if self.folder.checkpoint is None:
                self.folder.save_figure("section", figures.section_figure(planned, anatomy))
        cycle, state = self._begin(planned)
        state = self._heal(planned, cycle, state)
        with self.progress.stage("outcome"):
            self._finish(planned, cycle, state)
        return closing_sentence(cycle, state)

    def _anatomy(self) -> Anatomy:
        """Read and segment the image; a resumed run reads back what it segmented."""
        image = self.case.image
        with self.progress.stage("image"):
            picture, known = None, None
            if image.phantom is not None:
                picture, _ = phantom(
                    spacing_mm=image.voxel_mm, seed=self.case.run.seed, weighting=image.weighting, side=image.side
                )
            elif image.path is not None:
                picture = read_image(image.path)
            if image.labels is not None:
                known = read_labels(image.labels)
        with self.progress.stage("segment"):
            found = self.folder.load_segmentation(picture)
            if found is None:
                found = from_labels(known) if known is not None else self._segment(picture)
                self.folder.save_segmentation(found.labels, found.probabilities)
                for note in found.notes:
                    self.folder.note(note)
                found = self.folder.load_segmentation(picture) or found
        return found

    def _segment(self, picture) -> Segmentation:
        image = self.case.image
        return segment(
            picture,
            weighting=image.weighting,
            side=image.side,
            position=image.position,
            chest_wall=image.chest_wall,
            resection_centre_mm=self.case.resection.centre_mm,
            report=lambda stage, fraction: self.progress.update(fraction, stage),
        )
