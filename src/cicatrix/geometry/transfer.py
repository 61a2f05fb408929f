"""Between a mesh and a lattice: which site lies in which element, and fields carried across without loss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# a P2 triangle cut into four straight ones: nodes (vertices 0 1 2, edges 3 = 01, 4 = 12, 5 = 02)
QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
LOCAL = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])
OUTSIDE = -1


@dataclass(frozen=True, eq=False)
class SiteMap:
    """Element and local coordinates of every site of a lattice.

    Each site belongs to exactly one element or to none, so counting cells by element neither loses nor doubles any.

    Parameters
    ----------
    element : (n_sites,) int array
        Element number, OUTSIDE (-1) where there is none.
    local : (n_sites, 2) array [1]
        Coordinates in the reference triangle.
    n_elements : int
        Number of elements of the mesh.
    """

    element: np.ndarray
    local: np.ndarray
    n_elements: int

    def count(self, chosen: np.ndarray) -> np.ndarray:
        """Chosen sites in each element: (n_sites,) bool -> (n_elements,) int."""
        return np.bincount(self.element[chosen & (self.element != OUTSIDE)], minlength=self.n_elements)

    def evaluate(self, coefficients: np.ndarray) -> np.ndarray:
        """Field linear in each element, at the sites: coefficients (n_elements, 3) -> (n_sites,); 0 outside."""
        c = coefficients[self.element]
        values = c[:, 0] + np.sum(c[:, 1:] * (self.local - 1.0 / 3.0), axis=1)
        return np.where(self.element == OUTSIDE, 0.0, values)


def locate_sites(positions: np.ndarray, sites: np.ndarray) -> SiteMap:
    """Find the element of each site.

    Parameters
    ----------
    positions : (n_elements, 6, 2) array [mm]
        Nodes of P2 triangles; their curved edges are taken as two straight halves.
    sites : (n_sites, 2) array [mm]
        Site positions in any order.
    """
    order = np.argsort(sites[:, 1], kind="stable")
    height = sites[order, 1]
    element = np.full(len(sites), OUTSIDE)
    local = np.zeros((len(sites), 2))
    low, high = sites.min(axis=0), sites.max(axis=0)
    near = np.all((positions.max(axis=1) >= low) & (positions.min(axis=1) <= high), axis=1)
    for e in np.flatnonzero(near):
        for quarter in QUARTERS:
            corners = positions[e, quarter]
            rows = slice(*np.searchsorted(height, [corners[:, 1].min(), np.nextafter(corners[:, 1].max(), np.inf)]))
            candidates = order[rows]
            x = sites[candidates, 0]
            candidates = candidates[(x >= corners[:, 0].min()) & (x <= corners[:, 0].max())]
            weights = _barycentric(corners, sites[candidates])
            inside = (weights >= -1e-12).all(axis=1) & (element[candidates] == OUTSIDE)
            element[candidates[inside]] = e
            local[candidates[inside]] = weights[inside] @ LOCAL[quarter]
    return SiteMap(element, local, len(positions))


def _barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    edges = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]])
    (a, b), (c, d) = edges
    det = a * d - b * c
    r = points - corners[0]
    second, third = (d * r[:, 0] - b * r[:, 1]) / det, (a * r[:, 1] - c * r[:, 0]) / det
    return np.column_stack([1.0 - second - third, second, third])


def linear_fit(values: np.ndarray, weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Least-squares linear function in each element; keeps the weighted mean.

    values, weights (n_elements, n_qp), points (n_qp, 2) local coordinates -> coefficients (n_elements, 3) of
    1, xi - 1/3, eta - 1/3.
    """
    basis = np.column_stack([np.ones(len(points)), points - 1.0 / 3.0])
    mass = np.einsum("eq,qi,qj->eij", weights, basis, basis)
    return np.linalg.solve(mass, np.einsum("eq,eq,qi->ei", weights, values, basis)[..., None])[..., 0]
