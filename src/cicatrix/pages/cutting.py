"""Cut a tetrahedral body open along a level set: clip its surface and compute the face of the cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Piece:
    """Triangles with points on the edges of a mesh, so that mesh fields can be interpolated to them.

    Parameters
    ----------
    ends : (n, 2) array
        The two mesh corners between which each point lies; equal if the point is a corner.
    share : (n,) array [1]
        Position along the edge: 0 at the first corner, 1 at the second.
    triangles : (m, 3) array
        Points of each triangle, as rows of ``ends``.
    owner : (m,) array
        Element that each triangle belongs to.
    """

    ends: np.ndarray
    share: np.ndarray
    triangles: np.ndarray
    owner: np.ndarray

    def at(self, values: np.ndarray) -> np.ndarray:
        """Interpolate values at the mesh corners (k, ...) to the points (n, ...)."""
        s = self.share.reshape(-1, *(1,) * (values.ndim - 1))
        return (1.0 - s) * values[self.ends[:, 0]] + s * values[self.ends[:, 1]]

    def joined(self, other: Piece) -> Piece:
        """Return both pieces as one; points on a common edge are not merged, so that the edge is drawn sharp."""
        return Piece(
            np.vstack([self.ends, other.ends]),
            np.concatenate([self.share, other.share]),
            np.vstack([self.triangles, other.triangles + len(self.ends)]),
            np.concatenate([self.owner, other.owner]),
        )


def clipped(triangles: np.ndarray, owner: np.ndarray, height: np.ndarray) -> Piece:
    """Return the part of a surface with height <= 0: triangles (m, 3), owner (m,), height at corners (k,)."""
    corners = [triangles[..., None].repeat(2, axis=2)[_inside(triangles, height) == 3]]
    owners = [owner[_inside(triangles, height) == 3]]
    one, of_one = _odd_first(triangles, owner, height, n_inside=1)
    a, b, c = one.T
    corners.append(_edges((a, a), (a, b), (a, c)))
    two, of_two = _odd_first(triangles, owner, height, n_inside=2)
    a, b, c = two.T
    corners += [_edges((b, a), (b, b), (c, c)), _edges((b, a), (c, c), (c, a))]
    owners += [of_one, of_two, of_two]
    return _piece(np.concatenate(corners), np.concatenate(owners), height)


def face(cells: np.ndarray, chosen: np.ndarray, height: np.ndarray, points: np.ndarray, towards: np.ndarray) -> Piece:
    """Return the surface height = 0 inside chosen tetrahedra, with normals in the direction ``towards`` (3,).

    cells (n, 4), chosen (n,) bool, height (k,), points (k, 3).
    """
    rows = np.flatnonzero(chosen)
    tetrahedra = cells[rows]
    corners, owners = [], []
    for n_inside in (1, 3):
        odd, owner = _odd_first(tetrahedra, rows, height, n_inside)
        a, b, c, d = odd.T
        corners.append(_edges((a, b), (a, c), (a, d)))
        owners.append(owner)
    two = _inside(tetrahedra, height) == 2
    order = np.argsort(height[tetrahedra[two]], axis=1)
    a, b, c, d = np.take_along_axis(tetrahedra[two], order, axis=1).T  # a and b have the lowest height
    corners += [_edges((a, c), (a, d), (b, d)), _edges((a, c), (b, d), (b, c))]
    owners += [rows[two]] * 2
    piece = _piece(np.concatenate(corners), np.concatenate(owners), height)
    p = piece.at(points)[piece.triangles]
    turned = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) @ towards < 0.0
    triangles = np.where(turned[:, None], piece.triangles[:, ::-1], piece.triangles)
    return Piece(piece.ends, piece.share, triangles, piece.owner)


def _inside(cells: np.ndarray, height: np.ndarray) -> np.ndarray:
    return np.count_nonzero(height[cells] <= 0.0, axis=1)


def _odd_first(
    cells: np.ndarray, owner: np.ndarray, height: np.ndarray, n_inside: int
) -> tuple[np.ndarray, np.ndarray]:
    """Select the cells with ``n_inside`` corners at height <= 0; return them with the element that each belongs to.

    The corners are rotated so that the one that is alone on its side of the cut comes first.
    """
    chosen = _inside(cells, height) == n_inside
    picked = cells[chosen]
    is_inside = height[picked] <= 0.0
    alone = np.argmax(is_inside if n_inside == 1 else ~is_inside, axis=1)
    turned = (np.arange(cells.shape[1]) + alone[:, None]) % cells.shape[1]
    return np.take_along_axis(picked, turned, axis=1), owner[chosen]


def _edges(*pairs: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Stack three pairs of arrays (m,) to triangles (m, 3, 2): the two ends of the mesh edge on which each corner lies."""
    return np.stack([np.stack(pair, axis=-1) for pair in pairs], axis=1)


def _piece(corners: np.ndarray, owner: np.ndarray, height: np.ndarray) -> Piece:
    """Build a piece from triangles (m, 3, 2), with each point stored once."""
    ends, number = np.unique(np.sort(corners, axis=2).reshape(-1, 2), axis=0, return_inverse=True)
    low, high = height[ends].T
    share = np.divide(low, low - high, out=np.zeros(len(ends)), where=ends[:, 0] != ends[:, 1])
    return Piece(ends, share, number.reshape(-1, 3), owner)
