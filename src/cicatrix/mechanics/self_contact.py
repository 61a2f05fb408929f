"""Contact of skin with skin: a barrier that keeps two places of the skin apart, in a section and in a solid.

The potential is that of Li et al. (2020, Incremental Potential Contact, Eqs 4 and 6) in the form that converges with the mesh
(Li et al. 2023, Convergent Incremental Potential Contact): an integral over the skin of a barrier of the distance to the
nearest other skin. In solids it is the sum over all close pairs of the first paper instead, as the other form jumps there
where edges are exactly parallel. Distances, their derivatives and the search are those of IPC Toolkit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from ..core.deferred import Deferred
from ..core.errors import InputError
from .space import AnySpace

if TYPE_CHECKING:
    import ipctk
else:
    ipctk = Deferred("ipctk")

DISTANCE_MM = 0.5  # distance below which skin repels skin
STIFFNESS_KPA = 1.0  # the weight of a breast, about 1 kPa, then leaves a gap of three quarters of the distance
SAFE_SHARE = 0.9  # share of the way to a collision that a step may go
HALVES = np.array([[0, 2], [2, 1]])  # the two halves of an edge (vertex, vertex, middle)
QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])  # the four parts of a face with six nodes


@dataclass(frozen=True, eq=False)
class SkinContact:
    r"""Barrier between places of the skin that come close to each other, without friction.

    The skin is the surface through all its nodes: each edge of a section as two segments, each face of a solid as four
    triangles. Per reference area of the skin, at each of its nodes, the energy is

    .. math:: \psi = \frac{\kappa r}{2} b(d / r), \qquad b(s) = -(s^2 - 1)^2 \ln s^2 \quad (s < 1), \qquad b = 0 \quad (s \ge 1)

    with d the distance to the skin that is not adjacent. Both sides count, so in a section two parallel surfaces press on each
    other with the pressure :meth:`pressure` of the gap; in a solid, where several parts of the skin may be as near, with one
    to about three times as much. The distance r at which it starts is ``distance``, or half the smallest
    gap of the undeformed skin if that is less: skin that meets skin in a sharp fold starts without force.

    Parameters
    ----------
    space : Space or SolidSpace
        Space of the body.
    facets : (n_facets,) int array
        Facets with skin: numbers of edges of a section's mesh, or of boundary faces of a solid.
    distance : float [mm]
        Distance below which skin repels skin.
    stiffness : float [kPa]
        Scale kappa of the pressure.

    Raises
    ------
    InputError
        If the distance or the stiffness is not above zero, or the undeformed skin crosses or touches itself.
    """

    space: AnySpace
    facets: np.ndarray
    distance: float = DISTANCE_MM
    stiffness: float = STIFFNESS_KPA

    def __post_init__(self) -> None:
        for name, value, unit in (("distance", self.distance, "mm"), ("stiffness", self.stiffness, "kPa")):
            if not value > 0.0:
                raise InputError(
                    f"The {name} of the contact of skin with skin must be above zero; got {value:g} {unit}."
                )

    @cached_property
    def nodes(self) -> np.ndarray:
        """Nodes of the skin, ascending (n_skin,)."""
        return np.unique(self._parts)

    @cached_property
    def _parts(self) -> np.ndarray:
        """Nodes of the segments (n, 2) or triangles (n, 3) of the skin."""
        corners = self.space.facet_nodes(self.facets)
        return corners[:, HALVES if self._axes == 2 else QUARTERS].reshape(-1, self._axes)

    @property
    def _axes(self) -> int:
        """Number of axes in which skin meets skin: in a section 2, whatever the out-of-plane displacement."""
        return self.space.n_axes

    @cached_property
    def _dofs(self) -> np.ndarray:
        """Degree of freedom (3 node + component) of each coordinate of the skin's nodes (n_skin * axes,)."""
        return (3 * self.nodes[:, None] + np.arange(self._axes)).ravel()

    @cached_property
    def _surface(self) -> ipctk.CollisionMesh:
        ipctk.set_num_threads(1)  # sums over several threads differ in their last bits from run to run
        parts = np.searchsorted(self.nodes, self._parts).astype(np.int32)
        at_rest = self._of(self.space.positions)
        if self._axes == 2:
            return ipctk.CollisionMesh(at_rest, parts)
        return ipctk.CollisionMesh(at_rest, ipctk.edges(parts), parts)

    def _of(self, x: np.ndarray) -> np.ndarray:
        """Return the positions of the skin's nodes (n_skin, axes) [mm], in the order of memory that the library takes."""
        return np.asfortranarray(x[self.nodes, : self._axes])

    @cached_property
    def reach(self) -> float:
        """Distance [mm] at which the barrier starts."""
        x = self.space.positions
        if len(found := self.crossings(x)):
            place = _point(found[0])
            raise InputError(
                f"The skin crosses itself at {place} mm before it is loaded: mend the image or the mesh there."
            )
        near = self._near(self._of(x), 2.0 * self.distance)
        gap = np.inf if near.empty() else float(np.sqrt(near.compute_minimum_distance(self._surface, self._of(x))))
        if gap == 0.0:
            raise InputError("The skin touches itself before it is loaded: leave a gap between its two sides.")
        return min(self.distance, 0.5 * gap)

    def _near(self, skin: np.ndarray, reach: float) -> ipctk.NormalCollisions:
        """Return the pairs of places of the skin that are closer than ``reach`` [mm]."""
        pairs = ipctk.NormalCollisions()
        pairs.use_area_weighting = True
        kinds = ipctk.NormalCollisions
        pairs.collision_set_type = kinds.IMPROVED_MAX_APPROX if self._axes == 2 else kinds.IPC
        pairs.build(self._surface, skin, reach)
        return pairs

    @cached_property
    def _barrier(self) -> ipctk.BarrierPotential:
        return ipctk.BarrierPotential(self.reach, self.stiffness, use_physical_barrier=True)

    def pressure(self, gap: np.ndarray | float) -> np.ndarray:
        """Return the pressure between parallel surfaces with a gap: (...) [mm] -> (...) [kPa]."""
        s = np.minimum(np.asarray(gap, float) / self.reach, 1.0)
        return self.stiffness * (4.0 * s * (s**2 - 1.0) * np.log(s**2) + 2.0 * (s**2 - 1.0) ** 2 / s)

    def is_touching(self, x: np.ndarray) -> bool:
        """Return whether skin is within the reach of other skin, or crosses it: x (n_nodes, 3) [mm]."""
        skin = self._of(x)
        return not self._near(skin, self.reach).empty() or self._crosses(skin)

    def energy(self, x: np.ndarray) -> float:
        """Return the energy of the barrier, per depth in a section: x (n_nodes, 3) [mm] -> [uJ], section [uJ/mm = mN]."""
        skin = self._of(x)
        return float(self._barrier(self._near(skin, self.reach), self._surface, skin))

    def force(self, x: np.ndarray) -> np.ndarray:
        """Return the derivative of the energy with respect to x: (n_nodes, 3) [mm] -> (n_nodes, 3) [mN], section [mN/mm].

        Like the internal forces, it is what the contact opposes to a load.
        """
        skin, out = self._of(x), np.zeros(x.shape)
        pairs = self._near(skin, self.reach)
        if not pairs.empty():
            out.reshape(-1)[self._dofs] = self._barrier.gradient(pairs, self._surface, skin)
        return out

    def tangent(self, x: np.ndarray) -> sp.coo_array:
        """Return the second derivatives of the energy: x (n_nodes, 3) [mm] -> (3 n_nodes, 3 n_nodes) [mN/mm], symmetric."""
        skin, n = self._of(x), x.size
        pairs = self._near(skin, self.reach)
        if pairs.empty():
            return sp.coo_array((n, n))
        own = sp.coo_array(self._barrier.hessian(pairs, self._surface, skin))
        own.sum_duplicates()
        return sp.coo_array((own.data, (self._dofs[own.row], self._dofs[own.col])), shape=(n, n))

    def touching(self, x: np.ndarray) -> np.ndarray:
        """Return the places where skin presses on skin: x (n_nodes, 3) [mm] -> (n, 3) [mm]."""
        return x[np.any(self.force(x) != 0.0, axis=1)]

    def largest_step(self, x: np.ndarray, x_new: np.ndarray) -> float:
        """Return the share of the straight way from x to x_new that skin may go before it meets skin: (n_nodes, 3) [mm] twice.

        The share is in (0, 1], and 1 if the whole way is free; x must not cross itself.
        """
        ends = self._of(x), self._of(x_new)
        share = ipctk.compute_collision_free_stepsize(self._surface, *ends, narrow_phase_ccd=ipctk.AdditiveCCD())
        return 1.0 if share >= 1.0 else SAFE_SHARE * float(share)

    def crossings(self, x: np.ndarray) -> np.ndarray:
        """Return the places where skin crosses skin: x (n_nodes, 3) [mm] -> (n, 3) [mm], none if it does not."""
        skin = self._of(x)
        if not self._crosses(skin):
            return np.zeros((0, 3))
        places = [x[self.nodes[list(ends)]].mean(axis=0) for ends in self._crossing_edges(skin)]
        return np.unique(np.array(places).reshape(-1, 3), axis=0)

    def _crosses(self, skin: np.ndarray) -> bool:
        return bool(ipctk.has_intersections(self._surface, skin))

    def _crossing_edges(self, skin: np.ndarray) -> Iterator[tuple[int, int]]:
        """Yield the ends of each edge that crosses another part of the skin."""
        surface, search = self._surface, ipctk.LBVH()
        edges, faces = surface.edges, surface.faces
        search.build(skin, edges, faces)
        if self._axes == 2:
            for pair in search.detect_edge_edge_candidates():
                one, other = edges[pair.edge0_id], edges[pair.edge1_id]
                if not set(one) & set(other) and ipctk.segment_segment_intersect(*skin[one], *skin[other]):
                    yield tuple(one)
                    yield tuple(other)
            return
        for pair in search.detect_edge_face_candidates():
            edge, face = edges[pair.edge_id], faces[pair.face_id]
            if not set(edge) & set(face) and ipctk.is_edge_intersecting_triangle(*skin[edge], *skin[face]):
                yield tuple(edge)


def is_available() -> bool:
    """Return whether IPC Toolkit is installed; it has no wheels for Intel Macs and for Linux on ARM."""
    return find_spec("ipctk") is not None


def sites(places: np.ndarray) -> str:
    """Return words for places (n, 3) [mm]: their number and their mean."""
    return f"at {len(places)} places around {_point(places.mean(axis=0))} mm"


def _point(place: np.ndarray) -> str:
    return "({})".format(", ".join(f"{value:.1f}" for value in place))
