"""Extension of the displacement field from the tissue into the cavity, where there is no tissue."""

from __future__ import annotations

import numpy as np

from ..numerics.linear import LinearSolver
from .body import PIECE, Discretization
from .pattern import Pattern
from .space import Table

ACCURACY = 1e-12  # tolerance of the linear solve, relative to its right-hand side


class Extension:
    """Smooth extension of displacements into elements without tissue.

    These elements are filled with a fictitious compressible linear elastic material. Its displacements are computed
    after those of the tissue, with the latter as boundary values, so it exerts no force on the tissue. The result gives the
    deformation at which new tissue is deposited, and the shape of the cavity in figures.

    Parameters
    ----------
    discretization : Discretization
        Space and supports.
    X : (n_nodes, 3) array [mm]
        Unloaded positions.
    """

    def __init__(self, discretization: Discretization, X: np.ndarray) -> None:
        self._discretization, self._X = discretization, X

    def fill(self, x: np.ndarray, fraction: np.ndarray) -> np.ndarray:
        """Return positions whose displacements are extended to the nodes outside the tissue (n_nodes, 3) [mm].

        x (n_nodes, 3) [mm] are the deformed positions; those of tissue nodes and of fixed nodes stay as given. ``fraction``
        (n_elements,) [1] is the fraction of each element that is tissue; elements with 0 get the fictitious material.
        """
        space = self._discretization.space
        is_constrained = np.zeros(space.n_nodes, bool)
        is_constrained[space.element_nodes[fraction > 0.0]] = True
        is_constrained[self._discretization.fixed_nodes] = True
        if is_constrained.all():
            return x
        cells, nodes = space.element_nodes[fraction == 0.0], np.flatnonzero(~is_constrained)
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
    """Return stiffness matrices of linear elasticity with both Lame constants 1: X (n, a, 3) [mm] -> (n, 3a, 3a)."""
    n_axes = table.gradient.shape[-1]
    maps = np.einsum("eai,qab->eqib", X[..., :n_axes], table.gradient)
    grad = np.einsum("qab,eqbJ->eqaJ", table.gradient, np.linalg.inv(maps))
    grad = np.pad(grad, [(0, 0)] * 3 + [(0, 3 - n_axes)])  # no gradient along a section's normal
    weights = table.weight * np.abs(np.linalg.det(maps))
    products = np.einsum("eq,eqaJ,eqbK->eaJbK", weights, grad, grad, optimize=True)
    laplacian = np.einsum("eaJbJ->eab", products)[:, :, None, :, None] * np.eye(3)[:, None, :]
    return (laplacian + products + products.transpose(0, 1, 4, 3, 2)).reshape(len(grad), grad.shape[2] * 3, -1)
