"""Carry a deformation into the open cavity, where there is no tissue to compute it."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..core.linear import linear_solver
from .body import Frame, measures
from .elements import slopes
from .pattern import Pattern
from .space import SolidSpace, Space


class Extension:
    """Smooth continuation of displacements into elements that no tissue fills.

    A compressible linear elastic filling of the open elements follows the tissue and never acts on it: its nodes are
    solved for afterwards, with the tissue's nodes given. It gives new tissue the deformation that it is born with, and
    pictures the shape of the cavity.

    Parameters
    ----------
    frame : Frame
        Space and supports.
    X : (n_nodes, 3) array [mm]
        Unloaded positions.
    elements : (n,) int array
        Elements that may be open; all others always hold tissue.
    """

    def __init__(self, frame: Frame, X: np.ndarray, elements: np.ndarray) -> None:
        self._frame, self._X, self._elements = frame, X, elements
        n_dofs = 3 * frame.space.n_nodes
        self._stiffness = _linear_stiffness(frame.space, X, elements)
        self._pattern = Pattern([frame.blocks[0][elements]], np.arange(n_dofs), n_dofs)
        self._no_diagonal = np.zeros(n_dofs)

    def fill(self, x: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """Positions with the open nodes moved along: x (n_nodes, 3) [mm], fraction (n_elements,) -> (n_nodes, 3) [mm]."""
        held = np.zeros(self._frame.space.n_nodes, bool)
        held[self._frame.space.element_nodes[fraction > 0.0]] = True
        held[self._frame.fixed_nodes] = True
        if held.all():
            return x
        is_empty = fraction[self._elements] == 0.0
        K = self._pattern.assemble([self._stiffness * is_empty[:, None, None]], self._no_diagonal)
        is_open = ~np.repeat(held, 3)
        u = (x - self._X).reshape(-1)
        u[is_open] = self._solved(K[is_open][:, is_open], -K[is_open][:, ~is_open] @ u[~is_open])
        return self._X + u.reshape(-1, 3)

    def _solved(self, K: sp.csr_array, force: np.ndarray) -> np.ndarray:
        """Solution of K u = force; SuperLU is soon ready, but its factors of a solid would not fit."""
        if isinstance(self._frame.space, Space):
            return splu(K.tocsc()).solve(force)
        solver = linear_solver(symmetric=True)
        solver.factor(K)
        return solver.solve(force)


def _linear_stiffness(space: Space | SolidSpace, X: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Matrices of elements (n,) of an elastic filling with both Lame constants 1 (n, 3 n_shape, 3 n_shape)."""
    grad = np.asarray(slopes(X[space.element_nodes], space.table))[elements]
    grad = np.pad(grad, [(0, 0)] * 3 + [(0, 3 - grad.shape[-1])])  # nothing changes along a section's normal
    weights = measures(space, X)[elements]
    products = np.einsum("eq,eqaJ,eqbK->eaJbK", weights, grad, grad)
    laplacian = np.einsum("eaJbJ->eab", products)[:, :, None, :, None] * np.eye(3)[:, None, :]
    return (laplacian + products + products.transpose(0, 1, 4, 3, 2)).reshape(len(grad), grad.shape[2] * 3, -1)
