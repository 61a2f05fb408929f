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
    """Values (n_qp, n_shape) [1]."""
    gradient: np.ndarray
    """Derivatives with respect to local coordinates (n_qp, n_shape, n_local_axes) [1]."""
    weight: np.ndarray
    """Quadrature weights (n_qp,) [1]."""
    points: np.ndarray
    """Local coordinates of the quadrature points (n_qp, n_local_axes) [1]."""
    volume: np.ndarray
    """Basis functions of the projected volume ratio (n_qp, n_volume) [1]."""


def tabulate(element: skfem.Element, local: np.ndarray, weight: np.ndarray, *, linear_volume: bool = False) -> Table:
    """Evaluate the element's shape functions at local points (n_local_axes, n_qp).

    The basis of the projected volume ratio is constant in an element, or linear with ``linear_volume``.
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

    Nodal values are coefficients of the shape functions: those of vertices, then of edge midpoints, then of one bubble per
    triangle (0 for straight geometry, since the bubble is added to the P2 functions). Positions and displacements are
    (n_nodes, 3) arrays over the same nodes; the third component is the out-of-plane displacement, so that gravity may have
    any direction.

    Parameters
    ----------
    mesh : skfem.MeshTri
        Vertices in the section's own axes [mm].
    quadrature_order : int
        Polynomial degree for which the quadrature rule of each triangle is exact.
    """

    mesh: skfem.MeshTri
    quadrature_order: int = 5

    @property
    def kind(self) -> tuple:
        """Hashable key of element type and quadrature order; spaces with equal keys have equal tables."""
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
        """Number of nodes: vertices, edge midpoints and bubbles."""
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
        """Positions of the undeformed mesh as nodal coefficients, 0 for bubbles (n_nodes, 3) [mm]."""
        out = np.zeros((self.n_nodes, 3))
        out[self._dofs.nodal_dofs[0], :2] = self.mesh.p.T
        out[self._dofs.facet_dofs[0], :2] = self.mesh.p[:, self.mesh.facets].mean(axis=1).T
        return out

    def facet_nodes(self, facets: np.ndarray) -> np.ndarray:
        """Return the nodes of edges with given numbers: (n,) -> (n, 3) vertex, vertex, midpoint."""
        ends = self._dofs.nodal_dofs[0][self.mesh.facets[:, facets]]
        return np.column_stack([ends.T, self._dofs.facet_dofs[0][facets]])

    @cached_property
    def bubbles(self) -> np.ndarray:
        """Bubble node of each triangle (n_elements,)."""
        return self._dofs.interior_dofs[0]

    @cached_property
    def corner_table(self) -> Table:
        """Linear shape functions of the corners, at the same quadrature points."""
        return tabulate(skfem.ElementTriP1(), *get_quadrature(skfem.MeshTri.elem, self.quadrature_order))

    @property
    def corners(self) -> np.ndarray:
        """Nodes at the corners of each triangle (n_elements, 3)."""
        return self.element_nodes[:, :3]

    @property
    def n_axes(self) -> int:
        """Number of spatial axes of the elements."""
        return 2

    @property
    def geometric_nodes(self) -> np.ndarray:
        """Geometric nodes of each triangle (n_elements, 6), all but the bubble; their numbers are below ``n_geometric_nodes``."""
        return self.element_nodes[:, :6]

    @property
    def n_geometric_nodes(self) -> int:
        """Number of geometric nodes: vertices and edge midpoints."""
        return int(self.bubbles[0])

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Elements on either side of each inner edge (2, n_edges)."""
        return self.mesh.f2t[:, self.mesh.f2t[1] >= 0]


@dataclass(frozen=True, eq=False)
class SolidSpace:
    """Solid: P2 tetrahedra, straight or curved (the geometry is quadratic too).

    With the four points of the default rule this is the standard quadratic element of other codes, except for tissue so
    nearly incompressible that it would lock: see :func:`.elements.fluctuation_fraction` and docs/decisions/0013.

    Parameters
    ----------
    positions : (n_nodes, 3) array [mm]
        Positions of the nodes.
    element_nodes : (n_elements, 10) int array
        Corners, then midpoints of the edges 01, 12, 02, 03, 13, 23 (the order of VTK); corner 3 lies on the side of
        the face 012 that its right-handed normal points to.
    quadrature_order : int
        Polynomial degree for which the quadrature rule of each tetrahedron is exact.
    """

    positions: np.ndarray
    element_nodes: np.ndarray
    quadrature_order: int = 2

    @property
    def kind(self) -> tuple:
        """Hashable key of element type and quadrature order; spaces with equal keys have equal tables."""
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
        """Shape functions of a boundary face (corners, then midpoints of the edges 01, 12, 02) at its quadrature points.

        The quadrature is exact for pressure on a curved face; with a lower order the forces would not derive from a potential.
        """
        return tabulate(skfem.ElementTriP2(), *get_quadrature(skfem.MeshTri.elem, 4))

    @cached_property
    def boundary(self) -> np.ndarray:
        """Nodes of the boundary faces (n_faces, 6)."""
        return boundary(self.element_nodes)

    def facet_nodes(self, facets: np.ndarray) -> np.ndarray:
        """Nodes of the boundary faces with given numbers: (n,) -> (n, 6)."""
        return self.boundary[facets]

    @cached_property
    def corner_table(self) -> Table:
        """Linear shape functions of the corners, at the same quadrature points."""
        return tabulate(skfem.ElementTetP1(), *get_quadrature(skfem.MeshTet.elem, self.quadrature_order))

    @property
    def corners(self) -> np.ndarray:
        """Nodes at the corners of each tetrahedron (n_elements, 4)."""
        return self.element_nodes[:, :4]

    @property
    def n_axes(self) -> int:
        """Number of spatial axes of the elements."""
        return 3

    @property
    def geometric_nodes(self) -> np.ndarray:
        """Geometric nodes of each tetrahedron (n_elements, 10): all its nodes."""
        return self.element_nodes

    @property
    def n_geometric_nodes(self) -> int:
        """Number of geometric nodes: all nodes."""
        return self.n_nodes

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Elements on either side of each inner face (2, n_faces)."""
        return neighbours(self.element_nodes)


