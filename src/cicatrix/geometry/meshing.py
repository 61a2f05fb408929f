"""Triangle mesh of a section from level sets on pixels, with a conforming meshed cavity (MMG)."""

from __future__ import annotations

from collections.abc import Callable

import mmgpy
import numpy as np
import skfem
from scipy.ndimage import distance_transform_edt, gaussian_filter, label, map_coordinates

from ..core.errors import InputError
from ..core.posix_signals import restored_signals
from .borders import Border, BorderAt
from .section import Raster

INSIDE = 3  # MMG's reference number for the negative side of a level set
HAUSDORFF_MM = 0.2  # largest distance of straight edges from the outline, below the resolution of an image
Function = Callable[[np.ndarray], np.ndarray]


def signed_distance(mask: np.ndarray, pixel_mm: float, smooth_mm: float = 1.3) -> np.ndarray:
    """Return the smoothed signed distance of each pixel to the border of a mask, negative inside: (ny, nx) bool -> (ny, nx) [mm].

    The standard deviation ``smooth_mm`` of the smoothing, about the thickness of skin, removes the pixel steps of the image.
    """
    outside, inside = distance_transform_edt(~mask), distance_transform_edt(mask)
    return pixel_mm * gaussian_filter(np.where(mask, 0.5 - inside, outside - 0.5), smooth_mm / pixel_mm, mode="nearest")  # pyright: ignore[reportOperatorIssue]


def component_at(mask: np.ndarray, row: int, column: int) -> np.ndarray:
    """Return the connected component of a mask that contains a pixel, or the largest one if the pixel is not in the mask."""
    parts, n = label(mask)  # pyright: ignore[reportGeneralTypeIssues]
    if n == 0:
        raise InputError("The section holds no breast: choose another image.slice_mm.")
    inside = 0 <= row < mask.shape[0] and 0 <= column < mask.shape[1] and parts[row, column]
    chosen = parts[row, column] if inside else 1 + np.argmax(np.bincount(parts.ravel())[1:])
    return parts == chosen


def interpolant(field: np.ndarray, raster: Raster) -> Function:
    """Return a function that interpolates a pixel field linearly: points (n, 2) [mm] -> (n,)."""
    return lambda points: map_coordinates(field, raster.index(points), order=1, mode="nearest")


def mesh_section(
    body: Function, cavity: Function | None, low: np.ndarray, high: np.ndarray, edge_mm: float, cavity_edge_mm: float
) -> skfem.MeshTri:
    """Mesh the region body < 0, with the border of the region cavity < 0 on element edges.

    Parameters
    ----------
    body, cavity : callable
        Signed distances [mm] at points (n, 2) [mm]; without a cavity, None.
    low, high : (2,) array [mm]
        Corners of a box that contains the body.
    edge_mm, cavity_edge_mm : float
        Element edge far from and at the border of the cavity [mm].

    Returns
    -------
    skfem.MeshTri
        Mesh with the subdomain "cavity".

    Raises
    ------
    InputError
        If the mesh has no body or no cavity, or an element is degenerate.
    """
    start = min(cavity_edge_mm, 1.0)
    points, triangles = _triangular_grid(low - 3 * start, high + 3 * start, start)
    mesh = mmgpy.MmgMesh2D(points, triangles)
    points, triangles, refs = _cut(mesh, body(points), hmin=0.25 * start, hmax=start, hausd=HAUSDORFF_MM)
    points, triangles = _keep(points, triangles[refs == INSIDE])
    border = cavity if cavity is not None else (lambda p: np.full(len(p), 1e3))
    mesh = mmgpy.MmgMesh2D(points, triangles.astype(np.int32))
    distance = border(points)
    mesh["metric"] = element_sizes(distance, edge_mm, cavity_edge_mm)[:, None]
    sizes = {"hmin": 0.3 * cavity_edge_mm, "hmax": edge_mm, "hgrad": 1.3}
    points, triangles, refs = _cut(mesh, distance, hausd=HAUSDORFF_MM, **sizes)
    _check(points, triangles, cavity is None or bool((refs == INSIDE).any()))
    out = skfem.MeshTri(np.ascontiguousarray(points.T), np.ascontiguousarray(triangles.T.astype(np.int64)))
    return out.with_subdomains({"cavity": np.flatnonzero(refs == INSIDE)})


def label_borders(mesh: skfem.MeshTri, border: BorderAt) -> skfem.MeshTri:
    """Name the outer edges "skin", "wall" or "rim", by the `Border` at the point (n, 2) [mm] 1 mm outside their midpoints."""
    facets = mesh.boundary_facets()
    ends = mesh.p[:, mesh.facets[:, facets]]
    middle, along = ends.mean(axis=1).T, (ends[:, 1] - ends[:, 0]).T
    inner = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    normal *= np.sign(np.sum((middle - inner) * normal, axis=1))[:, None]
    found = border(middle + normal)
    kinds = {"wall": Border.WALL, "skin": Border.SKIN, "rim": Border.RIM}
    return mesh.with_boundaries({name: facets[found == kind] for name, kind in kinds.items()})


def element_sizes(distance: np.ndarray, edge_mm: float, cavity_edge_mm: float) -> np.ndarray:
    """Return element edges that grow with the distance from the border of the cavity: distance (n,) [mm] -> (n,) [mm]."""
    return np.clip(
        cavity_edge_mm + 0.2 * np.maximum(np.abs(distance) - 2.0 * cavity_edge_mm, 0.0), cavity_edge_mm, edge_mm
    )


def _cut(mesh: mmgpy.MmgMesh2D, level_set: np.ndarray, **options: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    with restored_signals():
        mesh.remesh_levelset(np.ascontiguousarray(level_set, float)[:, None], verbose=-1, **options)
    triangles, refs = mesh.get_triangles_with_refs()
    return mesh.get_vertices(), triangles, refs


def _keep(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not len(triangles):
        raise InputError("The section holds no breast: choose another image.slice_mm.")
    used, renumbered = np.unique(triangles, return_inverse=True)
    return points[used], renumbered.reshape(-1, 3)


def _check(points: np.ndarray, triangles: np.ndarray, has_cavity: bool) -> None:
    if not has_cavity:
        raise InputError("The resection leaves no cavity on the mesh: move resection.centre_mm inside the breast.")
    a, b, c = points[triangles].transpose(1, 0, 2)
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    if np.abs(area).min() < 1e-6:
        raise InputError("The mesh of the section has a degenerate triangle: choose a smaller mesh.edge_mm.")


def _triangular_grid(low: np.ndarray, high: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Fill a box with nearly equilateral triangles of about a given edge [mm]: points (n, 2) [mm], triangles (m, 3) int32."""
    nx, ny = (int(np.ceil(extent)) + 1 for extent in (high - low) / edge / (1.0, 0.866))
    j, i = np.mgrid[:ny, :nx]
    points = np.stack([low[0] + edge * (i + 0.5 * (j % 2)), low[1] + 0.866 * edge * j], axis=-1).reshape(-1, 2)
    n = j * nx + i
    a, b, c, d = n[:-1, :-1], n[:-1, 1:], n[1:, :-1], n[1:, 1:]
    even = (j[:-1, :-1] % 2 == 0)[..., None]
    lower = np.where(even, np.stack([a, b, c], -1), np.stack([a, d, c], -1))
    upper = np.where(even, np.stack([b, d, c], -1), np.stack([a, b, d], -1))
    return points, np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)]).astype(np.int32)
