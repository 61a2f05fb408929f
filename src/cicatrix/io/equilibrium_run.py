"""Mechanics alone: the shape of a body under its loads, or the shape it has without."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.errors import InputError
from ..core.newton import NewtonReport
from ..core.units import acceleration_mm_s2, ml_from_mm3
from ..mechanics.body import Body
from ..mechanics.equilibrium import Equilibrium
from ..study.equilibrium import moved, solid_body
from ..study.equilibrium_case import EquilibriumCase
from .figures_equilibrium import shape_figure
from .meshes import MeshedBody, read_body
from .progress import Progress
from .results import Quantity, RunFolder

LIKELY_MM = (2.0, 1000.0)  # the largest extent of what surgeons cut


@dataclass
class EquilibriumRun:
    """One run: read, solve, tell."""

    case: EquilibriumCase
    folder: RunFolder
    progress: Progress

    def go(self) -> str:
        """Find the shape; returns the sentence that ends the run."""
        with self.progress.stage("mesh"):
            given = read_body(self.case.body.mesh, self.case.body.mesh_unit)
            body = self._body(given)
        with self.progress.stage("solve"):
            found, report, solver = self._solve(given, body)
        with self.progress.stage("outcome"):
            self._tell(given, body, found, report, solver)
        sought = "unloaded" if self.case.solver.inverse else "loaded"
        return f"The {sought} shape was found in {report.iterations} Newton iterations."

    def _body(self, given: MeshedBody) -> Body:
        pressure = self.case.loads.pressure_kPa
        body = solid_body(
            given.points,
            given.tetrahedra,
            given.is_fixed,
            given.E,
            given.nu,
            given.density,
            is_sliding=given.is_sliding,
            is_pressurised=given.is_pressurised,
            pressure=pressure,
        )
        name = self.case.body.mesh.name
        if pressure and body.pressure is None:
            raise InputError(
                f"{name}: loads.pressure_kPa = {pressure:g} acts on no face: mark the corners of some boundary faces by point "
                "data `pressurised` = 1"
            )
        if self.case.solver.inverse and given.displacement.any():
            raise InputError(f"{name}: point data `prescribed_displacement` must be 0 where solver.inverse = true")
        return body

    def _solve(self, given: MeshedBody, body: Body) -> tuple[np.ndarray, NewtonReport, Equilibrium]:
        solver = Equilibrium(self.case.solver.relative_tolerance, lambda words: self.progress.update(None, words))
        gravity = acceleration_mm_s2(np.array(self.case.loads.gravity_m_s2))
        X = body.frame.space.positions
        if self.case.solver.inverse:
            found, report = solver.unloaded(body, X, gravity)
        else:
            held_at = moved(body, given.displacement) if given.displacement.any() else None
            found, report = solver.loaded(body, X, gravity, held_at=held_at)
        for line in report.history:
            self.folder.note(line)
        return found, report, solver

    def _tell(
        self, given: MeshedBody, body: Body, found: np.ndarray, report: NewtonReport, solver: Equilibrium
    ) -> None:
        start = body.frame.space.positions
        X, x = (found, start) if self.case.solver.inverse else (start, found)
        shift = (found - start)[: len(given.points)]
        energy = body.energy_density(X, x)
        for number, norm in enumerate(report.norms, 1):
            self.folder.record({"iteration": number, "residual_mN": norm})
        self.folder.write_fields(
            "body",
            0,
            0.0,
            given.points,
            given.tetrahedra,
            {"displacement": shift, "fixed": given.is_fixed},
            {
                "strain_energy_density_kPa": energy.mean(axis=1),
                "volume_ratio": body.dilation(X, x)[:, 0],
                "youngs_modulus_kPa": given.E,
            },
        )
        volume = body.volumes(start)
        self.folder.write_outcome(
            {
                "max_displacement_mm": Quantity(np.linalg.norm(shift, axis=1).max(), "mm"),
                "strain_energy_uJ": Quantity(body.strain_energy(X, x), "uJ"),
                "newton_iterations": Quantity(report.iterations, "1"),
                "load_steps": Quantity(report.load_steps, "1"),
                "factorizations": Quantity(solver.factorizations, "1"),
                "n_dofs": Quantity(body.frame.supports(False).n_unknowns, "1", "degrees of freedom that are free"),
                "volume_ml": Quantity(ml_from_mm3(volume.sum()), "ml", "as given"),
                "mass_g": Quantity(1e3 * float(np.sum(body.density * body.volumes(X))), "g"),
                "largest_extent_mm": _extent(given.points),
            }
        )
        self.folder.save_figure("shape", shape_figure(body.frame.space, start, found, self.case.solver.inverse))


def _extent(points: np.ndarray) -> Quantity:
    largest = float(np.ptp(points, axis=0).max())
    doubt = "" if LIKELY_MM[0] <= largest <= LIKELY_MM[1] else "is body.mesh_unit right?"
    return Quantity(largest, "mm", doubt)
