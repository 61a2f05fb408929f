"""Bodies of the two reference wounds: a square sheet with a round wound, and a hemisphere with an ellipsoidal cavity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import skfem

from ...geometry.bcc import bcc_lattice
from ...geometry.meshing import INSIDE
from ...geometry.solid import Solid, fitted, remesh, split
from ...geometry.tetrahedra import boundary, far_origin, used_only, with_middles
from ...materials.neo_hookean import NeoHookean
from ...mechanics.body import Body, Discretization, measures
from ...mechanics.solids import solid_space
from ...mechanics.space import AnySpace, Sheet, SolidSpace

SIDE_MM, WOUND_MM, BLEND_MM = (
    100.0,
    7.5,
    5.0,
)  # side of the square, radius of the wound, width of the transition to healthy tissue
N_RING = 720  # material points on the wound's edge
BREAST_MM = 65.0  # radius of the half ball: 575 ml
CAVITY_MM = np.array([25.0, 22.0, 20.4])  # semi-axes: 47 ml, the clinical mean three to eight weeks after surgery
CAVITY_CENTRE_MM = np.array([0.0, 0.0, 30.0])
BLEND_SOLID_MM = 5.0  # width of the transition from the cavity to healthy tissue
FINENESS = 0.6  # edge length at the cavity over that far away
TISSUE_KG_MM3 = 1e-6  # any value: without gravity it has no effect


@dataclass(frozen=True, eq=False)
class MaterialPoints:
    """Material points of a body, at which fields are evaluated."""

    elements: np.ndarray
    """Element of each point (n,)."""
    shares: np.ndarray
    """Shape functions of the element's corners at each point (n, a)."""

    def values(self, corners: np.ndarray) -> np.ndarray:
        """Interpolate a field from the a corners of each element to the material points: (n_elements, a, ...) -> (n, ...)."""
        return np.einsum("pa,pa...->p...", self.shares, corners[self.elements])

    def mean(self, corners: np.ndarray) -> float:
        """Return the mean over the material points of a field given at the corners of the elements (n_elements, a)."""
        return float(self.values(corners).mean())


class Healthy(NamedTuple):
    """Fraction of healthy tissue: 0 in the wound, 1 far from the wound."""

    corners: np.ndarray
    """Fraction at the vertex nodes, in ascending order (n,) [1]."""
    points: np.ndarray
    """Fraction at quadrature points (n_elements, n_qp) [1]."""

    @classmethod
    def of(cls, space: AnySpace, at: Callable[[np.ndarray], np.ndarray]) -> Healthy:
        """Evaluate the fraction ``at``, a function of positions (n, 3) [mm] -> (n,) [1], at vertices and quadrature points."""
        X, table = space.positions, space.corner_table
        points = np.einsum("qa,eai->eqi", table.value, X[space.corners])
        return cls(at(X[np.unique(space.corners)]), at(points.reshape(-1, 3)).reshape(points.shape[:2]))


@dataclass(frozen=True, eq=False)
class WoundBody:
    """Mesh of a body with a wound, and the points and measures of the wound."""

    discretization: Discretization
    X: np.ndarray
    """Reference positions (n_nodes, 3) [mm]."""
    fixed_vertices: np.ndarray
    """Vertex nodes with fixed cell density and cytokine concentration, as indices into the sorted vertex nodes."""
    healthy: Healthy
    """Fraction of healthy tissue."""
    centre: MaterialPoints
    """Point at the centre of the wound."""
    edge: MaterialPoints
    """Points along the edge of the wound."""
    size: Callable[[np.ndarray], float]
    """Area or volume of the material that formed the initial wound, at positions (n_nodes, 3) [mm]."""
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Point of the given mesh about which the positions are (3,) [mm]."""

    def given(self, x: np.ndarray) -> np.ndarray:
        """Return positions (n, 3) [mm] in the coordinates of the given mesh."""
        return x + self.origin if self.origin.any() else x

    @property
    def middle_mm(self) -> float:
        """Coordinate y of the plane y = constant through the wound's centre [mm]."""
        return float(self.X[self.discretization.space.corners[self.centre.elements[0]], 1].mean())

    def placeholder_body(self) -> Body:
        """Return the body with a placeholder law and without skin; the healing model sets its own law."""
        space = self.discretization.space
        shape = space.n_elements, space.table.weight.size
        filler = NeoHookean(1.0, 1.0)
        n_facets = len(self.discretization.skin_facets)
        return Body(
            self.discretization, filler, np.full(shape, TISSUE_KG_MM3), np.ones(shape[0]), filler, np.zeros(n_facets)
        )


