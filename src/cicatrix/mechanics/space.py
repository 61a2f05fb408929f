"""Finite-element spaces: nodes, elements and shape functions of a plane section, of a solid and of a sheet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem
from skfem.quadrature import get_quadrature

from ..geometry.tetrahedra import boundary, neighbours


@dataclass(frozen=True)
class Table:
    """Shape functions of a reference element at its quadrature points."""

    value: np.ndarray
    """(n_qp, n_shape) [1]"""
    gradient: np.ndarray
    """(n_qp, n_shape, n_local_axes) [1]"""
    weight: np.ndarray
    """(n_qp,) [1]"""
    points: np.ndarray
    """(n_qp, n_local_axes) local coordinates [1]"""
    volume: np.ndarray
    """(n_qp, n_volume) what the volume ratio of an element is made of [1]"""


def tabulate(element: skfem.Element, local: np.ndarray, weight: np.ndarray, *, linear_volume: bool = False) -> Table:
    """Evaluate the element's shape functions at local points (n_local_axes, n_qp).

    The volume ratio of an element is constant, or linear.
    """
    n_shape = len(element.doflocs)
    both = [element.lbasis(local, i) for i in range(n_shape)]
    value = np.stack([np.broadcast_to(v, weight.shape) for v, _ in both], axis=-1)
    gradient = np.stack([np.broadcast_to(g, (local.shape[0], weight.size)).T for _, g in both], axis=1)
    one = np.ones((weight.size, 1))
    volume = np.hstack([one, local.T - 1.0 / 3.0]) if linear_volume else one
    return Table(value, gradient, weight, local.T, volume)


@dataclass(frozen=True, eq=False)
class Space:
    """Plane section: P2 triangles with a cubic bubble on a straight-sided mesh, three displacement components.

    Nodes are coefficients: vertices, then edge midpoints, then one bubble per triangle (hierarchical: 0 where the
    geometry is straight). Positions and displacements are (n_nodes, 3) arrays over the same nodes; the third
    component is the shift out of the plane, so that gravity may point anywhere.

    Parameters
    ----------
    mesh : skfem.MeshTri
        Vertices in the section's own axes [mm].
    quadrature_order : int
        Polynomial degree the rule in each triangle is exact for.
    """

    mesh: skfem.MeshTri
    quadrature_order: int = 5

    @property
    def kind(self) -> tuple:
        """Equal for spaces with equal tables."""
        return "section", self.quadrature_order

    @cached_property
    def _dofs(self) -> skfem.Dofs:
        return skfem.Dofs(self.mesh, skfem.ElementTriP2B())

    @cached_property
    def element_nodes(self) -> np.ndarray:
        """Nodes of each triangle (n_elements, 7): vertices, edges (01, 12, 02), bubble."""
        return np.ascontiguousarray(self._dofs.element_dofs.T)

    @property
    def n_nodes(self) -> int:
        """Number of coefficient nodes."""
        return self._dofs.N

    @property
    def n_elements(self) -> int:
        """Number of triangles."""
        return self.mesh.nelements

    @cached_property
    def table(self) -> Table:
        """Shape functions of the triangle at its quadrature points."""
        rule = get_quadrature(skfem.MeshTri.elem, self.quadrature_order)
        return tabulate(skfem.ElementTriP2B(), *rule, linear_volume=True)

    @cached_property
    def facet_table(self) -> Table:
        """Shape functions of a boundary edge (vertex, vertex, midpoint) at its quadrature points."""
        return tabulate(skfem.ElementLineP2(), *get_quadrature(skfem.MeshLine.elem, self.quadrature_order))

    @cached_property
    def positions(self) -> np.ndarray:
        """Coefficients of the identity map (n_nodes, 3) [mm]."""
        out = np.zeros((self.n_nodes, 3))
        out[self._dofs.nodal_dofs[0], :2] = self.mesh.p.T
        out[self._dofs.facet_dofs[0], :2] = self.mesh.p[:, self.mesh.facets].mean(axis=1).T
        return out

    def facet_nodes(self, facets: np.ndarray) -> np.ndarray:
        """Nodes of mesh edges: facet numbers (n,) -> (n, 3) vertex, vertex, midpoint."""
        ends = self._dofs.nodal_dofs[0][self.mesh.facets[:, facets]]
        return np.column_stack([ends.T, self._dofs.facet_dofs[0][facets]])

    @cached_property
    def bubbles(self) -> np.ndarray:
        """Bubble node of each triangle (n_elements,)."""
        return self._dofs.interior_dofs[0]

    @cached_property
    def corner_table(self) -> Table:
        """Shape functions that are linear between the corners, at the same quadrature points."""
        return tabulate(skfem.ElementTriP1(), *get_quadrature(skfem.MeshTri.elem, self.quadrature_order))

    @property
    def corners(self) -> np.ndarray:
        """Nodes at the corners of each triangle (n_elements, 3)."""
        return self.element_nodes[:, :3]

    @property
    def n_axes(self) -> int:
        """Axes that the elements lie in."""
        return 2

    @property
    def shape_nodes(self) -> np.ndarray:
        """Nodes at which each triangle is (n_elements, 6): all but the bubble; they are the first ``n_shape_nodes``."""
        return self.element_nodes[:, :6]

    @property
    def n_shape_nodes(self) -> int:
        """Number of nodes that are places."""
        return int(self.bubbles[0])

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Elements on both sides of each inner edge (2, n_edges)."""
        return self.mesh.f2t[:, self.mesh.f2t[1] >= 0]


