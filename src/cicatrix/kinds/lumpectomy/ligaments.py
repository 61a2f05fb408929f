"""Cooper's ligaments in the breast: where they run, and how much of the tissue they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from ...coupling.cavity import Tissue
from ...materials.ligaments import Ligaments
from ...mechanics.body import Discretization
from ...mechanics.elements import local_map, slopes
from ...mechanics.space import AnySpace
from .case import LigamentsTable


def with_ligaments(
    tissue: Tissue, table: LigamentsTable, discretization: Discretization, wall_nodes: np.ndarray
) -> Tissue:
    """Return the tissue with ligaments that run from the chest wall to the skin; the tissue itself if their share is 0.

    ``wall_nodes`` are the nodes of the mesh on the chest wall. The direction is that in the image: the shape without gravity, to
    which the law refers, is not known yet.
    """
    if not table.share:
        return tissue
    to_skin = direction(discretization.space, wall_nodes, np.unique(discretization.skin_nodes))
    share = np.full(to_skin.shape[:-1], table.share)
    components = tuple(np.moveaxis(to_skin, -1, 0))
    return replace(tissue, ligaments=Ligaments(share, table.stiffness_kPa, table.slack_stretch, direction=components))


def direction(space: AnySpace, wall_nodes: np.ndarray, skin_nodes: np.ndarray) -> np.ndarray:
    r"""Return the unit direction from the chest wall to the skin at quadrature points (n_elements, n_qp, 3) [1].

    It is that of the gradient of the harmonic function which is 0 on the wall and 1 on the skin, :math:`\Delta u = 0`: its lines
    start and end at right angles to the borders and never meet inside. Linear elements; the gradient is averaged at the corners
    of the elements, which makes the direction continuous. Nodes on both borders count as wall.
    """
    corners, table = space.corners, space.corner_table
    nodes, cells = np.unique(corners, return_inverse=True)
    cells = cells.reshape(corners.shape)
    X = space.positions[corners]
    B = np.asarray(slopes(X, table))  # (n_elements, n_qp, n_corners, n_axes)
    weight = table.weight * np.abs(np.linalg.det(np.asarray(local_map(X, table.gradient))))
    on_wall, on_skin = np.isin(nodes, wall_nodes), np.isin(nodes, skin_nodes)
    u = _harmonic(cells, np.einsum("eq,eqaj,eqbj->eab", weight, B, B), on_wall | on_skin, np.where(on_wall, 0.0, 1.0))
    gradient = np.einsum("eqaj,ea->eqj", B, u[cells])
    volumes = weight.sum(axis=1)
    mean = np.einsum("eq,eqj->ej", weight, gradient) / volumes[:, None]
    at_nodes = _averaged(cells, volumes, mean, len(nodes))
    at_points = np.einsum("qa,eaj->eqj", table.value, at_nodes[cells])
    out = np.zeros((*at_points.shape[:-1], 3))
    out[..., : at_points.shape[-1]] = at_points
    return out / np.linalg.norm(out, axis=-1, keepdims=True)


def _harmonic(cells: np.ndarray, stiffness: np.ndarray, is_given: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Solve Laplace's equation: element matrices (n, a, a) of ``cells`` (n, a), values where they are given -> (n_nodes,)."""
    shape = stiffness.shape
    rows, columns = np.broadcast_to(cells[:, :, None], shape), np.broadcast_to(cells[:, None, :], shape)
    n = len(given)
    A = sp.coo_array((stiffness.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n)).tocsr()
    u = np.where(is_given, given, 0.0)
    free = np.flatnonzero(~is_given)
    if len(free):
        u[free] = spsolve(A[free][:, free].tocsc(), -(A @ u)[free])
    return u


def _averaged(cells: np.ndarray, weights: np.ndarray, values: np.ndarray, n_nodes: int) -> np.ndarray:
    """Average values of elements (n, j) at their nodes, weighted by (n,): cells (n, a) -> (n_nodes, j)."""
    total = np.bincount(cells.ravel(), np.repeat(weights, cells.shape[1]), n_nodes)
    each = [np.bincount(cells.ravel(), np.repeat(weights * v, cells.shape[1]), n_nodes) for v in values.T]
    return np.stack(each, axis=1) / total[:, None]
