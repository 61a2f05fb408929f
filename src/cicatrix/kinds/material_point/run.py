"""A law without a mesh: one material point integrated through its loading, row by row."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...cases.laws import law_of
from ...core.errors import InputError
from ...core.units import hours_from_seconds
from ...materials.fibres import fibres_within, quadrature_error
from ...materials.material import EnergyMaterial
from ...mechanics.point import Instant, initial_state
from ...mechanics.point_integration import PointProgress, integrate
from ...runs.kind import Context, Drawing, End, Packed, Row, Simulation
from ...runs.quantity import Quantity
from ...runs.trees import packed_tree, unpacked_tree
from .build import control_of, first_of_last_cycle, instants_of, work
from .case import PointCase
from .figures import histories_figure, response_figure

MAX_SHAPES = 16  # number of deformations of a run at which the quadrature of fibres is checked


class PointState(NamedTuple):
    """State of the material point at a row, and the number of steps so far whose error exceeded the tolerance."""

    progress: PointProgress
    n_coarse: int


class MaterialPoint(Simulation[PointState]):
    """Integrates the law of a case of kind "material-point" in steps that adapt to its error."""

    building, marching = "law", "load"

    def __init__(self, case: PointCase, context: Context | None = None) -> None:
        super().__init__(case, context)
        self.law, self.control = law_of(case), control_of(case.loading)
        self.asked: Instant = instants_of(case.loading)

    def start(self) -> PointState:
        """Return the point under its first load."""
        return next(self._walk(None, 0))

    def march(self, state: PointState) -> Iterator[PointState]:
        """Yield the point at every later instant of the loading."""
        return self._walk(state.progress, state.n_coarse)

    def _walk(self, progress: PointProgress | None, n_coarse: int) -> Iterator[PointState]:
        for reached in integrate(self.law, self.control, self.asked, self.case.solver.relative_tolerance, progress):
            n_coarse += reached.n_coarse
            yield PointState(reached, n_coarse)

    def rows(self, state: PointState) -> Iterator[Row]:
        """Return the stretches, stresses and energies of a state as one row of the history."""
        yield _row(state.progress)

    def pack(self, state: PointState) -> Packed:
        """Return the point with the law's history, and the state of the step-size control."""
        progress = state.progress
        scalars = {"row": progress.row, "size": progress.size, "largest": progress.largest, "n_coarse": state.n_coarse}
        return packed_tree(progress.point), scalars

    def unpack(self, arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> PointState:
        """Return the state in a checkpoint, and restore the step-size control."""
        first = Instant(*(column[0] for column in self.asked))
        point = unpacked_tree(initial_state(self.law, first), arrays)
        return PointState(
            PointProgress(point, scalars["row"], scalars["size"], scalars["largest"]), scalars["n_coarse"]
        )

    def done(self, state: PointState) -> tuple[float, str]:
        """Return the fraction of the rows that is computed, and the simulated time."""
        hours = hours_from_seconds(float(state.progress.point.time))
        return state.progress.row / (len(self.asked.time) - 1), f"{hours:.4g} h simulated"

    def outcome(self, end: End[PointState]) -> dict[str, Quantity]:
        """Return final and peak values, work and heat, and the quadrature error of the fibre directions."""
        if end.state.n_coarse:
            self.notes.append(
                f"{end.state.n_coarse} of {_n_steps(end)} steps were the smallest that are tried, and their error was above "
                "solver.relative_tolerance all the same: the loading or the law jumps there."
            )
        return _outcome(self.case, end.history) | _quadrature(self.law, end.history)

    def figures(self, end: End[PointState]) -> Mapping[str, Drawing]:
        """Return the functions that draw stress over stretch, and all quantities over time."""
        grows = any(np.ptp(end.history[name]) > 0.0 for name in ("growth_x", "growth_y"))
        return {
            "response": partial(response_figure, end.history),
            "histories": partial(histories_figure, end.history, grows),
        }

    def sentence(self, end: End[PointState]) -> str:
        """Return a sentence on how far the loading was integrated."""
        return f"The point was simulated over {np.ptp(end.history['time_h']):.6g} h in {_n_steps(end)} steps."


def _n_steps(end: End[PointState]) -> int:
    return int(end.history["n_substeps"].sum())


def _row(progress: PointProgress) -> dict[str, Any]:
    point = progress.point
    stress, stretch = np.asarray(point.stress), np.asarray(point.stretch)
    return {
        "step": progress.row,
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
        "n_substeps": progress.n_substeps,
    }


def _outcome(case: PointCase, history: Mapping[str, np.ndarray]) -> dict[str, Quantity]:
    """Return the outcomes: final and peak values, and the work with its stored and dissipated parts."""
    end = {name: float(values[-1]) for name, values in history.items()}
    volume = history["lambda_x"] * history["lambda_y"] * history["lambda_z"]
    outcome = {f"lambda_{axis}": Quantity(end[f"lambda_{axis}"], "1", "at the end") for axis in "xyz"}
    for axis in "xyz":
        outcome[f"sigma_{axis}_kPa"] = Quantity(end[f"sigma_{axis}_kPa"], "kPa", "Cauchy, at the end")
    for axis in "xyz" if case.loading.thickness in ("strain", "given") else "xy":
        stress = history[f"sigma_{axis}_kPa"]
        peak = int(np.argmax(np.abs(stress)))
        when = f"the largest by size, at {history['time_h'][peak]:.6g} h"
        outcome[f"peak_sigma_{axis}_kPa"] = Quantity(float(stress[peak]), "kPa", when)
    outcome["volume_ratio"] = Quantity(float(volume[-1]), "1", "det F at the end")
    outcome["energy_kPa"] = Quantity(end["energy_kPa"], "kPa", "stored per reference volume at the end")
    outcome["work_kPa"] = Quantity(work(history), "kPa", "done per reference volume, trapezoids over the rows")
    heat = "turned into heat per reference volume"
    if end["dissipation_kPa"] > 0.0:
        heat += "; a sum over the steps without error control: without growth, it should be work_kPa - energy_kPa"
    outcome["dissipation_kPa"] = Quantity(end["dissipation_kPa"], "kPa", heat)
    if case.loading.repeat > 1:
        cycle = work(history, first_of_last_cycle(case))
        outcome["hysteresis_kPa"] = Quantity(
            cycle, "kPa", f"work of cycle {case.loading.repeat}, trapezoids over the rows"
        )
    outcome["n_substeps"] = Quantity(int(history["n_substeps"].sum()), "1", "steps in time")
    return outcome


def _quadrature(law: EnergyMaterial, history: Mapping[str, np.ndarray]) -> dict[str, Quantity]:
    """Return the quadrature error of the sums over fibre directions and waviness; empty without fibres or a finer quadrature."""
    rows = np.unique(np.linspace(0, len(history["step"]) - 1, MAX_SHAPES).astype(int))
    F = np.stack([np.diag([history[f"lambda_{axis}"][row] for axis in "xyz"]) for row in rows])
    try:
        errors = [quadrature_error(fibres, F) for fibres in fibres_within(law)]
    except InputError:
        return {}
    note = "of the fibres' stresses without history at the stretches of the run, over the largest; see n_angles and n_waviness"
    return {"quadrature_error": Quantity(max(errors), "1", note)} if errors else {}
