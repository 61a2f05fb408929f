"""Supports and prescribed displacements of a mesh: from the data in its file, or from a case by groups."""

from __future__ import annotations

from collections.abc import Mapping

import meshio
import numpy as np

from ..core.errors import InputError
from ..geometry.tetrahedra import boundary, middles_between
from .mesh_groups import Groups


def marks(mesh: meshio.Mesh, name: str, groups: Groups, names: tuple[str, ...], notes: list[str]) -> np.ndarray:
    """Return which nodes the case marks by groups, or else the file by point data (n,) bool."""
    if not names:
        return _marked(mesh.point_data, name, groups.n_nodes)
    if name in mesh.point_data:
        notes.append(f"body.{name} is used instead of the point data `{name}` of the mesh.")
    return groups.marked(names, f"body.{name}")


def _marked(point_data: Mapping[str, np.ndarray], name: str, n: int) -> np.ndarray:
    """Return whether the point data ``name`` mark each of n nodes by 1 (n,) bool; all False if the file lacks these data."""
    values = np.asarray(point_data.get(name, np.zeros(n)))
    if values.size != n:
        raise InputError(
            f"point data `{name}` must be one number for each node, 0 or 1; got {values.size // n} for each"
        )
    values = values.reshape(n)
    if (missing := np.flatnonzero(values != values)).size:
        raise InputError(
            f"point data `{name}` have no value at {missing.size} nodes, the first is node {missing[0]}: give each node 0 or 1"
        )
    wrong = np.flatnonzero(~np.isin(values, (0, 1)))
    if wrong.size:
        raise InputError(f"point data `{name}` must be 0 or 1; got {values[wrong[0]]:g} at node {wrong[0]}")
    return values == 1


def displacement_of(
    mesh: meshio.Mesh, is_fixed: np.ndarray, groups: Groups, by_group: Mapping[str, tuple[float, ...]]
) -> np.ndarray:
    """Return the prescribed displacement of nodes (n, 3) [mm], that of groups or else of the file."""
    if by_group:
        return _displacement_of_groups(groups, by_group)
    name = "prescribed_displacement"
    values = np.asarray(mesh.point_data.get(name, np.zeros((len(is_fixed), 3))), float)
    if values.shape != (len(is_fixed), 3):
        raise InputError(f"point data `{name}` must have three components [mm]")
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise InputError(f"point data `{name}` must be finite numbers; node {bad[0]} has {values[bad[0]].tolist()}")
    loose = np.flatnonzero(values.any(axis=1) & ~is_fixed)
    if loose.size:
        raise InputError(
            f"point data `{name}` move {loose.size} nodes that are not fixed, the first is node {loose[0]}: set `fixed` = 1 there"
        )
    return values


def _displacement_of_groups(groups: Groups, given: Mapping[str, tuple[float, ...]]) -> np.ndarray:
    values = np.full((groups.n_nodes, 3), np.nan)
    for name, vector in given.items():
        members = groups.marked([name], "body.displacement_mm")
        other = np.flatnonzero(members & np.isfinite(values[:, 0]) & (values != vector).any(axis=1))
        if other.size:
            raise InputError(
                f'body.displacement_mm: node {other[0]} of "{name}" is in another group, which moves otherwise'
            )
        values[members] = vector
    return np.nan_to_num(values)


def check_faces(subject: str, is_marked: np.ndarray, tetrahedra: np.ndarray) -> None:
    """Refuse marked nodes that belong to no boundary face with three marked corners."""
    faces = boundary(tetrahedra[:, :4])
    lonely = is_marked.copy()
    lonely[faces[is_marked[faces].all(axis=1)]] = False
    lonely[np.setdiff1d(np.arange(len(lonely)), tetrahedra[:, :4])] = False  # marks of midpoints are ignored
    if lonely.any():
        raise InputError(
            f"{subject} mark {np.count_nonzero(lonely)} nodes that are on no boundary face with all three corners "
            f"marked, the first is node {np.flatnonzero(lonely)[0]}: mark whole faces"
        )


def more_faces(key: str, names: tuple[str, ...], groups: Groups, tetrahedra: np.ndarray) -> list[str]:
    """Return a note if boundary faces that are in none of the groups have all corners in them, and so count with them."""
    if not names or not all(name in groups.faces for name in names):
        return []
    faces = np.sort(boundary(tetrahedra[:, :4]))
    own = np.sort(np.vstack([groups.faces[name] for name in names]))
    counted = faces[groups.marked(names, key)[faces].all(axis=1)]
    n = len(np.unique(np.vstack([own, counted]), axis=0)) - len(np.unique(own, axis=0))
    return [f"{n} boundary faces outside the groups of {key} have all corners in them and count too."] if n else []


def followed(
    is_fixed: np.ndarray, tetrahedra: np.ndarray, displacement: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Let midside nodes of boundary faces follow two fixed corners: fix those that are free, and move those left at rest.

    Parameters
    ----------
    is_fixed : (n,) bool array
        Fixed nodes.
    tetrahedra : (m, 4) or (m, 10) int array
        Tetrahedra; those of 4 nodes have no midside nodes.
    displacement : (n, 3) array [mm]
        Prescribed displacement; that of such a node becomes the mean of both corners'.

    Returns
    -------
    (n,) bool array, (n, 3) array [mm], list of str
        Both completed, and notes on what was changed.
    """
    if tetrahedra.shape[1] == 4:
        return is_fixed, displacement, []
    middles, *ends = middles_between(is_fixed, tetrahedra).T
    mean = 0.5 * (displacement[ends[0]] + displacement[ends[1]])
    is_free = ~is_fixed[middles]
    is_left = ~is_free & mean.any(axis=1) & ~displacement[middles].any(axis=1)
    is_fixed, displacement = is_fixed.copy(), displacement.copy()
    is_fixed[middles[is_free]] = True
    displacement[middles[is_free | is_left]] = mean[is_free | is_left]
    told = {
        f"{is_free.sum()} midside nodes on the surface lie between two fixed corners and are fixed too.": is_free.any(),
        f"{is_left.sum()} fixed midside nodes without a displacement move with the corners beside them.": is_left.any(),
    }
    return is_fixed, displacement, [note for note, holds in told.items() if holds]