@dataclass(frozen=True, eq=False)
class Sheet:
    """Flat sheet of bilinear quadrilaterals, for laws that preserve volume by adapting the thickness, which avoids locking.

    Parameters
    ----------
    positions : (n_nodes, 3) array [mm]
        Positions of the nodes; the third component is 0.
    element_nodes : (n_elements, 4) int array
        Corners of each quadrilateral, in order around it.
    quadrature_order : int
        Polynomial degree along each side for which the quadrature rule is exact.
    """

    positions: np.ndarray
    element_nodes: np.ndarray
    quadrature_order: int = 3

    @property
    def kind(self) -> tuple:
        """Hashable key of element type and quadrature order; spaces with equal keys have equal tables."""
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
        """Same as ``table``, since all nodes are corners."""
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
        """Nodes of the boundary edges with given numbers: (n,) -> (n, 2)."""
        return self.boundary[facets]

    @property
    def n_axes(self) -> int:
        """Number of spatial axes of the elements."""
        return 2

    @property
    def geometric_nodes(self) -> np.ndarray:
        """Geometric nodes of each quadrilateral (n_elements, 4): all its nodes."""
        return self.element_nodes

    @property
    def n_geometric_nodes(self) -> int:
        """Number of geometric nodes: all nodes."""
        return self.n_nodes

    @cached_property
    def neighbours(self) -> np.ndarray:
        """Elements on either side of each inner edge (2, n_edges)."""
        sides = np.sort(self.element_nodes[:, [[0, 1], [1, 2], [2, 3], [3, 0]]].reshape(-1, 2), axis=1)
        owner = np.repeat(np.arange(self.n_elements), 4)
        order = np.lexsort(sides.T)
        sides, owner = sides[order], owner[order]
        twice = np.flatnonzero((sides[1:] == sides[:-1]).all(axis=1))
        return np.stack([owner[twice], owner[twice + 1]])


AnySpace = Space | SolidSpace | Sheet
