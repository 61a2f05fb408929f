"""Closed surfaces of triangles: volume inside, exact signed distance, depth below the convex hull."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from .tetrahedra import area_vectors

CANDIDATES = 8  # triangles tested first for each point; doubled until no untested triangle can be nearer
AT_ONCE = 2**22  # largest number of entries in a work array


@dataclass(frozen=True, eq=False)
class Surface:
    """Closed surface of triangles.

    Parameters
    ----------
    points : (n, 3) array [mm]
        Points; the surface need not use all of them.
    triangles : (k, 3) int array
        Corners of the triangles, counter-clockwise seen from outside.
    """

    points: np.ndarray
    triangles: np.ndarray

    @cached_property
    def volume(self) -> float:
        """Volume enclosed by the surface, by the divergence theorem [mm^3]."""
        a, b, c = (self.points - self.points[self.triangles[0, 0]])[self.triangles].transpose(1, 0, 2)
        return float(np.einsum("ki,ki->", a, np.cross(b, c)) / 6.0)

    def node_areas(self, chosen: np.ndarray) -> np.ndarray:
        """Return the area of each point (n,) [mm^2]: a third of the area of the chosen (k,) triangles around it."""
        triangles = self.triangles[chosen]
        area = np.linalg.norm(area_vectors(self.points, triangles), axis=1) / 3.0
        return np.bincount(triangles.ravel(), np.repeat(area, 3), len(self.points))

    def inward(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points (m, 3) from the surface (m,) [mm], positive inside.

        The sign comes from the pseudonormal at the nearest point: the normal of the face, the sum over both faces of an
        edge, or the angle-weighted sum over all faces around a corner (Baerentzen & Aanaes 2005).
        """
        triangle, weights = self.nearest(points)
        foot = np.einsum("mc,mci->mi", weights, self.points[self.triangles[triangle]])
        normal = self._pseudonormals(triangle, weights)
        away = np.linalg.norm(points - foot, axis=1)
        return np.where(np.einsum("mi,mi->m", points - foot, normal) > 0.0, -away, away)

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the nearest point of the surface: points (m, 3) -> triangle (m,), barycentric weights (m, 3).

        The result is exact: the search over triangle centres widens until no other triangle can be nearer.
        """
        tree, reach = self._centres
        triangle, weights = np.zeros(len(points), int), np.zeros((len(points), 3))
        left, k = np.arange(len(points)), min(CANDIDATES, len(self.triangles))
        while left.size:
            far, found = tree.query(points[left], k=k)
            far, found = far.reshape(len(left), -1), found.reshape(len(left), -1)
            away, on = _closest(points[left, None], self.points[self.triangles[found]])
            best = np.argmin(away, axis=1)
            row = np.arange(len(left))
            triangle[left], weights[left] = found[row, best], on[row, best]
            certain = (far[:, -1] - reach >= away[row, best]) | (k == len(self.triangles))
            left, k = left[~certain], min(2 * k, len(self.triangles))
        return triangle, weights

    def depth_below_hull(self, points: np.ndarray) -> np.ndarray:
        """Return the depth of points below the convex hull of the surface: points (m, 3) inside it -> (m,) [mm]."""
        equations = ConvexHull(self.points[np.unique(self.triangles)]).equations
        rows = max(1, AT_ONCE // len(equations))
        parts = [points[i : i + rows] @ equations[:, :3].T + equations[:, 3] for i in range(0, len(points), rows)]
        return np.concatenate([-part.max(axis=1) for part in parts])

    @cached_property
    def _centres(self) -> tuple[cKDTree, float]:
        """Search tree of the triangle centres, and the largest distance of a corner from its centre [mm]."""
        corners = self.points[self.triangles]
        centres = corners.mean(axis=1)
        return cKDTree(centres), float(np.linalg.norm(corners - centres[:, None], axis=2).max())

    @cached_property
    def _normals(self) -> np.ndarray:
        """Outward unit normals of the triangles (k, 3)."""
        normals = area_vectors(self.points, self.triangles)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)

    @cached_property
    def _corner_normals(self) -> np.ndarray:
        """Pseudonormals of the points (n, 3): the normals of the adjacent triangles, weighted by their angles."""
        corners = self.points[self.triangles]
        one, other = (np.roll(corners, shift, axis=1) - corners for shift in (-1, 1))
        cosine = np.einsum("kci,kci->kc", one, other) / np.maximum(
            np.linalg.norm(one, axis=2) * np.linalg.norm(other, axis=2), 1e-300
        )
        share = np.arccos(np.clip(cosine, -1.0, 1.0))[..., None] * self._normals[:, None]
        out = np.zeros_like(self.points)
        np.add.at(out, self.triangles.ravel(), share.reshape(-1, 3))
        return out

    @cached_property
    def _edge_normals(self) -> np.ndarray:
        """Pseudonormals of the edges opposite to the corners (k, 3, 3): the sum of the normals of both faces."""
        sides = np.sort(self.triangles[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
        _, number = np.unique(sides, axis=0, return_inverse=True)
        total = np.zeros((number.max() + 1, 3))
        np.add.at(total, number.ravel(), np.repeat(self._normals, 3, axis=0))
        return total[number.ravel()].reshape(-1, 3, 3)

    def _pseudonormals(self, triangle: np.ndarray, weights: np.ndarray) -> np.ndarray:
        n_on, row = np.count_nonzero(weights > 0.0, axis=1)[:, None], np.arange(len(weights))
        corner = self._corner_normals[self.triangles[triangle, weights.argmax(axis=1)]]
        edge = self._edge_normals[triangle, weights.argmin(axis=1)]
        return np.where(n_on == 3, self._normals[triangle[row]], np.where(n_on == 2, edge, corner))


def _closest(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances of points (m, 1, 3) to triangles (m, k, 3, 3) [mm], and the nearest points' barycentric weights (m, k, 3).

    The nearest point is the projection onto the triangle's plane if that lies inside the triangle, otherwise a point of an edge.
    """
    a, b, c = np.moveaxis(corners, -2, 0)
    ab, ac, ap = b - a, c - a, points - a
    dot = lambda u, v: np.einsum("...i,...i->...", u, v)  # noqa: E731
    d11, d12, d22, d1, d2 = dot(ab, ab), dot(ab, ac), dot(ac, ac), dot(ap, ab), dot(ap, ac)
    det = np.maximum(d11 * d22 - d12 * d12, 1e-300)
    v, w = (d22 * d1 - d12 * d2) / det, (d11 * d2 - d12 * d1) / det
    within = np.stack([1.0 - v - w, v, w], axis=-1)
    ways = [np.where((within >= 0.0).all(axis=-1, keepdims=True), within, np.nan)]
    for i in range(3):
        start, end = corners[..., i, :], corners[..., (i + 1) % 3, :]
        along = dot(points - start, end - start) / np.maximum(dot(end - start, end - start), 1e-300)
        share = np.clip(along, 0.0, 1.0)
        ways.append(np.stack([share * (j == (i + 1) % 3) + (1.0 - share) * (j == i) for j in range(3)], axis=-1))
    weights = np.stack(ways)
    away = np.linalg.norm(points - np.einsum("...c,...ci->...i", weights, corners), axis=-1)
    best = np.where(np.isnan(away), np.inf, away).argmin(axis=0)[None, ..., None]
    pick = np.take_along_axis(weights, best, axis=0)[0]
    return np.take_along_axis(away, best[..., 0], axis=0)[0], pick
