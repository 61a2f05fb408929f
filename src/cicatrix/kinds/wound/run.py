"""A wound that heals by fields, from its case to its folder."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...cases.continuum_laws import network_of
from ...core.units import days_from_hours, hours_from_seconds, seconds_from_hours
from ...files.figures_continuum import fields_figure
from ...files.meshes import read_wound
from ...healing.continuum import Course, course_arrays, course_from, course_scalars
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .body import WoundBody, meshed_wound
from .build import WoundModel, model_of, numbers_of
from .case import WoundCase
from .figures import BREAST, SHEET, course_figure

STEPS_PER_CHECKPOINT = (
    10  # matrices are made anew there, so that a run that goes on has the bits of one that was not stopped
)


@dataclass
class WoundRun:
    """One run; a checkpoint holds the states that a step looks back to."""

    case: WoundCase
    folder: RunFolder
    progress: Progress

    def go(self) -> str:
        """Follow the wound to the end; returns the sentence that ends the run."""
        with self.progress.stage("body"):
            for note in self.model.notes:
                self.folder.note(note)
        with self.progress.stage("heal"):
            course = self._heal()
        with self.progress.stage("outcome"):
            return self._tell(course)

    @cached_property
    def model(self) -> WoundModel:
        """The wound."""
        return model_of(self.case, network_of(self.case.mechanosensing), body_of(self.case))

    def _heal(self) -> Course:
        solver, end = self.model.solver, seconds_from_hours(self.case.hours)
        course = self._kept()
        if course is None:
            course = self.model.start(seconds_from_hours(self.case.solver.first_step_h))
            self._record(course)
            self._picture(0, course)
        number = self._pictures_until(course)
        while course.time < end * (1.0 - 1e-9):
            until = min(seconds_from_hours((number + 1) * self.case.picture_hours), end)
            for reached in solver.follow(course, until):
                course = reached
                self._record(course)
                self.progress.update(course.time / end, f"{days_from_hours(hours_from_seconds(course.time)):.3g} d")
                if course.taken % STEPS_PER_CHECKPOINT == 0:
                    self._save(course)
            number += 1
            self._picture(number, course)
            self._save(course)
        return course

    def _pictures_until(self, course: Course) -> int:
        return int(np.floor(hours_from_seconds(course.time) / self.case.picture_hours + 1e-9))

    @cached_property
    def _first_size(self) -> float:
        return float(self.folder.history()["wound_size"][0])

    def _record(self, course: Course) -> None:
        numbers = numbers_of(self.model, course.now)
        size, sheet = numbers.size, self.case.is_sheet
        first = size if course.taken == 0 else self._first_size
        ratio = "ring_area_ratio" if sheet else "cavity_volume_ratio"
        lam = "lamP_area" if sheet else "lamP_volume"
        held = {
            f"{lam if name == 'lamP' else name}_{where}": value
            for where, values in numbers.at.items()
            for name, value in values.items()
        }
        row: dict[str, Any] = {
            "step": course.taken,
            "time_h": hours_from_seconds(course.time),
            ratio: size / first,
            **held,
            "cells_total": numbers.cells * self.case.values["rho_phys_per_mm3"],
            "step_h": hours_from_seconds(course.last),
            "newton_iterations": course.iterations,
            "wound_size": size,
            "steps_cut": course.rejected,
        }
        self.folder.record(row)

    def _picture(self, number: int, course: Course) -> None:
        """Fields for ParaView."""
        state, transport = course.now, self.model.solver.transport
        space = transport.space
        X, x = (values[transport.carriers] for values in (self.model.body.X, state.x))
        local = state.local
        W = self.model.solver.tissue(state).energy_density(self.model.body.X, state.x)
        at_points = {
            "collagen": local.phi,
            "permanent_stretch": np.prod(local.stretch, axis=-1),
            "signal": self.model.solver.signal(state),
            "strain_energy_density_kPa": W,
        }
        points = {name: transport.at_carriers(values) for name, values in at_points.items()}
        points |= {"cells": state.fields[:, 0], "cytokine": state.fields[:, 1], "displacement": x - X}
        cells = transport.cells if space.n_axes == 3 else _triangles(transport.cells)
        time_days = days_from_hours(hours_from_seconds(course.time))
        self.folder.write_fields("wound", number, time_days, X, cells, points, {})

    def _save(self, course: Course) -> None:
        """Keep what the next steps depend on; matrices are let go, as they are when a run goes on from here."""
        self.model.solver.forget()
        spent = {"factorizations": self.model.solver.factorizations}
        self.folder.save_checkpoint(course.taken, course_arrays(course), course_scalars(course) | spent)

    def _kept(self) -> Course | None:
        kept = self.folder.checkpoint
        if kept is None:
            return None
        self.model.solver.factorizations = kept.scalars["factorizations"]
        return course_from(kept.arrays, kept.scalars)

    def _tell(self, course: Course) -> str:
        history = self.folder.history()
        name = "ring_area_ratio" if self.case.is_sheet else "cavity_volume_ratio"
        ratio, hours = history[name], history["time_h"]
        least = int(ratio.argmin())
        what = "area of the ring" if self.case.is_sheet else "volume of the cavity"
        first = history["wound_size"][0]
        outcome = {
            name: Quantity(float(ratio[-1]), "1", f"{what} at the end over that at first"),
            f"least_{name}": Quantity(float(ratio[least]), "1", "the smallest"),
            "time_of_least_h": Quantity(float(hours[least]), "h", "when it was smallest"),
            "first_size": Quantity(
                float(first), "mm2" if self.case.is_sheet else "mm3", f"{what} at first, under the pull"
            ),
            "steps": Quantity(course.taken, "1"),
            "steps_cut": Quantity(course.rejected, "1", "too long for their error, or without a solution"),
            "iterations": Quantity(int(history["newton_iterations"].sum()), "1"),
            "factorizations": Quantity(self.model.solver.factorizations, "1", "of mechanics"),
            "n_dofs": Quantity(self._n_dofs(), "1", "of positions and fields that are free"),
        }
        for where in ("centre", "edge"):
            for key in [key for key in history if key.endswith(f"_{where}")]:
                outcome[key] = Quantity(float(history[key][-1]), "1", "at the end")
        self.folder.write_outcome(outcome)
        self.folder.save_figure("course", course_figure(history, name))
        view = SHEET if self.case.is_sheet else BREAST._replace(at_mm=self.model.body.middle_mm)
        shown = fields_figure(
            self.model.solver.transport, course.now, course.now.x, days_from_hours(self.case.hours), view
        )
        self.folder.save_figure("fields", shown)
        days = days_from_hours(self.case.hours)
        now, lowest = 100.0 * ratio[-1], 100.0 * ratio[least]
        return f"In {days:.4g} days the {what} came to {now:.3g} % of its first ({lowest:.3g} % at least)."

    def _n_dofs(self) -> int:
        solver = self.model.solver
        supports = solver.body.frame.supports(solver.transport.space.n_axes == 2)
        return supports.n_unknowns + 2 * len(solver.transport.free)


def body_of(case: WoundCase) -> WoundBody | None:
    """Read the body that the case names, if it does."""
    if case.body is None:
        return None
    solid, is_wound = read_wound(case.body.mesh, case.body.mesh_unit)
    return meshed_wound(solid.points, solid.tetrahedra, solid.is_fixed, is_wound)


def _triangles(squares: np.ndarray) -> np.ndarray:
    """Quadrilaterals as pairs of triangles (2 n, 3), for ParaView."""
    return np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
