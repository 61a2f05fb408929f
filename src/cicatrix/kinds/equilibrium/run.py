"""Mechanics alone: the shape of a body under its loads, or the shape it has without; by one process or by several ranks.

The first rank has the run's folder; the others solve with it, each with elements of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from ...cases.laws import law_of
from ...core.errors import ConvergenceError, InputError
from ...core.ranks import Ranks, world
from ...core.units import acceleration_mm_s2, ml_from_mm3
from ...files.meshes import MeshedBody, read_body
from ...materials.neo_hookean import young_from_moduli
from ...mechanics.body import Body, local_volumes
from ...mechanics.division import layout_of, shared
from ...mechanics.equilibrium import Equilibrium
from ...mechanics.solids import solid_body
from ...numerics.krylov import PetscEngine
from ...numerics.newton import NewtonReport
from ...numerics.petsc import petsc
from ...runs.progress import Progress
from ...runs.results import Quantity, RunFolder
from .build import moved
from .case import EquilibriumCase
from .figures import shape_figure
from .history import March

LIKELY_MM = (2.0, 1000.0)  # the largest extent of what surgeons cut


@dataclass
class EquilibriumRun:
    """One run: read, solve, tell."""

    case: EquilibriumCase
    folder: RunFolder
    progress: Progress
    ranks: Ranks = field(default_factory=world)

    def go(self) -> str:
        """Find the shape; returns the sentence that ends the run."""
        with self.progress.stage("mesh"):
            given, body = _given(self.case, self.ranks)
            if doubt := _doubt(given.points):
                self.folder.note(doubt)
                self.progress.update(1.0, doubt)
        if self.case.history is not None:
            return March(self.case, self.folder, self.progress, given, body).go()
        with self.progress.stage("solve"):
            found, report, solver = self._solve(given, body)
            for line in [*_how(self.case, self.ranks), *report.history]:
                self.folder.note(line)
        with self.progress.stage("outcome"):
            self._tell(given, body, found, report, solver)
        sought = "unloaded" if self.case.solver.inverse else "loaded"
        doubt = "" if report.is_stable else " The given shape is not a stable equilibrium of it."
        return f"The {sought} shape was found in {report.iterations} Newton iterations.{doubt}"

    def _solve(self, given: MeshedBody, body: Body) -> tuple[np.ndarray, NewtonReport, Equilibrium]:
        try:
            return _find(self.case, given, body, self.ranks, lambda words: self.progress.update(None, words))
        except ConvergenceError as error:
            raise ConvergenceError(f"{error} {_doubt(given.points)}".rstrip(), error.history) from error

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
                "volume_ratio": body.dilation(X, x).mean(axis=1),
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


def follow(case: EquilibriumCase, ranks: Ranks) -> None:
    """Solve with the first rank, which leads the run."""
    given, body = _given(case, ranks)
    _find(case, given, body, ranks, lambda words: None)


def _given(case: EquilibriumCase, ranks: Ranks) -> tuple[MeshedBody, Body]:
    """The mesh, which the first rank reads, and the body that it is of."""
    if _on_petsc(case, ranks):
        ranks.agree(lambda: petsc().communicator(ranks))  # where that fails nothing else need be done
    mesh = case.body.mesh, case.body.mesh_unit, _elastic(case)
    given: Any = ranks.share(ranks.agree(lambda: read_body(*mesh) if ranks.is_first else None))
    return given, ranks.agree(lambda: _body(case, given, _on_petsc(case, ranks)))


def _elastic(case: EquilibriumCase) -> tuple[float, float] | None:
    """Young's modulus [kPa] and Poisson's ratio of the case's law at rest, if it has one."""
    if not case.law:
        return None
    E, nu = young_from_moduli(*jax.jit(lambda law: law.moduli_at_rest())(law_of(case)))
    return float(E), min(float(nu), 0.4999)


def _body(case: EquilibriumCase, given: MeshedBody, is_shared: bool) -> Body:
    pressure, name = case.loads.pressure_kPa, case.body.mesh.name
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
    if case.law:
        body = replace(body, law=law_of(case))
    space = body.frame.space
    folded = np.flatnonzero((local_volumes(space, space.positions) <= 0.0).any(axis=1))
    if folded.size:
        raise InputError(
            f"{name}: {folded.size} tetrahedra are folded by their middle nodes, the first is number {folded[0]}: these must lie "
            "near the middles of the edges"
        )
    if pressure and body.pressure is None:
        raise InputError(
            f"{name}: loads.pressure_kPa = {pressure:g} acts on no face: mark the corners of some boundary faces by point "
            "data `pressurised` = 1"
        )
    if case.solver.inverse and given.displacement.any():
        raise InputError(f"{name}: point data `prescribed_displacement` must be 0 where solver.inverse = true")
    if is_shared and case.history is not None:
        raise InputError('history is for one process: start it without mpiexec, with solver.linear = "direct"')
    if is_shared and (body.frame.sliding_nodes.size or body.frame.skin_facets.size):
        raise InputError(
            f"{name}: sliding walls and pressure are for one process: start it without mpiexec, with solver.linear = "
            '"direct"'
        )
    return body


def _find(
    case: EquilibriumCase, given: MeshedBody, body: Body, ranks: Ranks, tell: Callable[[str], None]
) -> tuple[np.ndarray, NewtonReport, Equilibrium]:
    """Solve, all ranks together; each gets the whole shape (n_nodes, 3) [mm]."""

    def heard(words: str) -> None:
        tell(words)
        if ranks.share(ranks.is_interrupted):
            raise KeyboardInterrupt

    held_at, on = moved(body, given.displacement) if given.displacement.any() else None, None
    if _on_petsc(case, ranks):
        body = shared(body, ranks)
        on = PetscEngine(layout_of(body.frame), "gamg" if case.solver.linear == "gamg" else "mumps")
    solver = Equilibrium(case.solver.relative_tolerance, heard, on)
    X, gravity = body.frame.space.positions, acceleration_mm_s2(np.array(case.loads.gravity_m_s2))
    with ranks.all_or_none():
        if case.solver.inverse:
            found, report = solver.unloaded(body, X, gravity)
        else:
            found, report = solver.loaded(body, X, gravity, held_at=held_at)
    return found, report, solver


def _on_petsc(case: EquilibriumCase, ranks: Ranks) -> bool:
    return ranks.size > 1 or case.solver.linear != "direct"


def _how(case: EquilibriumCase, ranks: Ranks) -> list[str]:
    if not _on_petsc(case, ranks):
        return []
    method = "GAMG" if case.solver.linear == "gamg" else "MUMPS"
    return [f"PETSc's {method} solved the linear systems on {ranks.size} rank{'s' * (ranks.size > 1)}."]


def _extent(points: np.ndarray) -> Quantity:
    largest = float(np.ptp(points, axis=0).max())
    doubt = "" if LIKELY_MM[0] <= largest <= LIKELY_MM[1] else "is body.mesh_unit right?"
    return Quantity(largest, "mm", doubt)


def _doubt(points: np.ndarray) -> str:
    """What there is to say of an unlikely extent; empty where it is likely."""
    extent = _extent(points)
    return f"The mesh is {extent.value:g} mm across: {extent.note}" if extent.note else ""
