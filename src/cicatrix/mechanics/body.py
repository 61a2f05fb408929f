"""Body of tissue and skin on a finite-element space with boundary conditions: its forces, tangents and energies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import jax
import numpy as np
import scipy.sparse as sp
from jax import Array

from ..core.ranks import Ranks
from ..materials.compose import Sum
from ..materials.material import Material
from ..materials.neo_hookean import NeoHookean
from ..numerics.compiler import COMPILER
from ..numerics.host import own_exceptions
from ..numerics.workers import in_order
from .elements import (
    NORMAL,
    Bulk,
    Linearised,
    Membrane,
    bulk_energy,
    bulk_force,
    deformation_gradient,
    facet_force,
    fluctuation_fraction,
    law_gradient,
    linearised,
    linearised_reference,
    membrane_energy,
    membrane_force,
    tangent,
    volume_ratio,
)
from .fascia import Fascia, Springs, reference_spring_tangent, spring_energy, spring_force, spring_tangent
from .pattern import Pattern
from .self_contact import SkinContact
from .space import AnySpace, Space
from .supports import Supports

START_VOLUME = 0.01  # J_bar of an initial guess is clipped to within this fraction of the stress-free volume ratio
PIECE = 2048  # number of elements linearised at a time


@dataclass(frozen=True, eq=False)
class Discretization:
    """Discretisation of a body, unchanged by deformation and healing: space, skin, supports, sparsity pattern.

    Parameters
    ----------
    space : Space, SolidSpace or Sheet
        Nodes and elements.
    skin_facets : (n_facets,) int array
        Facets with a skin membrane: numbers of edges of a section's mesh, or of boundary faces of a solid.
    fixed_nodes : (n,) int array
        Nodes with prescribed positions (chest wall).
    sliding_nodes : (m,) int array, optional
        Nodes constrained along one direction and free to move normal to it; a node with several such directions is listed several
        times.
    sliding_normals : (m, 3) array [1], optional
        Unit vectors of these directions (:func:`.supports.walls` finds those of a wall).
    wall_facets : (k,) int array, optional
        Facets on the chest wall that carry the springs of the body's fascia.
    ranks : Ranks
        Ranks that share the body: each has its own elements and all nodes, and sums over elements include those of all
        ranks. Shared bodies are created by :mod:`.division`.
    """

    space: AnySpace
    skin_facets: np.ndarray
    fixed_nodes: np.ndarray
    sliding_nodes: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    sliding_normals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    wall_facets: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    ranks: Ranks = field(default_factory=Ranks)

    @cached_property
    def skin_nodes(self) -> np.ndarray:
        """Nodes of the skin facets: edges of a section (n_facets, 3), faces of a solid (n_facets, 6)."""
        return self.space.facet_nodes(self.skin_facets)

    @cached_property
    def wall_nodes(self) -> np.ndarray:
        """Nodes of the facets on the chest wall: edges of a section (n_facets, 3), faces of a solid (n_facets, 6)."""
        return self.space.facet_nodes(self.wall_facets)

    @property
    def _connected(self) -> list[np.ndarray]:
        """Nodes of elements, skin facets and wall facets, the order in which forces and matrices are added."""
        return [self.space.element_nodes, self.skin_nodes, self.wall_nodes]

    @cached_property
    def free_nodes(self) -> np.ndarray:
        """Nodes that are not fixed, ascending (n_free,)."""
        return np.setdiff1d(np.arange(self.space.n_nodes), self.fixed_nodes)

    @cached_property
    def _solved(self) -> dict[bool, tuple[np.ndarray, Pattern]]:
        return {}

    def solved(self, in_plane: bool) -> tuple[np.ndarray, Pattern]:
        """Return the degrees of freedom of all nodes that are not fixed, and the sparsity pattern of a matrix of these.

        Out-of-plane components are left out if ``in_plane``.
        """
        if in_plane not in self._solved:
            nodes = self.free_nodes
            components = 2 if in_plane else 3
            dofs = (3 * nodes[:, None] + np.arange(components)).ravel()
            self._solved[in_plane] = dofs, Pattern(self._connected, nodes, self.space.n_nodes, components)
        return self._solved[in_plane]

    @cached_property
    def _supports(self) -> dict[bool, Supports]:
        return {}

    def supports(self, in_plane: bool) -> Supports:
        """Return the map between the free degrees of freedom, on which matrices are assembled, and the unknowns.

        It eliminates the constrained components of sliding nodes.
        """
        if in_plane not in self._supports:
            loose = ~np.isin(self.sliding_nodes, self.fixed_nodes)
            nodes, normals = self.sliding_nodes[loose], self.sliding_normals[loose]
            if in_plane:  # the out-of-plane component of these nodes is constrained too
                nodes = np.concatenate([nodes, nodes])
                normals = np.concatenate([normals, np.broadcast_to(NORMAL, normals.shape)])
            free = self.solved(in_plane)[0]
            self._supports[in_plane] = Supports(free, nodes, normals, 3 * self.space.n_nodes)
        return self._supports[in_plane]

    def empty_matrix(self, in_plane: bool) -> sp.bsr_array:
        """Return a zero matrix (n_unknowns, n_unknowns) with the sparsity pattern of the tangent."""
        _, pattern = self.solved(in_plane)
        return self.supports(in_plane).matrix(pattern.matrix(pattern.zeros(), np.zeros(pattern.n_dofs)))

    def scatter(self, forces: list[Array]) -> np.ndarray:
        """Sum the forces of elements, skin facets and wall facets at the nodes, over all ranks: [(n, a, 3), ...] -> (n_nodes, 3).

        Those of the facets may be left out.
        """
        nodes = np.concatenate([part.ravel() for part in self._connected[: len(forces)]])
        values = np.concatenate([np.asarray(f).reshape(-1, 3) for f in forces])
        sums = [np.bincount(nodes, weights=column, minlength=self.space.n_nodes) for column in values.T]
        return self.ranks.sum(np.stack(sums, axis=1))

    def total(self, own: float) -> float:
        """Return the sum over all ranks of a number that each rank gives."""
        return float(self.ranks.sum(np.array([float(own)]))[0])

    def norm(self, shared: np.ndarray, own: np.ndarray) -> float:
        """Return the Euclidean norm of a vector in two parts: equal on all ranks (``shared``), and distributed (``own``)."""
        return float(np.sqrt(shared.dot(shared) + self.total(own.dot(own))))


@dataclass(frozen=True, eq=False)
class Body:
    """Tissue, skin and pressure on a discretisation.

    Parameters
    ----------
    discretization : Discretization
        Space, skin facets and supports.
    law : Material
        Constitutive law; parameters are numbers or (n_elements, n_qp) arrays.
    density : (n_elements, n_qp) array [kg/mm^3]
        Mass per reference volume.
    fraction : (n_elements,) array [1]
        Fraction of each element that is tissue; elements with 0 are left out of the mechanics.
    skin : Material
        Law of the skin membrane.
    skin_thickness : (n_facets,) array [mm]
        Reference thickness of the skin; 0 where there is none.
    wrinkling_strain : float [1]
        Compressive strain at which the skin wrinkles and its compressive stress levels off (:func:`.elements.membrane_energy`).
        In a solid the remaining compressive force per length, N, is at most modulus x thickness x this strain. It makes the
        skin buckle if the mesh resolves waves shorter than about pi N / mu, with mu the shear modulus of the tissue below;
        choose the strain small enough that it does not.
    skin_prestretch : float [1]
        In-plane stretch of the skin, equal in all directions, in the reference configuration.
    fascia : Fascia, optional
        Springs on the facets ``discretization.wall_facets``.
    pressure : (n_facets,) array [kPa], optional
        External follower pressure on the faces ``discretization.skin_facets`` of a solid, against their current outward
        normal. The tangent is symmetric if these faces form a closed surface, or if its edge is fixed or slides along planes, and
        unsymmetric if the edge is free.
    contact : SkinContact, optional
        Contact of skin with skin in the loaded shape.
    """

    discretization: Discretization
    law: Material
    density: np.ndarray
    fraction: np.ndarray
    skin: Material
    skin_thickness: np.ndarray
    wrinkling_strain: float = 0.1
    pressure: np.ndarray | None = None
    skin_prestretch: float = 1.0
    fascia: Fascia | None = None
    contact: SkinContact | None = None

    @cached_property
    @own_exceptions()
    def fluctuation_fraction(self) -> np.ndarray:
        """Fraction of the fluctuation of det F that J_bar retains in each element (n_elements,) [1]; 0 in a section."""
        if isinstance(self.discretization.space, Space):
            return np.zeros(self.discretization.space.n_elements)
        n, n_qp = self.density.shape
        law, out = jax.tree.map(np.asarray, self.law), np.empty(n)
        for piece, _ in _pieces(n):
            out[piece] = np.asarray(
                _fluctuation_fractions(_part(law, piece, n), (piece.stop - piece.start, n_qp))
            ).mean(axis=1)
        return out

    def with_tissue(self, law: Material, density: np.ndarray, fraction: np.ndarray) -> Body:
        """Return a body with the same discretisation and skin but other tissue; nothing is checked or recompiled."""
        return replace(self, law=law, density=density, fraction=fraction)

    @property
    def has_potential(self) -> bool:
        """True if forces derive from a potential, so that the tangent is symmetric: the law has one, and there is no pressure."""
        return self.pressure is None and self.law.has_potential()

    def stiffened(self, factor: float) -> Body:
        """Return a body whose tissue resists shear ``factor`` times as much at rest, as do the springs along its fascia.

        A neo-Hookean part is added to the law, with none at a factor of 1: the law's own response stays as it is.
        """
        n, n_qp = self.density.shape
        shear = np.broadcast_to(np.asarray(self.law.moduli_at_rest((n, n_qp))[0]), (n, n_qp))
        law = Sum((self.law, NeoHookean((factor - 1.0) * shear)))
        return replace(self, law=law, fascia=None if self.fascia is None else self.fascia.scaled(factor))

    def with_pressure_share(self, share: float) -> Body:
        """Return a body that differs only in its pressure, which is multiplied by ``share``."""
        return self if self.pressure is None else replace(self, pressure=share * self.pressure)

    @property
    def _bulk(self) -> Bulk:
        return Bulk(self.law, self.density, self.fraction, self.fluctuation_fraction)

    @property
    def _membrane(self) -> Membrane:
        pressure = np.zeros(len(self.skin_thickness)) if self.pressure is None else self.pressure
        return Membrane(self.skin, self.skin_thickness, self.wrinkling_strain, pressure, self.skin_prestretch)

    def _springs(self, X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, Springs] | None:
        """Return the positions of the wall facets' nodes in both shapes, and their springs; None without fascia."""
        nodes = self.discretization.wall_nodes
        return None if self.fascia is None else (X[nodes], x[nodes], self.fascia.on(len(nodes)))

    @cached_property
    def active_nodes(self) -> np.ndarray:
        """True for nodes of at least one element with tissue (n_nodes,) bool."""
        active = np.zeros(self.discretization.space.n_nodes)
        active[self.discretization.space.element_nodes[self.fraction > 0.0]] = 1.0
        return self.discretization.ranks.sum(active) > 0.0

    def volume_ratio(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the projected volume ratio J_bar at quadrature points: X, x (n_nodes, 3) [mm] -> (n_elements, n_qp) [1]."""
        cells = self.discretization.space.element_nodes
        return np.asarray(_volume_ratios(self._tables, X[cells], x[cells], self._bulk))

    @own_exceptions()
    def residual(
        self, X: np.ndarray, x: np.ndarray, gravity: np.ndarray, J_bar: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the residual, internal minus external nodal forces per depth (n_nodes, 3) [mN/mm].

        X, x (n_nodes, 3) [mm], gravity (3,) [mm/s^2]; J_bar (n_elements, n_qp) [1] defaults to ``volume_ratio``.
        """
        J_bar = self.volume_ratio(X, x) if J_bar is None else J_bar
        forces = self.discretization.scatter(self._forces(X, x, J_bar, gravity))
        return forces if self.contact is None else forces + self.contact.force(x)

    def _forces(self, X: np.ndarray, x: np.ndarray, J_bar: np.ndarray, gravity: np.ndarray) -> list[Array]:
        """Return the forces at the nodes of elements, skin facets and, with fascia, wall facets [mN/mm]."""
        forces = _forces(self._tables, *self._gather(X, x), J_bar, self._bulk, self._membrane, gravity)
        springs = self._springs(X, x)
        return forces if springs is None else [*forces, _spring_forces(self._tables, *springs)]

    @own_exceptions()
    def linearised(
        self, X: np.ndarray, x: np.ndarray, J_bar: np.ndarray, *, in_plane: bool, damping: float = 0.0
    ) -> tuple[sp.bsr_array, VolumeRates]:
        """Return the derivative of the residual with respect to x on the free dofs [mN/mm^2], and its coupling to J_bar.

        The derivative is the sum of the matrices of all ranks. Rows of nodes without tissue are those of the identity matrix;
        ``damping`` times the nodal mass [kg/mm] is added to the diagonal. Where skin touches skin the matrix has blocks beyond
        the pattern of the mesh.
        """
        skin = partial(_skin_tangents, self._tables, *self._edges(X, x), self._membrane)
        linearise = partial(_linearisations, self._tables)
        added = damping * self.lumped_mass(X) if damping else None
        springs = partial(_spring_tangents, self._tables)
        matrix, rates = self._assembled(linearise, X, x, J_bar, [skin, springs], in_plane, added)
        return self._with_contact(matrix, x, in_plane), rates

    def _with_contact(self, matrix: sp.bsr_array, x: np.ndarray, in_plane: bool) -> sp.bsr_array:
        """Return the sum of a matrix on the free dofs and the tangent of the contact of skin with skin, if it touches."""
        if self.contact is None or not (tangent := self.contact.tangent(x)).nnz:
            return matrix
        free, _ = self.discretization.solved(in_plane)
        total = matrix + sp.bsr_array(tangent.tocsr()[free][:, free], blocksize=matrix.blocksize)
        total.sort_indices()
        return sp.bsr_array(total)

    @own_exceptions()
    def linearised_reference(
        self, X: np.ndarray, x: np.ndarray, J_bar: np.ndarray, gravity: np.ndarray, *, in_plane: bool
    ) -> tuple[sp.bsr_array, VolumeRates]:
        """Return the derivatives of :meth:`linearised`, but with respect to the reference positions X."""
        skin = partial(_reference_skin_tangents, self._tables, *self._edges(X, x), self._membrane)
        linearise = partial(_reference_linearisations, self._tables, gravity)
        springs = partial(_reference_spring_tangents, self._tables)
        return self._assembled(linearise, X, x, J_bar, [skin, springs], in_plane)

    def _assembled(
        self,
        linearise: Callable[..., Linearised],
        X: np.ndarray,
        x: np.ndarray,
        J_bar: np.ndarray,
        on_facets: list[Callable[..., Array]],
        in_plane: bool,
        added: np.ndarray | None = None,
    ) -> tuple[sp.bsr_array, VolumeRates]:
        """Assemble a matrix from element matrices in chunks; return it with the coupling to J_bar, as in ``linearised``.

        All element matrices at once would need more RAM than the factorised matrix. ``linearise`` computes those of a chunk of
        elements, ``on_facets`` those of all skin facets and of the springs on wall facets; ``added`` (n_nodes,) is added to
        the diagonal.
        """
        skin, springs = on_facets
        free, pattern = self.discretization.solved(in_plane)
        cells, bulk = self.discretization.space.element_nodes, jax.tree.map(np.asarray, self._bulk)
        data, rates = pattern.zeros(), VolumeRates.empty(*J_bar.shape, 3 * cells.shape[1])

        def one(piece: slice) -> Linearised:
            part = linearise(X[cells[piece]], x[cells[piece]], J_bar[piece], _part(bulk, piece, len(cells)))
            return jax.block_until_ready(part)

        pieces = list(_pieces(len(cells)))
        for (piece, done), part in zip(pieces, in_order(one, [piece for piece, _ in pieces])):
            pattern.add_contracted(data, 0, piece.start + done, [np.asarray(factor)[done:] for factor in part[:4]])
            rates.force_rate[piece], rates.volume_rate[piece] = part.force_rate, part.volume_rate
        if len(self.discretization.skin_facets):
            pattern.add(data, 1, 0, np.asarray(skin()))
        if (on_wall := self._springs(X, x)) is not None:
            pattern.add(data, 2, 0, np.asarray(springs(*on_wall)))
        diagonal = np.where(np.repeat(self.active_nodes, 3)[free], 0.0, 1.0)
        if added is not None:
            diagonal += np.repeat(added, 3)[free]
        return pattern.matrix(data, diagonal / self.discretization.ranks.size), rates

    def volume_force(self, rates: VolumeRates, gap: np.ndarray) -> np.ndarray:
        """Return the change of the nodal forces if J_bar changes by ``gap``: (n_elements, n_qp) [1] -> (n_nodes, 3) [mN/mm]."""
        force = np.einsum("eqm,eq->em", rates.force_rate, gap).reshape(len(gap), -1, 3)
        return self.discretization.scatter([force])  # pyright: ignore[reportArgumentType]

    def volume_change(self, rates: VolumeRates, moved: np.ndarray) -> np.ndarray:
        """Return the first-order change of J_bar for a nodal displacement: (n_nodes, 3) [mm] -> (n_elements, n_qp) [1]."""
        cells = moved[self.discretization.space.element_nodes]
        return np.einsum("eqm,em->eq", rates.volume_rate, cells.reshape(len(cells), -1))

    def initial_volume_ratio(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return ``volume_ratio`` clipped to near the stress-free volume ratio, as an initial guess (n_elements, n_qp) [1]."""
        rest = np.asarray(self.law.volume_at_rest())
        return rest * np.clip(self.volume_ratio(X, x) / rest, 1.0 - START_VOLUME, 1.0 + START_VOLUME)

    def _gather(self, X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        cells = self.discretization.space.element_nodes
        return X[cells], x[cells], *self._edges(X, x)

    def _edges(self, X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        return X[self.discretization.skin_nodes], x[self.discretization.skin_nodes]

    @own_exceptions()
    def energy_density(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return strain energy per reference volume at quadrature points (n_elements, n_qp) [kPa]; 0 without tissue."""
        cells = self.discretization.space.element_nodes
        W = _energies(self._tables, X[cells], x[cells], self._bulk)
        return np.where(self.fraction[:, None] > 0.0, np.asarray(W), 0.0)

    def law_gradient(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the argument of the law: F with its volume ratio replaced by J_bar (n_elements, n_qp, 3, 3) [1]."""
        cells = self.discretization.space.element_nodes
        return np.asarray(_law_gradients(self._tables, X[cells], x[cells], self._bulk))

    @own_exceptions()
    def inner_force(self, X: np.ndarray, x: np.ndarray) -> float:
        """Return the norm of the nodal sums of absolute element forces [mN], the scale of the residual without load."""
        zero = np.zeros(3)
        parts = self._forces(X, x, self.volume_ratio(X, x), zero)
        return float(np.linalg.norm(self.discretization.scatter([np.abs(part) for part in parts])))

    def strain_energy(self, X: np.ndarray, x: np.ndarray) -> float:
        """Return the strain energy of tissue, skin, fascia and contact per depth [uJ/mm = mN]."""
        return self.discretization.total(self._own_strain_energy(X, x))

    @own_exceptions()
    def _own_strain_energy(self, X: np.ndarray, x: np.ndarray) -> float:
        energy = float(np.sum(self.energy_density(X, x) * self.volumes(X) * self.fraction[:, None]))
        if len(self.discretization.skin_facets):
            energy += float(np.sum(_skin_energies(self._tables, *self._edges(X, x), self._membrane)))
        if (springs := self._springs(X, x)) is not None:
            energy += float(np.sum(_spring_energies(self._tables, *springs)))
        return energy if self.contact is None else energy + self.contact.energy(x)

    def potential(self, X: np.ndarray, x: np.ndarray, gravity: np.ndarray) -> float:
        """Return the potential energy per depth [mN]: strain energy minus work of gravity from X to x; pressure is left out."""
        moved = np.einsum(
            "qa,eai->eqi", self.discretization.space.table.value, (x - X)[self.discretization.space.element_nodes]
        )
        mass = self.density * self.volumes(X) * self.fraction[:, None]
        work = float(np.einsum("eq,eqi,i->", mass, moved, gravity))
        return self.discretization.total(self._own_strain_energy(X, x) - work)

    def lumped_mass(self, X: np.ndarray) -> np.ndarray:
        """Return a positive nodal mass per depth from integrals of |N_a| (n_nodes,) [kg/mm]; used only as a scale."""
        mass = self.density * self.volumes(X) * self.fraction[:, None]
        shares = np.einsum("eq,qa->ea", mass, np.abs(self.discretization.space.table.value))
        nodes = self.discretization.space.element_nodes.ravel()
        own = np.bincount(nodes, weights=shares.ravel(), minlength=self.discretization.space.n_nodes)
        return self.discretization.ranks.sum(own)

    def inverted_elements(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the location in x of each inverted element, over all ranks (n, 3) [mm].

        An element is inverted if its orientation at a quadrature point differs between X and x. A shape with inverted elements
        is unphysical even if its forces are in equilibrium. The location is the mean of the element's first three corners.
        """
        turned = (local_volumes(self.discretization.space, X) * local_volumes(self.discretization.space, x) <= 0.0).any(
            axis=1
        )
        corners = self.discretization.space.element_nodes[turned & (self.fraction > 0.0), :3]
        gathered = self.discretization.ranks.gather(x[corners].mean(axis=1).tobytes())
        return np.concatenate([np.frombuffer(places) for places in gathered]).reshape(-1, 3)

    def volumes(self, X: np.ndarray) -> np.ndarray:
        """Return the volume [mm^3] (section: area [mm^2]) of each quadrature point: X (n_nodes, 3) [mm] -> (n_elements, n_qp)."""
        return measures(self.discretization.space, X)

    @property
    def _tables(self) -> _Tables:
        return _Tables(self.discretization.space)


class VolumeRates(NamedTuple):
    """Derivatives that couple nodal positions and volume ratios J_bar, at the quadrature points of n elements."""

    force_rate: np.ndarray
    """Derivative of the element's nodal forces with respect to J_bar (n, n_qp, 3a) [mN/mm]."""
    volume_rate: np.ndarray
    """Derivative of J_bar with respect to the positions (n, n_qp, 3a) [1/mm]."""

    @classmethod
    def empty(cls, *shape: int) -> VolumeRates:
        """Return uninitialised arrays of a given shape (n, n_qp, 3a)."""
        return cls(np.empty(shape), np.empty(shape))


def _pieces(n: int) -> Iterator[tuple[slice, int]]:
    """Yield slices of equal size that together contain n elements, each with its number of elements in the previous slice too.

    The last slice may overlap the one before it, so that kernels are compiled for one size only.
    """
    size = min(n, PIECE)
    for first in range(0, n, size) if n else ():
        start = min(first, n - size)
        yield slice(start, start + size), first - start


def _part(filling, piece: slice, n: int):
    """Return a law or a ``Bulk`` for a slice of the n elements: slice every array that has one entry per element."""
    return jax.tree.map(lambda leaf: leaf[piece] if leaf.ndim and len(leaf) == n else leaf, filling)


class _Tables:
    """Shape functions of elements and facets as a static argument of compiled functions; equal for spaces of equal ``kind``."""

    def __init__(self, space: AnySpace) -> None:
        self.bulk, self.edge, self._kind = space.table, space.facet_table, space.kind

    def __hash__(self) -> int:
        return hash(self._kind)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Tables) and other._kind == self._kind


def measures(space: AnySpace, X: np.ndarray) -> np.ndarray:
    """Return the volume [mm^3] (section: area [mm^2]) of each quadrature point: X (n_nodes, 3) [mm] -> (n_elements, n_qp)."""
    return space.table.weight * np.abs(local_volumes(space, X))


def local_volumes(space: AnySpace, X: np.ndarray) -> np.ndarray:
    """Return the Jacobian determinant of the map from the reference element at quadrature points (n_elements, n_qp).

    X (n_nodes, 3) [mm] are the positions; the unit is mm^3, for a section mm^2.
    """
    axes = space.table.gradient.shape[-1]
    return np.linalg.det(np.einsum("eai,qab->eqib", X[space.element_nodes][..., :axes], space.table.gradient))


def deformation_gradients(space: AnySpace, X: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return F = dx/dX at quadrature points: X, x (n_nodes, 3) [mm] -> (n_elements, n_qp, 3, 3) [1]."""
    cells = space.element_nodes
    return np.asarray(_gradients(_Tables(space), X[cells], x[cells]))


_fluctuation_fractions = jax.jit(fluctuation_fraction, static_argnums=1, compiler_options=COMPILER)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _gradients(tables, X_cells, x_cells):
    return deformation_gradient(X_cells, x_cells, tables.bulk.gradient)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _volume_ratios(tables, X_cells, x_cells, bulk):
    return volume_ratio(X_cells, x_cells, bulk, tables.bulk)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _forces(tables, X_cells, x_cells, X_edges, x_edges, J_bar, bulk, membrane, gravity):
    cells = bulk_force(X_cells, x_cells, J_bar, bulk, gravity, tables.bulk)
    return [cells, facet_force(X_edges, x_edges, membrane, tables.edge)]


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _linearisations(tables, X_cells, x_cells, J_bar, bulk):
    return linearised(X_cells, x_cells, J_bar, bulk, tables.bulk)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _skin_tangents(tables, X_edges, x_edges, membrane):
    return tangent(lambda y: facet_force(X_edges, y, membrane, tables.edge), x_edges)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _reference_linearisations(tables, gravity, X_cells, x_cells, J_bar, bulk):
    return linearised_reference(X_cells, x_cells, J_bar, bulk, gravity, tables.bulk)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _reference_skin_tangents(tables, X_edges, x_edges, membrane):
    return tangent(lambda Y: membrane_force(Y, x_edges, membrane, tables.edge), X_edges)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _law_gradients(tables, X_cells, x_cells, bulk):
    return law_gradient(X_cells, x_cells, bulk, tables.bulk)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _energies(tables, X_cells, x_cells, bulk):
    return bulk_energy(X_cells, x_cells, bulk, tables.bulk)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _skin_energies(tables, X_edges, x_edges, membrane):
    return membrane_energy(X_edges, x_edges, membrane, tables.edge)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _spring_forces(tables, X_wall, x_wall, springs):
    return spring_force(X_wall, x_wall, springs, tables.edge)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _spring_tangents(tables, X_wall, x_wall, springs):
    return spring_tangent(X_wall, x_wall, springs, tables.edge)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _reference_spring_tangents(tables, X_wall, x_wall, springs):
    return reference_spring_tangent(X_wall, x_wall, springs, tables.edge)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _spring_energies(tables, X_wall, x_wall, springs):
    return spring_energy(X_wall, x_wall, springs, tables.edge)


KERNELS = (
    _volume_ratios,
    _forces,
    _linearisations,
    _skin_tangents,
    _reference_linearisations,
    _reference_skin_tangents,
    _law_gradients,
    _energies,
    _skin_energies,
    _spring_forces,
    _spring_tangents,
    _reference_spring_tangents,
    _spring_energies,
    _gradients,
    _fluctuation_fractions,
)


def compiled_variants() -> int:
    """Return the number of kernel variants compiled in this process; a healing cycle must not increase it."""
    return sum(f._cache_size() for f in KERNELS)


def mean_energy(body: Body, X: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the mean strain energy per reference volume of each element: X, x (n_nodes, 3) [mm] -> (n_elements,) [kPa]."""
    weights = body.volumes(X)
    return np.sum(body.energy_density(X, x) * weights, axis=1) / np.sum(weights, axis=1)
