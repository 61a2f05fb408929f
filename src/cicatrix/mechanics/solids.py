"""Construction of a body of quadratic tetrahedra from arrays: space, tissue and supports."""

from __future__ import annotations

import numpy as np

from ..geometry.tetrahedra import middles_between, with_middles
from ..materials.neo_hookean import NeoHookean, moduli_from_young
from .body import Body, Discretization
from .space import SolidSpace
from .supports import walls


def solid_body(
    points: np.ndarray,
    tetrahedra: np.ndarray,
    is_fixed: np.ndarray,
    E: np.ndarray,
    nu: np.ndarray,
    density: np.ndarray,
    *,
    is_sliding: np.ndarray | None = None,
    is_pressurised: np.ndarray | None = None,
    pressure: float = 0.0,
) -> Body:
    """Build a body of neo-Hookean tissue on a mesh.

    Parameters
    ----------
    points : (n, 3) array [mm]
        Nodes of the mesh; they are the first of the body's nodes.
    tetrahedra : (m, 4) or (m, 10) int array
        Corners, then midpoints of edges; missing midpoints are added halfway along the edges.
    is_fixed : (n,) bool array
        Constrained nodes. An added midpoint is constrained if its edge lies on the surface and both ends are constrained.
    E, nu, density : (m,) arrays [kPa], [1], [kg/mm^3]
        Tissue of each tetrahedron.
    is_sliding, is_pressurised : (n,) bool arrays, optional
        True for the corners of sliding or pressurised boundary faces; a face slides in its own plane or carries the pressure if
        this is true at all its corners.
    pressure : float [kPa]
        External pressure on the deformed faces, positive inwards.
    """
    space, fixed_nodes = solid_space(points, tetrahedra, is_fixed)
    pressure_faces = _faces(space, is_pressurised)
    shape = (space.n_elements, space.table.weight.size)
    mu, kappa = (np.broadcast_to(m[:, None], shape) for m in moduli_from_young(E, nu))
    return Body(
        discretization=Discretization(space, pressure_faces, fixed_nodes, *walls(space, _faces(space, is_sliding))),
        law=NeoHookean(mu, kappa),
        density=np.broadcast_to(density[:, None], shape),
        fraction=np.ones(space.n_elements),
        skin=NeoHookean(1.0, 1.0),
        skin_thickness=np.zeros(len(pressure_faces)),
        pressure=np.full(len(pressure_faces), pressure) if pressure and len(pressure_faces) else None,
    )


def solid_space(points: np.ndarray, tetrahedra: np.ndarray, is_fixed: np.ndarray) -> tuple[SolidSpace, np.ndarray]:
    """Return the quadratic elements of a mesh and the constrained nodes; arguments as in :func:`solid_body`."""
    if tetrahedra.shape[1] == 4:
        points, tetrahedra = with_middles(points, tetrahedra)
        is_fixed = _with_fixed_middles(is_fixed, tetrahedra, len(points))
    return SolidSpace(points, tetrahedra), np.flatnonzero(is_fixed)


def _faces(space: SolidSpace, is_there: np.ndarray | None) -> np.ndarray:
    """Return the indices of the boundary faces whose three corners are all marked in ``is_there``: (n,) bool -> (k,) int.

    Nodes beyond the first n are not marked; without ``is_there`` no face is.
    """
    if is_there is None:
        return np.zeros(0, int)
    corner = np.concatenate([is_there, np.zeros(space.n_nodes - len(is_there), bool)])
    return np.flatnonzero(corner[space.boundary[:, :3]].all(axis=1))


def _with_fixed_middles(is_fixed: np.ndarray, tetrahedra: np.ndarray, n_nodes: int) -> np.ndarray:
    """Constrain the added midpoints between constrained ends on the surface: (n_given,) bool, (m, 10) -> (n_nodes,) bool."""
    out = np.concatenate([is_fixed, np.zeros(n_nodes - len(is_fixed), bool)])
    out[middles_between(out, tetrahedra)[:, 0]] = True
    return out
