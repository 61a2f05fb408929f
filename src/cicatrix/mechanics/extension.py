"""Carry a deformation into the open cavity, where there is no tissue to compute it."""

from __future__ import annotations

import numpy as np

from ..numerics.linear import LinearSolver
from .body import PIECE, Frame
from .pattern import Pattern
from .space import Table

ACCURACY = 1e-12  # of the linear solve, relative to the forces that tissue exerts


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
    """

    def __init__(self, frame: Frame, X: np.ndarray) -> None:
        self._frame, self._X = frame, X

    def fill(self, x: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """Positions with the open nodes moved along: x (n_nodes, 3) [mm], fraction (n_elements,) -> (n_nodes, 3) [mm]."""
        space = self._frame.space
        held = np.zeros(space.n_nodes, bool)
        held[space.element_nodes[fraction > 0.0]] = True
        held[self._frame.fixed_nodes] = True
        if held.all():
            return x
        cells, nodes = space.element_nodes[fraction == 0.0], np.flatnonzero(~held)
        pattern = Pattern([cells], nodes, space.n_nodes)
        data, force, u = pattern.zeros(), np.zeros_like(x), x - self._X
        u[nodes] = 0.0
        for first in range(0, len(cells), PIECE):
            part = cells[first : first + PIECE]
            stiffness = _linear_stiffness(self._X[part], space.table)
            pattern.add(data, 0, first, stiffness)
            np.add.at(
                force, part, np.einsum("emn,en->em", stiffness, u[part].reshape(len(part), -1)).reshape(*part.shape, 3)
            )
        matrix = pattern.matrix(data, np.zeros(pattern.n_dofs))
        u[nodes] = LinearSolver().solve(matrix, -force[nodes].ravel(), ACCURACY).reshape(-1, 3)
        return self._X + u


def _linear_stiffness(X: np.ndarray, table: Table) -> np.ndarray:
    """Matrices of an elastic filling with both Lame constants 1: X (n, a, 3) [mm] -> (n, 3a, 3a)."""
    n_axes = table.gradient.shape[-1]
    maps = np.einsum("eai,qab->eqib", X[..., :n_axes], table.gradient)
    grad = np.einsum("qab,eqbJ->eqaJ", table.gradient, np.linalg.inv(maps))
    grad = np.pad(grad, [(0, 0)] * 3 + [(0, 3 - n_axes)])  # nothing changes along a normal
    weights = table.weight * np.abs(np.linalg.det(maps))
    products = np.einsum("eq,eqaJ,eqbK->eaJbK", weights, grad, grad, optimize=True)
    laplacian = np.einsum("eaJbJ->eab", products)[:, :, None, :, None] * np.eye(3)[:, None, :]
    return (laplacian + products + products.transpose(0, 1, 4, 3, 2)).reshape(len(grad), grad.shape[2] * 3, -1)
