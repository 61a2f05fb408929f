"""Tissue of the tetrahedra of a mesh: from the data in its file, or from a case by groups."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import meshio
import numpy as np

from ..core.errors import InputError
from .mesh_groups import Groups


class Tissue(NamedTuple):
    """Tissue of a group; None leaves a value to the file."""

    E: float | None
    """Young's modulus [kPa]."""
    nu: float | None
    """Poisson's ratio [1]."""
    density: float | None
    """Mass density [kg/m^3]."""


def tissue_of(
    mesh: meshio.Mesh,
    kind: str,
    groups: Groups,
    materials: Mapping[str, Tissue],
    elastic: tuple[float, float] | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return E [kPa], nu [1] and density [kg/m^3] of each tetrahedron (m,).

    Parameters
    ----------
    mesh : meshio.Mesh
        The mesh; its tetrahedra are of type ``kind``.
    groups : Groups
        Groups of the mesh.
    materials : mapping of str to Tissue
        Tissue by the name of a group; it goes before the cell data of the mesh.
    elastic : (float, float), optional
        E [kPa] and nu of all tetrahedra, instead of those given.

    Raises
    ------
    InputError
        If a tetrahedron has no tissue, or one that cannot be.
    """
    members = {name: groups.members(name, "body.materials") for name in materials}
    n = sum(len(block) for block in mesh.cells if block.type == kind)
    _check_apart(members, n)

    def values_of(name: str, key: str, place: int) -> np.ndarray:
        given = cell_data(mesh, name, kind)
        values = np.full(n, np.nan) if given is None else given
        for group, tissue in materials.items():
            if tissue[place] is not None:
                values[members[group]] = tissue[place]
        if given is None and np.isnan(values).any():
            raise InputError(_missing(name, key, values, groups))
        refuse(~np.isfinite(values), f"{name} must be a finite number", values)
        return values

    density = values_of("density_kg_m3", "density_kg_m3", 2)
    if elastic is None:
        E, nu = values_of("youngs_modulus_kPa", "E_kPa", 0), values_of("poisson_ratio", "nu", 1)
    else:
        E, nu = (np.full(len(density), value) for value in elastic)
    refuse(E <= 0.0, "youngs_modulus_kPa must be above 0", E)
    refuse((nu < 0.0) | (nu >= 0.5), "poisson_ratio must be at least 0 and below 0.5", nu)
    refuse(density <= 0.0, "density_kg_m3 must be above 0", density)
    return E, nu, density


def _check_apart(members: Mapping[str, np.ndarray], n: int) -> None:
    """Refuse groups of ``body.materials`` that share tetrahedra."""
    owner = np.full(n, "", object)
    for name, rows in members.items():
        taken = rows[owner[rows] != ""]
        if taken.size:
            raise InputError(
                f'body.materials: {taken.size} tetrahedra are in "{owner[taken[0]]}" and in "{name}"; each must be in one group'
            )
        owner[rows] = name


def _missing(name: str, key: str, values: np.ndarray, groups: Groups) -> str:
    """Return a sentence on tetrahedra without a value, with the groups that could give it."""
    n = np.count_nonzero(np.isnan(values))
    part = "" if n == len(values) else f", and body.materials gives {key} to all but {n} of {len(values)} tetrahedra"
    without = [group for group, rows in groups.tetrahedra.items() if np.isnan(values[rows]).any()]
    if not without:
        return f"cell data `{name}` are missing{part}"
    names, example = ", ".join(f'"{group}"' for group in without), f'[body.materials."{without[0]}"]'
    return f"cell data `{name}` are missing{part}: give {key} of groups, such as {example}; groups without it: {names}"


def cell_data(mesh: meshio.Mesh, name: str, kind: str) -> np.ndarray | None:
    """Return data of the tetrahedra (m,), the first component of each; None if the file lacks them."""
    if name not in mesh.cell_data:
        return None
    blocks = [values for values, block in zip(mesh.cell_data[name], mesh.cells) if block.type == kind]
    return np.concatenate([np.array(block, float).reshape(len(block), -1)[:, 0] for block in blocks])


def refuse(is_wrong: np.ndarray, sentence: str, values: np.ndarray) -> None:
    """Raise an error with the first wrong value (m,), if there is one; the sentence goes on after "cell data"."""
    wrong = np.flatnonzero(is_wrong)
    if wrong.size:
        raise InputError(f"cell data {sentence}; got {values[wrong[0]]:g} at cell {wrong[0]}")
