"""Transfer between a mesh and a lattice: the element of each site, and fields evaluated at the sites."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .hexgrid import Lattice
from .tetrahedra import EDGES

# nodes of the four straight triangles that replace a P2 triangle (vertices 0 1 2, midside nodes 3 = 01, 4 = 12, 5 = 02)
QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
LOCAL = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])
# nodes of the eight straight tetrahedra that replace a P2 tetrahedron: four at the corners, four from the octahedron between
# them, which is cut along its diagonal from the middle of edge 01 to that of edge 23
EIGHTHS = np.array(
    [[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3], [4, 9, 6, 5], [4, 9, 5, 8], [4, 9, 8, 7], [4, 9, 7, 6]]
)
CORNERS = np.vstack([np.zeros(3), np.eye(3)])
LOCAL_SOLID = np.vstack([CORNERS, [(CORNERS[i] + CORNERS[j]) / 2 for i, j in EDGES]])
OUTSIDE = -1
ON_FACE = 1e-9  # tolerance of barycentric coordinates: sites outside by less count as inside
PIECES_AT_ONCE = 2048  # number of straight tetrahedra per batch
SITES_AT_ONCE = 2**20  # number of sites per batch; with both limits work arrays stay below 100 MB


@dataclass(frozen=True, eq=False)
class SiteMap:
    """Element and local coordinates of every site of a lattice.

    Each site belongs to exactly one element or to none, so counts per element add up to the number of sites inside.

    Parameters
    ----------
    element : (n_sites,) int array
        Element index of each site, OUTSIDE (-1) if the site is in no element.
    local : (n_inside, 2 or 3) array [1]
        Local coordinates, in the reference triangle or tetrahedron, of the sites in an element, in the order of the sites.
    n_elements : int
        Number of elements of the mesh.
    """

    element: np.ndarray
    local: np.ndarray
    n_elements: int

    @cached_property
    def inside(self) -> np.ndarray:
        """Indices of the sites that are in an element (n_inside,)."""
        return np.flatnonzero(self.element != OUTSIDE)

    def count(self, chosen: np.ndarray) -> np.ndarray:
        """Count the chosen sites in each element: (n_sites,) bool -> (n_elements,) int."""
        return np.bincount(self.element[chosen & (self.element != OUTSIDE)], minlength=self.n_elements)

    def evaluate(self, coefficients: np.ndarray) -> np.ndarray:
        """Evaluate an element-wise linear field at the sites: coefficients (n_elements, 3 or 4) -> (n_sites,); 0 outside."""
        centre = 1.0 / coefficients.shape[1]
        values = np.zeros(len(self.element))
        for start in range(0, len(self.inside), SITES_AT_ONCE):
            some = slice(start, start + SITES_AT_ONCE)
            c = coefficients[self.element[self.inside[some]]]
            values[self.inside[some]] = c[:, 0] + np.sum(c[:, 1:] * (self.local[some] - centre), axis=1)
        return values


def locate_sites(positions: np.ndarray, sites: np.ndarray) -> SiteMap:
    """Find the triangle of each site.

    Parameters
    ----------
    positions : (n_elements, 6, 2) array [mm]
        Nodes of P2 triangles; each curved edge is approximated by two straight halves.
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
    return SiteMap(element, local[element != OUTSIDE], len(positions))


