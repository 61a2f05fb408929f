"""A body of quadratic tetrahedra from arrays: space, tissue and supports."""

from __future__ import annotations

import numpy as np

from ..geometry.tetrahedra import boundary, with_middles
from ..materials.neo_hookean import NeoHookean, moduli_from_young
from .body import Body, Frame
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
    """Fill a mesh with neo-Hookean tissue.

    Parameters
    ----------
    points : (n, 3) array [mm]
        Nodes; they stay the first of the body's nodes.
    tetrahedra : (m, 4) or (m, 10) int array
        Corners, then middles of edges; where there are none they are added, halfway.
    is_fixed : (n,) bool array
        Nodes that are held. An added middle is held where its edge lies on the surface and both ends are held.
    E, nu, density : (m,) arrays [kPa], [1], [kg/mm^3]
        Tissue of each tetrahedron.
    is_sliding, is_pressurised : (n,) bool arrays, optional
        Boundary faces slide along themselves, or bear the pressure, where they do so at all their corners.
    pressure : float [kPa]
        From outside, along the normal that a face has once it is deformed.
    """
    space, fixed_nodes = solid_space(points, tetrahedra, is_fixed)
    pressed = _faces(space, is_pressurised)
    shape = (space.n_elements, space.table.weight.size)
    mu, kappa = (np.broadcast_to(m[:, None], shape) for m in moduli_from_young(E, nu))
    return Body(
        frame=Frame(space, pressed, fixed_nodes, *walls(space, _faces(space, is_sliding))),
        law=NeoHookean(mu, kappa),
        density=np.broadcast_to(density[:, None], shape),
        fraction=np.ones(space.n_elements),
        skin=NeoHookean(1.0, 1.0),
        skin_thickness=np.zeros(len(pressed)),
        pressure=np.full(len(pressed), pressure) if pressure and len(pressed) else None,
    )


def solid_space(points: np.ndarray, tetrahedra: np.ndarray, is_fixed: np.ndarray) -> tuple[SolidSpace, np.ndarray]:
    """Quadratic elements of a mesh, and the nodes that are held; arguments as :func:`solid_body` has them."""
    if tetrahedra.shape[1] == 4:
        points, tetrahedra = with_middles(points, tetrahedra)
        is_fixed = _with_fixed_middles(is_fixed, tetrahedra, len(points))
    return SolidSpace(points, tetrahedra), np.flatnonzero(is_fixed)


def _faces(space: SolidSpace, is_there: np.ndarray | None) -> np.ndarray:
    """Numbers of the boundary faces that are there at all their corners."""
    if is_there is None:
        return np.zeros(0, int)
    corner = np.concatenate([is_there, np.zeros(space.n_nodes - len(is_there), bool)])
    return np.flatnonzero(corner[space.boundary[:, :3]].all(axis=1))


def _with_fixed_middles(is_fixed: np.ndarray, tetrahedra: np.ndarray, n_nodes: int) -> np.ndarray:
    """(n_given,) bool, (m, 10) -> (n_nodes,) bool."""
    one, other, middle = boundary(tetrahedra)[:, [[0, 1, 3], [1, 2, 4], [0, 2, 5]]].reshape(-1, 3).T
    out = np.concatenate([is_fixed, np.zeros(n_nodes - len(is_fixed), bool)])
    out[middle[is_fixed[one] & is_fixed[other]]] = True
    return out