def smoother_step(x: np.ndarray) -> np.ndarray:
    """Evaluate a smooth step: 0 below 0, 1 above 1, with two continuous derivatives."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (x * (6.0 * x - 15.0) + 10.0)


def sheet_with_wound(n: int) -> WoundBody:
    """Build a clamped square of n x n quadrilaterals with a wound of radius 7.5 mm; cells and cytokine are fixed at its edge."""
    line = np.linspace(-0.5 * SIDE_MM, 0.5 * SIDE_MM, n + 1)
    mesh = skfem.MeshQuad.init_tensor(line, line)
    X = np.zeros((mesh.p.shape[1], 3))
    X[:, :2] = mesh.p.T
    space = Sheet(X, np.ascontiguousarray(mesh.t.T))
    border = np.unique(space.boundary)
    angle = np.linspace(0.0, 2.0 * np.pi, N_RING, endpoint=False)
    ring = _points_in_squares(line, WOUND_MM * np.stack([np.cos(angle), np.sin(angle)], axis=-1), space)

    def area(x: np.ndarray) -> float:
        (a, b, _), (c, d, _) = ring.values(x[space.corners]).T, np.roll(ring.values(x[space.corners]), -1, axis=0).T
        return 0.5 * float(np.sum(a * d - b * c))

    return WoundBody(
        Discretization(space, np.zeros(0, int), border),
        X,
        border,
        Healthy.of(space, lambda x: smoother_step((np.linalg.norm(x[:, :2], axis=1) - WOUND_MM) / BLEND_MM)),
        _points_in_squares(line, np.zeros((1, 2)), space),
        ring,
        area,
    )


def _points_in_squares(line: np.ndarray, points: np.ndarray, space: Sheet) -> MaterialPoints:
    """Locate points (n, 2) [mm] in a mesh of equal squares between grid lines ``line`` [mm]."""
    low, step, n = line[0], line[1] - line[0], len(line) - 1
    cell = np.clip(((points - low) / step).astype(int), 0, n - 1)
    corner = low + step * cell
    centres = space.positions[space.corners].mean(axis=1)[:, :2]
    square = ((centres - low) / step).astype(int)
    number = np.empty((n, n), int)
    number[square[:, 0], square[:, 1]] = np.arange(space.n_elements)
    elements = number[cell[:, 0], cell[:, 1]]
    local = (points - corner) / step
    at = (space.positions[space.corners[elements]][:, :, :2] - corner[:, None]) / step  # 0 or 1
    shares = np.where(at > 0.5, local[:, None], 1.0 - local[:, None]).prod(axis=-1)
    return MaterialPoints(elements, shares)


def breast_with_cavity(n: int) -> WoundBody:
    """Build a half ball fixed on the chest wall, with an ellipsoidal cavity whose border lies on faces of elements.

    Edges are about 1 / n of the diameter, shorter at the cavity. Cells and cytokine have no prescribed values: no flux passes the
    skin or the chest wall, so that healthy tissue drifts to its own steady state.
    """
    nodes, tetrahedra, is_cavity = _half_ball(2.0 * BREAST_MM / n)
    space = SolidSpace(*with_middles(nodes, tetrahedra))
    constrained_nodes = np.unique(
        space.boundary[np.isclose(space.positions[space.boundary][..., 2], 0.0, atol=1e-9).all(axis=1)]
    )
    healthy = Healthy.of(space, lambda x: smoother_step(ellipsoid(x) / BLEND_SOLID_MM))
    return _solid_with_wound(space, constrained_nodes, is_cavity, healthy, CAVITY_CENTRE_MM)


def meshed_wound(points: np.ndarray, tetrahedra: np.ndarray, is_fixed: np.ndarray, is_wound: np.ndarray) -> WoundBody:
    """Build a body with a wound from a mesh whose nodes and tetrahedra are marked as fixed and as wound.

    points (n, 3) [mm], tetrahedra (m, 4) or (m, 10), is_fixed (n,) bool, is_wound (m,) bool. At the vertices between wound and
    healthy tissue the fraction of healthy tissue is one half.
    """
    origin = far_origin(points)
    space, fixed_nodes = solid_space(points - origin, tetrahedra, is_fixed)
    corners = np.unique(space.corners)
    touched, beyond = np.isin(corners, space.corners[is_wound]), np.isin(corners, space.corners[~is_wound])
    at_points = np.broadcast_to(np.where(is_wound, 0.0, 1.0)[:, None], (len(is_wound), space.table.weight.size))
    healthy = Healthy(np.where(touched, np.where(beyond, 0.5, 0.0), 1.0), at_points)
    centre = space.positions[space.corners[is_wound]].mean(axis=(0, 1))
    return replace(_solid_with_wound(space, fixed_nodes, is_wound, healthy, centre), origin=origin)


def _solid_with_wound(
    space: SolidSpace, constrained_nodes: np.ndarray, is_wound: np.ndarray, healthy: Healthy, centre: np.ndarray
) -> WoundBody:
    inside, border = np.flatnonzero(is_wound), _faces_between(space.corners, is_wound)
    return WoundBody(
        discretization=Discretization(space, np.zeros(0, int), constrained_nodes),
        X=space.positions,
        fixed_vertices=np.zeros(0, int),
        healthy=healthy,
        centre=_nearest(space, centre),
        edge=MaterialPoints(border, np.full((len(border), 4), 0.25)),
        size=lambda x: float(measures(space, x)[inside].sum()),
    )


def ellipsoid(x: np.ndarray) -> np.ndarray:
    """Approximate the signed distance to the cavity's border to first order, negative inside: (n, 3) [mm] -> (n,) [mm]."""
    y = x - CAVITY_CENTRE_MM
    size = np.linalg.norm(y / CAVITY_MM, axis=1)
    slope = np.linalg.norm(y / CAVITY_MM**2, axis=1)
    return np.where(slope > 1e-12, size * (size - 1.0) / np.maximum(slope, 1e-12), -CAVITY_MM.min())


