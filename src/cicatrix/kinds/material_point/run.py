"""A law without a mesh: one point led through its loading, row by row."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from ...cases.laws import law_of
from ...core.errors import ConvergenceError, InputError
from ...core.units import hours_from_seconds
from ...materials.fibres import fibres_within, quadrature_error
from ...materials.material import EnergyMaterial
from ...mechanics.point import Control, Instant, Point, virgin
from ...mechanics.point_walk import Mark, walk
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .build import control_of, first_of_last_cycle, instants_of, work
from .case import PointCase
from .figures import histories_figure, response_figure

CHECKPOINT_SECONDS = 10.0  # between two checkpoints; one more when the run is interrupted
MOST_SHAPES = 16  # of a run, at which the quadrature of fibres is checked


@dataclass
class PointRun:
    """One run; a checkpoint holds the point with the law's history, and how far the steps have adapted."""

    case: PointCase
    folder: RunFolder
    progress: Progress
    n_coarse: int = 0
    saved: float = field(default_factory=time.perf_counter)

    def go(self) -> str:
        """Lead the point through its loading; returns the sentence that ends the run."""
        with self.progress.stage("law"):
            law, control, asked = law_of(self.case), control_of(self.case.loading), instants_of(self.case.loading)
            mark = self._kept(law, asked)
        with self.progress.stage("load"):
            self._load(law, control, asked, mark)
        with self.progress.stage("outcome"):
            return self._tell()

    def _load(self, law: EnergyMaterial, control: Control, asked: Instant, mark: Mark | None) -> None:
        """Write a row per asked instant."""
        last = len(asked.time) - 1
        try:
            for reached in walk(law, control, asked, self.case.solver.relative_tolerance, mark):
                self.folder.record(_row(reached))
                mark = reached
                self.n_coarse += mark.n_coarse
                if time.perf_counter() - self.saved > CHECKPOINT_SECONDS:
                    self._save(mark)
                self.progress.update(mark.row / last, f"{hours_from_seconds(float(mark.point.time)):.4g} h simulated")
        except (KeyboardInterrupt, ConvergenceError):
            if mark is not None:
                self._save(mark)
            raise

    def _save(self, mark: Mark) -> None:
        self.saved = time.perf_counter()
        leaves = jax.tree.leaves(mark.point)
        arrays = {f"leaf_{number}": np.asarray(leaf) for number, leaf in enumerate(leaves)}
        scalars = {"row": mark.row, "size": mark.size, "largest": mark.largest, "n_coarse": self.n_coarse}
        self.folder.save_checkpoint(mark.row, arrays, scalars)

    def _kept(self, law: EnergyMaterial, asked: Instant) -> Mark | None:
        """Where the last checkpoint stands."""
        kept = self.folder.checkpoint
        if kept is None:
            return None
        self.n_coarse = kept.scalars["n_coarse"]
        form = jax.tree.structure(virgin(law, jax.tree.map(lambda column: column[0], asked)))
        leaves = [kept.arrays[f"leaf_{number}"] for number in range(form.num_leaves)]
        point: Point = jax.tree.unflatten(form, leaves)
        return Mark(point, kept.scalars["row"], kept.scalars["size"], kept.scalars["largest"])

    def _tell(self) -> str:
        history = self.folder.history()
        self.folder.write_outcome(_outcome(self.case, history) | _quadrature(law_of(self.case), history))
        grows = any(np.ptp(history[name]) > 0.0 for name in ("growth_x", "growth_y"))
        self.folder.save_figure("response", response_figure(history))
        self.folder.save_figure("histories", histories_figure(history, grows))
        n_steps = int(history["n_substeps"].sum())
        if self.n_coarse:
            self.folder.note(
                f"{self.n_coarse} of {n_steps} steps were the smallest that are tried, and their error was above "
                "solver.relative_tolerance all the same: the loading or the law jumps there."
            )
        return f"The point went through {np.ptp(history['time_h']):.6g} h in {n_steps} steps."


def _row(mark: Mark) -> dict[str, Any]:
    point = mark.point
    stress, stretch = np.asarray(point.stress), np.asarray(point.stretch)
    return {
        "step": mark.row,
        "time_h": hours_from_seconds(float(point.time)),
        **{f"lambda_{axis}": float(value) for axis, value in zip("xyz", stretch)},
        "sigma_x_kPa": float(stress[0, 0]),
        "sigma_y_kPa": float(stress[1, 1]),
        "energy_kPa": float(point.energy),
        "dissipation_kPa": float(point.dissipation),
        "growth_x": float(point.growth[0, 0]),
        "growth_y": float(point.growth[1, 1]),
        "growth_z": float(point.growth[2, 2]),
        "sigma_z_kPa": float(stress[2, 2]),
        "sigma_xy_kPa": float(stress[0, 1]),
        "shear": float(point.shear),
        "n_substeps": mark.n_substeps,
    }


def _outcome(case: PointCase, history: Mapping[str, np.ndarray]) -> dict[str, Quantity]:
    """The numbers asked for: ends, peaks, and what became of the work."""
    end = {name: float(values[-1]) for name, values in history.items()}
    volume = history["lambda_x"] * history["lambda_y"] * history["lambda_z"]
    told = {f"lambda_{axis}": Quantity(end[f"lambda_{axis}"], "1", "at the end") for axis in "xyz"}
    for axis in "xyz":
        told[f"sigma_{axis}_kPa"] = Quantity(end[f"sigma_{axis}_kPa"], "kPa", "Cauchy, at the end")
    for axis in "xyz" if case.loading.thickness in ("strain", "given") else "xy":
        stress = history[f"sigma_{axis}_kPa"]
        peak = int(np.argmax(np.abs(stress)))
        when = f"the largest by size, at {history['time_h'][peak]:.6g} h"
        told[f"peak_sigma_{axis}_kPa"] = Quantity(float(stress[peak]), "kPa", when)
    told["volume_ratio"] = Quantity(float(volume[-1]), "1", "det F at the end")
    told["energy_kPa"] = Quantity(end["energy_kPa"], "kPa", "stored per reference volume at the end")
    told["work_kPa"] = Quantity(work(history), "kPa", "done per reference volume, trapezoids over the rows")
    told["dissipation_kPa"] = Quantity(end["dissipation_kPa"], "kPa", "turned into heat per reference volume")
    if case.loading.repeat > 1:
        cycle = work(history, first_of_last_cycle(case))
        told["hysteresis_kPa"] = Quantity(
            cycle, "kPa", f"work of cycle {case.loading.repeat}, trapezoids over the rows"
        )
    told["n_substeps"] = Quantity(int(history["n_substeps"].sum()), "1", "steps in time")
    return told


def _quadrature(law: EnergyMaterial, history: Mapping[str, np.ndarray]) -> dict[str, Quantity]:
    """What the sums over directions and waviness of fibres leave, if there are fibres that can be resolved further."""
    rows = np.unique(np.linspace(0, len(history["step"]) - 1, MOST_SHAPES).astype(int))
    F = np.stack([np.diag([history[f"lambda_{axis}"][row] for axis in "xyz"]) for row in rows])
    try:
        errors = [quadrature_error(fibres, F) for fibres in fibres_within(law)]
    except InputError:
        return {}
    note = "of the fibres' stresses without history at the stretches of the run, over the largest; see n_angles and n_waviness"
    return {"quadrature_error": Quantity(max(errors), "1", note)} if errors else {}