@dataclass(frozen=True, eq=False)
class SolidSpace:
    """Solid: P2 tetrahedra, straight or curved (the geometry is quadratic too).

    With the four points of the default rule this is the plain quadratic element that other codes have, until tissue becomes
    so incompressible that it would lock: see :func:`.elements.kept_share` and docs/decisions/0013.

    Parameters
    ----------
    positions : (n_nodes, 3) array [mm]
        Where the mesh has its nodes.
    element_nodes : (n_elements, 10) int array
        Corners, then the middles of the edges 01, 12, 02, 03, 13, 23 (the order of VTK); corner 3 lies on the side of
        the face 012 that its right-handed normal points to.
    quadrature_order : int
        Polynomial degree the rule in each tetrahedron is exact for.
    """

    positions: np.ndarray
    element_nodes: np.ndarray
    quadrature_order: int = 2

    @property
    def kind(self) -> tuple:
        """Equal for spaces with equal tables."""
        return "solid", self.quadrature_order

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.positions)

    @property
    def n_elements(self) -> int:
        """Number of tetrahedra."""
        return len(self.element_nodes)

    @cached_property
    def table(self) -> Table:
        """Shape functions of the tetrahedron at its quadrature points."""
        rule = get_quadrature(skfem.MeshTet.elem, self.quadrature_order)
        return tabulate(skfem.ElementTetP2(), *rule)

    @cached_property
    def facet_table(self) -> Table:
        """Shape functions of a boundary face (corners, then the middles of the edges 01, 12, 02).

        The rule is exact for pressure on a curved face; with less its forces would be those of no potential.
        """
        return tabulate(skfem.ElementTriP2(), *get_quadrature(skfem.MeshTri.elem, 4))

    @cached_property
    def boundary(self) -> np.ndarray:
        """Nodes of the boundary faces (n_faces, 6)."""
        return boundary(self.element_nodes)

    def facet_nodes(self, facets: np.ndarray) -> np.ndarray:
        """Nodes of boundary faces by their numbers (n,) -> (n, 6)."""
        return self.boundary[facets]

    @cached_property
    def corner_table(self) -> Table:
        """Shape functions that are linear between the corners, at the same quadrature points."""
        return tabulate(skfem.ElementTetP1(), *get_quadrature(skfem.MeshTet.elem, self.quadrature_order))

    @property
    def corners(self) -> np.ndarray:
        """Nodes at the corners of each tetrahedron (n_elements, 4)."""
        return self.element_nodes[:, :4]

    @property
    def n_axes(self) -> int:
        """Axes that the elements lie in."""
        return 3

    @property
    def shape_nodes(self) -> np.ndarray:
        """Nodes at which each tetrahedron is (n_elements, 10): all of them."""
        return self.element_nodes

    @property
    def n_shape_nodes(self) -> int:
        """Number of nodes that are places."""
        return self.n_nodes

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Elements on both sides of each inner face (2, n_faces)."""
        return neighbours(self.element_nodes)


@dataclass(frozen=True, eq=False)
class Sheet:
    """Flat sheet: bilinear quadrilaterals, for tissue whose law keeps its own volume by its thickness, so that nothing locks.

    Parameters
    ----------
    positions : (n_nodes, 3) array [mm]
        Where the mesh has its nodes; the third is 0.
    element_nodes : (n_elements, 4) int array
        Corners, one after the other around each quadrilateral.
    quadrature_order : int
        Polynomial degree along each side that the rule is exact for.
    """

    positions: np.ndarray
    element_nodes: np.ndarray
    quadrature_order: int = 3

    @property
    def kind(self) -> tuple:
        """Equal for spaces with equal tables."""
        return "sheet", self.quadrature_order

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.positions)

    @property
    def n_elements(self) -> int:
        """Number of quadrilaterals."""
        return len(self.element_nodes)

    @cached_property
    def table(self) -> Table:
        """Shape functions of the quadrilateral at its quadrature points."""
        return tabulate(skfem.ElementQuad1(), *get_quadrature(skfem.MeshQuad.elem, self.quadrature_order))

    @property
    def corner_table(self) -> Table:
        """The same: all nodes are corners."""
        return self.table

    @property
    def corners(self) -> np.ndarray:
        """Nodes of each quadrilateral (n_elements, 4)."""
        return self.element_nodes

    @cached_property
    def facet_table(self) -> Table:
        """Shape functions of a boundary edge (vertex, vertex) at its quadrature points."""
        return tabulate(skfem.ElementLineP1(), *get_quadrature(skfem.MeshLine.elem, self.quadrature_order))

    @cached_property
    def boundary(self) -> np.ndarray:
        """Nodes of the boundary edges (n_edges, 2)."""
        sides = np.sort(self.element_nodes[:, [[0, 1], [1, 2], [2, 3], [3, 0]]].reshape(-1, 2), axis=1)
        edges, count = np.unique(sides, axis=0, return_counts=True)
        return edges[count == 1]

    def facet_nodes(self, facets: np.ndarray) -> np.ndarray:
        """Nodes of boundary edges by their numbers (n,) -> (n, 2)."""
        return self.boundary[facets]

    @property
    def n_axes(self) -> int:
        """Axes that the elements lie in."""
        return 2

    @property
    def shape_nodes(self) -> np.ndarray:
        """Nodes at which each quadrilateral is (n_elements, 4): all of them."""
        return self.element_nodes

    @property
    def n_shape_nodes(self) -> int:
        """Number of nodes that are places."""
        return self.n_nodes

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Elements on both sides of each inner edge (2, n_edges)."""
        sides = np.sort(self.element_nodes[:, [[0, 1], [1, 2], [2, 3], [3, 0]]].reshape(-1, 2), axis=1)
        owner = np.repeat(np.arange(self.n_elements), 4)
        order = np.lexsort(sides.T)
        sides, owner = sides[order], owner[order]
        twice = np.flatnonzero((sides[1:] == sides[:-1]).all(axis=1))
        return np.stack([owner[twice], owner[twice + 1]])


AnySpace = Space | SolidSpace | Sheet