def _half_ball(edge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mesh the half ball: return nodes (n, 3) [mm], tetrahedra (m, 4), and which tetrahedra form the cavity (m,) bool."""

    def ball(x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(x, axis=1) - BREAST_MM

    def size(x: np.ndarray) -> np.ndarray:
        return edge * np.clip(FINENESS + (np.abs(ellipsoid(x)) - 8.0) / 60.0, FINENESS, 1.0)

    box = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]]) * (BREAST_MM + edge)
    points, tetrahedra = bcc_lattice(box[0], box[1], edge)
    none = np.zeros((0, 3), np.int32)
    level = ball(points)
    level = np.copysign(np.maximum(np.abs(level), 0.1 * edge), level)
    touching = tetrahedra[(level[tetrahedra] < 0).any(axis=1)]
    level = level[np.unique(touching)]
    nodes, tetrahedra = used_only(points, touching)
    body = Solid(nodes, tetrahedra, np.zeros(len(tetrahedra), np.int32), none, none[:, 0], box)
    body = split(body, level).inside().with_flat_faces()
    for cut in (False, True):
        body = remesh(body, size(body.nodes), 0.02 * edge)
        body = fitted(body, _round_faces(body), ball)
        if not cut:
            body = split(body, ellipsoid(body.nodes))
    body = fitted(body, boundary(body.tetrahedra[body.refs == INSIDE]), ellipsoid)
    return body.nodes, body.tetrahedra, body.refs == INSIDE


def _round_faces(body: Solid) -> np.ndarray:
    faces = boundary(body.tetrahedra)
    return faces[~body.is_flat(faces)]


def _nearest(space: AnySpace, point: np.ndarray) -> MaterialPoints:
    centres = space.positions[space.corners].mean(axis=1)
    element = int(np.linalg.norm(centres - point, axis=1).argmin())
    return MaterialPoints(np.array([element]), np.full((1, space.corners.shape[1]), 1.0 / space.corners.shape[1]))


def _faces_between(tetrahedra: np.ndarray, is_cavity: np.ndarray) -> np.ndarray:
    """Return the cavity's tetrahedra with at least three corners on the cavity's border, as indices (n,)."""
    outside = np.zeros(tetrahedra.max() + 1, bool)
    outside[tetrahedra[~is_cavity]] = True
    return np.flatnonzero(is_cavity & (outside[tetrahedra].sum(axis=1) >= 3))