def locate_lattice(positions: np.ndarray, lattice: Lattice, box: np.ndarray) -> SiteMap:
    """Find the tetrahedron of each site of a lattice by intersecting the lines of sites with the tetrahedra.

    Parameters
    ----------
    positions : (n_elements, 10, 3) array [mm]
        Nodes of P2 tetrahedra; each is replaced by eight straight ones, so that neighbours agree on their common face.
    lattice : Lattice
        Lattice with three axes.
    box : (2, 3) array [mm]
        Low and high corner; sites outside are left out, because the block of a lattice is sheared and extends further.
    """
    element = np.full(lattice.n_sites, OUTSIDE, np.int32)
    near = np.flatnonzero(((positions.max(axis=1) >= box[0]) & (positions.min(axis=1) <= box[1])).all(axis=1))
    corners = lattice.index(positions[near][:, EIGHTHS]).reshape(-1, 4, 3)
    found = [(np.zeros(0, np.int64), np.zeros((0, 3), np.float32))]
    for start in range(0, len(corners), PIECES_AT_ONCE):
        piece, index, weights = _sites_in(corners[start : start + PIECES_AT_ONCE], lattice.shape)
        at = lattice.position(index)
        site = np.asarray(np.ravel_multi_index(tuple(index.T), lattice.shape))
        new = np.flatnonzero((element[site] == OUTSIDE) & ((at >= box[0]) & (at <= box[1])).all(axis=1))
        _, first = np.unique(site[new], return_index=True)  # a site on a face belongs to the first element
        new, number = new[first], start + piece[new[first]]
        element[site[new]] = near[number // len(EIGHTHS)]
        local = np.einsum("na,nai->ni", weights[new], LOCAL_SOLID[EIGHTHS[number % len(EIGHTHS)]])
        found.append((site[new], local.astype(np.float32)))
    order = np.argsort(np.concatenate([site for site, _ in found]))
    return SiteMap(element, np.concatenate([local for _, local in found])[order], len(positions))


def _sites_in(corners: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the sites in straight tetrahedra.

    Corners (n, 4, 3) in site indices -> for each of k pairs: tetrahedron (k,), site (k, 3), barycentric weights (k, 4).
    """
    edges = corners[:, 1:] - corners[:, :1]
    is_flat = np.abs(np.linalg.det(edges)) < 1e-12
    slope = np.linalg.inv(np.where(is_flat[:, None, None], np.eye(3), edges))  # gradient of the last three weights
    slope = np.concatenate([-slope.sum(axis=2, keepdims=True), slope], axis=2)
    offset = np.eye(1, 4) - np.einsum("ni,nia->na", corners[:, 0], slope)
    last = np.array(shape) - 1
    low = np.maximum(np.ceil(corners.min(axis=1) - ON_FACE), 0).astype(int)
    high = np.minimum(np.floor(corners.max(axis=1) + ON_FACE), last).astype(int)
    n_rows = np.where(is_flat[:, None], 0, np.maximum(high - low + 1, 0))[:, :2]
    piece, within = _expanded(n_rows[:, 0] * n_rows[:, 1])
    row = low[piece, :2] + np.stack(np.divmod(within, np.maximum(n_rows[piece, 1], 1)), axis=1)
    start, rate = offset[piece] + np.einsum("ni,nia->na", row, slope[piece, :2]), slope[piece, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -(start + ON_FACE) / rate
    enters = np.where(rate > 0, crossing, np.where((rate == 0) & (start < -ON_FACE), np.inf, -np.inf)).max(axis=1)
    leaves = np.where(rate < 0, crossing, np.inf).min(axis=1)
    first = np.ceil(np.clip(enters, 0, last[2] + 1)).astype(int)
    after = np.floor(np.clip(leaves, -1, last[2])).astype(int) + 1
    line, along = _expanded(np.maximum(after - first, 0))
    k = first[line] + along
    weights = start[line] + k[:, None] * rate[line]
    return piece[line], np.column_stack([row[line], k]), weights


def _expanded(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return, for ``counts`` (n,) items per owner, the owner and the running number of each item: two (sum,) arrays."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def _barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    edges = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]])
    (a, b), (c, d) = edges
    det = a * d - b * c
    r = points - corners[0]
    second, third = (d * r[:, 0] - b * r[:, 1]) / det, (a * r[:, 1] - c * r[:, 0]) / det
    return np.column_stack([1.0 - second - third, second, third])


def linear_fit(values: np.ndarray, weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Fit a linear function in each element by least squares; it preserves the weighted mean.

    Values and weights (n_elements, n_qp) at points with local coordinates (n_qp, 2 or 3) -> coefficients (n_elements, 3 or 4) of
    1 and of the local coordinates relative to the centre of the element.
    """
    basis = np.column_stack([np.ones(len(points)), points - 1.0 / (points.shape[1] + 1)])
    mass = np.einsum("eq,qi,qj->eij", weights, basis, basis)
    return np.linalg.solve(mass, np.einsum("eq,eq,qi->ei", weights, values, basis)[..., None])[..., 0]
