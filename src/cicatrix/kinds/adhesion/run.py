"""A cell on a substrate: its bonds followed row by row."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...biology.adhesion import Adhesion
from ...core.errors import ConvergenceError
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .bonds import Bonds, Follower, Sampled, follower_of
from .build import law_and_notes
from .case import AdhesionCase
from .figures import course_figure, stretch_figure
from .summary import mean_course, summary

CHECKPOINT_SECONDS = 10.0  # between two checkpoints; one more when the run is interrupted


@dataclass
class AdhesionRun:
    """One run; a checkpoint holds the bonds and the row they belong to."""

    case: AdhesionCase
    folder: RunFolder
    progress: Progress
    saved: float = field(default_factory=time.perf_counter)

    def go(self) -> str:
        """Follow the bonds to the end; returns the sentence that ends the run."""
        with self.progress.stage("law"):
            law, notes = law_and_notes(self.case)
            for note in notes:
                self.folder.note(note)
        follower = follower_of(self.case, law)
        with self.progress.stage("bind"):
            self._follow(law, follower)
        with self.progress.stage("outcome"):
            return self._tell(law, follower)

    def _follow(self, law: Adhesion, follower: Follower) -> None:
        """Write the rows of every time, one per stretch."""
        kept, last = self.folder.checkpoint, len(follower.times) - 1
        if kept is None:
            row, bound = 0, follower.start()
            self._record(law, follower, row, bound)
        else:
            row, bound = kept.cycle, kept.arrays["bound"]
        try:
            while row < last:
                further = follower.onward(bound, row + 1)
                self._record(law, follower, row + 1, further)
                row, bound = row + 1, further
                if time.perf_counter() - self.saved > CHECKPOINT_SECONDS:
                    self._save(row, bound)
                self.progress.update(row / last, f"{follower.times[row]:.4g} s of {follower.times[-1]:.4g} s simulated")
        except (KeyboardInterrupt, ConvergenceError):
            self._save(row, bound)
            raise

    def _save(self, row: int, bound: np.ndarray) -> None:
        self.saved = time.perf_counter()
        self.folder.save_checkpoint(row, {"bound": bound})

    def _record(self, law: Adhesion, follower: Follower, row: int, bound: np.ndarray) -> None:
        stretch = np.array(self.case.substrate.stretch)
        told = follower.told(bound, row)
        for cells in _rows(row, follower.times[row], stretch, told, np.asarray(law.traction(told.force, told.mean))):
            self.folder.record(cells)

    def _tell(self, law: Adhesion, follower: Follower) -> str:
        history = self.folder.history()
        numbers = summary(self.case, law, history)
        self.folder.write_outcome({name: Quantity(*told) for name, told in numbers.items()})
        mean = mean_course(self.case, law) if isinstance(follower, Sampled) else None
        self.folder.save_figure("course", course_figure(history, mean))
        if len(self.case.substrate.stretch) > 1:
            self.folder.save_figure("stretch", stretch_figure({name: told[0] for name, told in numbers.items()}))
        words = {"ode": "The mean of the bonds", "monte-carlo": "Single bonds", "ssa": "Single bonds, at exact times,"}
        return f"{words[self.case.method.type]} went through {follower.times[-1]:.6g} s."


def _rows(row: int, at: float, stretch: np.ndarray, told: Bonds, traction: np.ndarray) -> list[Mapping[str, Any]]:
    return [
        {
            "step": row,
            "time_s": float(at),
            "stretch": float(stretch[i]),
            "bound_fraction": float(told.mean[i]),
            "bound_fraction_sd": float(told.sd[i]),
            "force_pN": float(told.force[i]),
            "traction_kPa": float(traction[i]),
            **{name: float(values[i]) for name, values in told.others.items()},
        }
        for i in range(len(stretch))
    ]
