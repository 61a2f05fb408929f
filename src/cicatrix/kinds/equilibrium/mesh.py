"""Read and check the mesh of a case of kind "equilibrium", without building the body."""

from __future__ import annotations

from ...core.errors import InputError
from ...files.mesh_tissue import Tissue
from ...files.meshes import ByGroup, MeshedBody, read_body
from .case import BodyTable, EquilibriumCase


def given_body(case: EquilibriumCase, elastic: tuple[float, float] | None) -> MeshedBody:
    """Read the mesh of a case.

    Parameters
    ----------
    case : EquilibriumCase
        The case.
    elastic : (float, float), optional
        Young's modulus [kPa] and Poisson's ratio of the whole body at small strain, if the case gives a law.

    Raises
    ------
    InputError
        If the mesh cannot be read, is not valid for a body, or does not fit the loads.
    """
    given = read_body(case.body.mesh, case.body.mesh_unit, elastic, _by_group(case.body))
    pressure, name = case.loads.pressure_kPa, case.body.mesh.name
    if pressure and not given.is_pressurised[given.tetrahedra[:, :4]].any():
        raise InputError(
            f"{name}: loads.pressure_kPa = {pressure:g} acts on no face: mark the corners of some boundary faces by point "
            "data `pressurised` = 1, or name their group, body.pressurised"
        )
    if case.solver.inverse and given.displacement.any():
        raise InputError(f"{name}: prescribed displacements must be 0 where solver.inverse = true")
    return given


def _by_group(body: BodyTable) -> ByGroup:
    return ByGroup(
        fixed=body.fixed,
        sliding=body.sliding,
        pressurised=body.pressurised,
        displacement=body.displacement_mm,
        materials={name: Tissue(one.E_kPa, one.nu, one.density_kg_m3) for name, one in body.materials.items()},
    )
