"""Build the body and the loads of a case of kind "equilibrium"."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import jax
import numpy as np

from ...cases.laws import law_of
from ...core.errors import InputError
from ...core.ranks import Ranks
from ...core.units import seconds_from_hours
from ...files.mesh_doubts import doubts_of
from ...files.meshes import MeshedBody
from ...geometry.tetrahedra import EDGES, far_origin
from ...materials.neo_hookean import young_from_moduli
from ...mechanics.body import Body, local_volumes
from ...mechanics.solids import solid_body
from ...numerics.petsc import petsc
from .case import EquilibriumCase, HistoryTable
from .mesh import given_body


def displaced_positions(body: Body, displacement: np.ndarray) -> np.ndarray:
    """Return prescribed positions of all nodes: displacement (n, 3) [mm] of the given nodes -> (n_nodes, 3) [mm].

    The added midpoint of an edge lies halfway between the prescribed positions of both ends.
    """
    space = body.discretization.space
    prescribed_positions = space.positions.copy()
    prescribed_positions[: len(displacement)] += displacement
    one, other = np.array(EDGES).T
    middles = space.element_nodes[:, 4:]
    added = middles >= len(displacement)
    corners = space.element_nodes[:, :4]
    prescribed_positions[middles[added]] = (
        0.5 * (prescribed_positions[corners[:, one]] + prescribed_positions[corners[:, other]])[added]
    )
    return prescribed_positions


def load_steps(history: HistoryTable) -> np.ndarray:
    """Return times [s] and load factors [1] of a load history (n, 2), with equal steps in each segment."""
    corners = np.stack([seconds_from_hours(np.array(history.time_h)), np.array(history.share)], axis=1)
    k = np.arange(1, history.steps_per_segment + 1)[:, None] / history.steps_per_segment
    return np.vstack([corners[:1], *(a + k * (b - a) for a, b in pairwise(corners))])


def given_and_body(case: EquilibriumCase, ranks: Ranks) -> tuple[MeshedBody, Body]:
    """Return the mesh of a case, which only the first rank reads from its file, and the body built from it."""
    if on_petsc(case, ranks):
        ranks.agree(lambda: petsc().communicator(ranks))  # if PETSc is missing, fail before reading the mesh
    given: Any = ranks.share(ranks.agree(lambda: given_body(case, _elastic(case)) if ranks.is_first else None))
    return given, ranks.agree(lambda: _body(case, given, on_petsc(case, ranks)))


def _elastic(case: EquilibriumCase) -> tuple[float, float] | None:
    """Return Young's modulus [kPa] and Poisson's ratio of the case's law at small strain; None if the case has no law."""
    if not case.law:
        return None
    E, nu = young_from_moduli(*jax.jit(lambda law: law.moduli_at_rest())(law_of(case)))
    return float(E), min(float(nu), 0.4999)


def _body(case: EquilibriumCase, given: MeshedBody, is_shared: bool) -> Body:
    pressure, name = case.loads.pressure_kPa, case.body.mesh.name
    body = solid_body(
        given.points - far_origin(given.points),
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
    space = body.discretization.space
    folded = np.flatnonzero((local_volumes(space, space.positions) <= 0.0).any(axis=1))
    if folded.size:
        raise InputError(
            f"{name}: {folded.size} tetrahedra are folded by their middle nodes, the first is number {folded[0]}: these must lie "
            "near the middles of the edges"
        )
    if is_shared and case.history is not None:
        raise InputError('history is for one process: start it without mpiexec, with solver.linear = "direct"')
    if is_shared and (body.discretization.sliding_nodes.size or body.discretization.skin_facets.size):
        raise InputError(
            f"{name}: sliding walls and pressure are for one process: start it without mpiexec, with solver.linear = "
            '"direct"'
        )
    return body


def on_petsc(case: EquilibriumCase, ranks: Ranks) -> bool:
    """Return whether PETSc solves the linear systems."""
    return ranks.size > 1 or case.solver.linear != "direct"


def notes_of(given: MeshedBody) -> list[str]:
    """Return what was assumed about a mesh and what is doubted, one sentence each."""
    origin = far_origin(given.points)
    at = ", ".join(f"{value:.0f}" for value in origin)
    moved = f"The mesh is far from the origin and is solved about ({at}) mm; figures show positions from there, files do not."
    return [*given.notes, *([moved] if origin.any() else []), *doubts_of(given)]
