"""Quality criteria of a tetrahedral body mesh, and their measurement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .isosurface import Isosurface
from .meshing import Function
from .tetrahedra import dihedral_angles, volumes

MIN_DIHEDRAL_DEG = 8.0
MAX_VOLUME_ERROR = 0.01
SAMPLES = 12  # intervals along the edge of a triangle when distances are measured


@dataclass(frozen=True)
class Quality:
    """Quality measures of a mesh; `faults` compares them with their limits.

    Parameters
    ----------
    least_volume : float
        Smallest volume of an element [mm^3].
    least_dihedral_deg : float
        Smallest dihedral angle of an element [degrees].
    volume, body_volume : float
        Total volume of the elements, and volume of the segmented body [mm^3].
    skin_distance : float
        Hausdorff distance between the skin faces of the mesh and the segmented skin [mm].
    voxel : float
        Longest edge of a voxel, or the size of details that are kept if that is more [mm].
    n_pieces : int
        Number of parts that are not connected through faces.
    is_manifold : bool
        Whether each edge of the surface has two faces, and the faces around each of its nodes form one fan.
    """

    least_volume: float
    least_dihedral_deg: float
    volume: float
    body_volume: float
    skin_distance: float
    voxel: float
    n_pieces: int
    is_manifold: bool

    @property
    def volume_error(self) -> float:
        """Relative error of the mesh volume [1]."""
        return self.volume / self.body_volume - 1

    def faults(self) -> list[str]:
        """Return the criteria that the mesh fails, with values and limits; empty if it passes all."""
        checks = [
            (self.least_volume > 0, f"an element of {self.least_volume:.2g} mm^3 (limit above 0)"),
            (
                self.least_dihedral_deg >= MIN_DIHEDRAL_DEG,
                f"a dihedral angle of {self.least_dihedral_deg:.1f} degrees (at least {MIN_DIHEDRAL_DEG:g})",
            ),
            (
                abs(self.volume_error) <= MAX_VOLUME_ERROR,
                f"a volume off by {100 * self.volume_error:+.2f} % (at most {100 * MAX_VOLUME_ERROR:g})",
            ),
            (
                self.skin_distance <= self.voxel,
                f"skin {self.skin_distance:.2f} mm off (at most one voxel, {self.voxel:.2f})",
            ),
            (self.n_pieces == 1, f"{self.n_pieces} separate pieces (must be one)"),
            (self.is_manifold, "a surface that touches itself"),
        ]
        return [fault for passed, fault in checks if not passed]


def quality(
    nodes: np.ndarray,
    tetrahedra: np.ndarray,
    faces: np.ndarray,
    skin: np.ndarray,
    surfaces: tuple[Isosurface, Isosurface],
    is_skin: Function,
    body_volume: float,
    voxel_mm: float,
) -> Quality:
    """Measure the quality of a tetrahedral body mesh.

    Parameters
    ----------
    nodes, tetrahedra, faces : (n, 3) [mm], (m, 4), (k, 3) array
        Mesh and its outer faces.
    skin : (k,) bool array
        Faces on the skin.
    surfaces : tuple of Isosurface
        Surface as segmented, and smoothed surface. The Hausdorff distance is the larger of the greatest distance from
        skin points of the first to the mesh, and from the mesh to the second.
    is_skin : callable
        Returns for points (n, 3) [mm] of the first surface whether they are on the skin (n,).
    body_volume : float
        Reference value for the volume [mm^3].
    voxel_mm : float
        Longest edge of a voxel, or the size of details that are kept if that is more [mm].
    """
    size = volumes(nodes, tetrahedra)
    segmented, smooth = surfaces
    return Quality(
        least_volume=float(size.min()),
        least_dihedral_deg=float(dihedral_angles(nodes, tetrahedra).min()),
        volume=float(size.sum()),
        body_volume=body_volume,
        skin_distance=_hausdorff(nodes[faces[skin]], segmented.points[is_skin(segmented.points)], nodes[faces], smooth),
        voxel=voxel_mm,
        n_pieces=n_pieces(tetrahedra),
        is_manifold=is_manifold(faces),
    )


def _hausdorff(skin: np.ndarray, segmented: np.ndarray, outer: np.ndarray, smooth: Isosurface) -> float:
    """Return the larger of two greatest distances [mm]: skin faces to smooth surface, segmented skin points to outer faces."""
    there = np.abs(smooth.distance(_samples(skin))).max(initial=0.0)
    back = cKDTree(_samples(outer)).query(segmented)[0].max(initial=0.0)
    return float(max(there, back))


def _samples(triangles: np.ndarray) -> np.ndarray:
    """Return a regular grid of points on triangles, corners and edges included: (k, 3, 3) -> (n, 3)."""
    i, j = (index.ravel() for index in np.indices((SAMPLES + 1, SAMPLES + 1)))
    weights = np.stack([i, j, SAMPLES - i - j], axis=-1)[i + j <= SAMPLES] / SAMPLES
    return np.einsum("wc,kcd->kwd", weights, triangles).reshape(-1, 3)


def n_pieces(elements: np.ndarray) -> int:
    """Return the number of connected parts: tetrahedra (m, 4) joined through faces, or triangles (m, 3) through edges."""
    n_elements, n_corners = elements.shape
    sides = np.concatenate([np.delete(elements, k, axis=1) for k in range(n_corners)])
    _, side = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True)
    owner = np.tile(np.arange(n_elements), n_corners)
    shared = coo_array((np.ones(len(side)), (owner, side.ravel() + n_elements)), shape=(n_elements + len(side),) * 2)
    labels = connected_components(shared, directed=False)[1]
    return len(np.unique(labels[:n_elements]))


def is_manifold(faces: np.ndarray) -> bool:
    """Check whether triangles (k, 3) form closed surfaces that do not touch themselves at an edge or node."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, edge, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    if np.any(count != 2):
        return False
    corner = np.arange(faces.size).reshape(faces.shape)  # corners of triangles that share an edge and a node form a fan
    ends = corner[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ends = np.where(np.take(faces.ravel(), ends[:, :1]) < np.take(faces.ravel(), ends[:, 1:]), ends, ends[:, ::-1])
    first, second = ends[np.argsort(edge.ravel(), kind="stable")].reshape(-1, 2, 2).transpose(1, 0, 2)
    fans = coo_array((np.ones(2 * len(first)), (first.ravel(), second.ravel())), shape=(faces.size, faces.size))
    return connected_components(fans, directed=False)[0] == len(np.unique(faces))
