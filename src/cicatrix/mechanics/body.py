"""A body: a space, what fills it, its skin, what holds it, and the forces of all that."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jax import Array

from ..core.ranks import Ranks
from ..materials.material import EnergyMaterial
from ..numerics.compiler import COMPILER
from ..numerics.workers import in_order
from .elements import (
    NORMAL,
    Bulk,
    Linearised,
    Membrane,
    bulk_energy,
    bulk_force,
    deformation_gradient,
    dilation,
    facet_force,
    filled_gradient,
    kept_share,
    linearised,
    linearised_reference,
    membrane_energy,
    membrane_force,
    tangent,
)
from .pattern import Pattern
from .space import AnySpace, Space
from .supports import Supports

START_VOLUME = 0.01  # how far from rest the volume ratio of a starting shape is believed
PIECE = 2048  # elements that are linearised at a time


@dataclass(frozen=True, eq=False)
class Frame:
    """What never changes while a body deforms and heals: space, skin, fixed nodes, pattern.

    Parameters
    ----------
    space : Space, SolidSpace or Sheet
        Nodes and elements.
    skin_facets : (n_facets,) int array
        What carries the skin membrane: edges of a section's mesh, boundary faces of a solid by their numbers.
    fixed_nodes : (n,) int array
        Nodes held at their place (chest wall).
    sliding_nodes : (m,) int array, optional
        Nodes held along a direction only, free across it; a node held along several is there several times.
    sliding_normals : (m, 3) array [1], optional
        These directions, of length 1 (:func:`.supports.walls` finds those of a wall).
    ranks : Ranks
        Who shares the body: each rank has elements of its own and all of the nodes, and what is summed over elements is
        summed over those of all ranks. Shared bodies are made by :mod:`.division`.
    """

    space: AnySpace
    skin_facets: np.ndarray
    fixed_nodes: np.ndarray
    sliding_nodes: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    sliding_normals: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    ranks: Ranks = field(default_factory=Ranks)

    @cached_property
    def skin_nodes(self) -> np.ndarray:
        """Nodes of the skin: edges of a section (n_facets, 3), faces of a solid (n_facets, 6)."""
        return self.space.facet_nodes(self.skin_facets)

    @cached_property
    def free_nodes(self) -> np.ndarray:
        """Nodes that are not fixed, ascending (n_free,)."""
        return np.setdiff1d(np.arange(self.space.n_nodes), self.fixed_nodes)

    @cached_property
    def _solved(self) -> dict[bool, tuple[np.ndarray, Pattern]]:
        return {}

    def solved(self, in_plane: bool) -> tuple[np.ndarray, Pattern]:
        """Free degrees of freedom and their pattern; ``in_plane`` leaves out the shift along the normal."""
        if in_plane not in self._solved:
            nodes = self.free_nodes
            components = 2 if in_plane else 3
            dofs = (3 * nodes[:, None] + np.arange(components)).ravel()
            elements = [self.space.element_nodes, self.skin_nodes]
            self._solved[in_plane] = dofs, Pattern(elements, nodes, self.space.n_nodes, components)
        return self._solved[in_plane]

    @cached_property
    def _supports(self) -> dict[bool, Supports]:
        return {}

    def supports(self, in_plane: bool) -> Supports:
        """What is solved for; matrices of a body are on the free degrees of freedom, before walls are let in."""
        if in_plane not in self._supports:
            loose = ~np.isin(self.sliding_nodes, self.fixed_nodes)
            nodes, normals = self.sliding_nodes[loose], self.sliding_normals[loose]
            if in_plane:  # the normal of the section is held there too
                nodes = np.concatenate([nodes, nodes])
                normals = np.concatenate([normals, np.broadcast_to(NORMAL, normals.shape)])
            free = self.solved(in_plane)[0]
            self._supports[in_plane] = Supports(free, nodes, normals, 3 * self.space.n_nodes)
        return self._supports[in_plane]

    def empty_matrix(self, in_plane: bool) -> sp.bsr_array:
        """A matrix of zeros on what is solved for."""
        _, pattern = self.solved(in_plane)
        return self.supports(in_plane).matrix(pattern.matrix(pattern.zeros(), np.zeros(pattern.n_dofs)))

    def scatter(self, forces: list[Array]) -> np.ndarray:
        """Sum forces of elements and skin edges [(n, a, 3), ...] -> (n_nodes, 3)."""
        nodes = np.concatenate([self.space.element_nodes.ravel(), self.skin_nodes.ravel()])
        values = np.concatenate([np.asarray(f).reshape(-1, 3) for f in forces])
        sums = [np.bincount(nodes, weights=column, minlength=self.space.n_nodes) for column in values.T]
        return self.ranks.sum(np.stack(sums, axis=1))

    def total(self, own: float) -> float:
        """Sum a number of each rank."""
        return float(self.ranks.sum(np.array([float(own)]))[0])

    def norm(self, shared: np.ndarray, own: np.ndarray) -> float:
        """Euclidean norm of what all ranks have alike, and of what each has of its own."""
        return float(np.sqrt(shared.dot(shared) + self.total(own.dot(own))))


@dataclass(frozen=True, eq=False)
class Body:
    """Tissue on a frame.

    Parameters
    ----------
    frame : Frame
        Space, skin, fixed nodes.
    law : EnergyMaterial
        Constitutive law; parameters are numbers or (n_elements, n_qp) arrays.
    density : (n_elements, n_qp) array [kg/mm^3]
        Mass per reference volume.
    fraction : (n_elements,) array [1]
        Share of each element that is tissue; an element at 0 is out of the mechanics altogether.
    skin : EnergyMaterial
        Law of the skin membrane.
    skin_thickness : (n_facets,) array [mm]
        0 where there is no skin.
    wrinkling_strain : float [1]
        Shortening at which the skin wrinkles and bears no more (:func:`.elements.membrane_energy`). In a solid the push N that
        it still bears, at most its modulus times this times the thickness, buckles it on the mesh where waves shorter than
        about pi N / mu, mu of the tissue below, can be told: choose it so small that they cannot.
    pressure : (n_facets,) array [kPa], optional
        From outside on the faces of ``frame.skin_facets`` of a solid, against their outward normal as it turns. The tangent is
        symmetric where these faces close, or end where nodes are fixed or slide along planes, and not where they end freely.
    """

    frame: Frame
    law: EnergyMaterial
    density: np.ndarray
    fraction: np.ndarray
    skin: EnergyMaterial
    skin_thickness: np.ndarray
    wrinkling_strain: float = 0.1
    pressure: np.ndarray | None = None

    @cached_property
    def kept(self) -> np.ndarray:
        """Share of the volume ratio's fluctuation that each element keeps (n_elements,) [1]; none in a section."""
        if isinstance(self.frame.space, Space):
            return np.zeros(self.frame.space.n_elements)
        n, n_qp = self.density.shape
        law, out = jax.tree.map(np.asarray, self.law), np.empty(n)
        for piece, _ in _pieces(n):
            out[piece] = np.asarray(_kept_shares(_part(law, piece, n), (piece.stop - piece.start, n_qp))).mean(axis=1)
        return out

    def with_tissue(self, law: EnergyMaterial, density: np.ndarray, fraction: np.ndarray) -> Body:
        """The same frame and skin, other tissue; refuses nothing and compiles nothing."""
        return replace(self, law=law, density=density, fraction=fraction)

    @property
    def has_potential(self) -> bool:
        """Whether forces follow from one, so that the tangent is symmetric: its law's do, and no pressure acts."""
        return self.pressure is None and self.law.has_potential()

    def under(self, share: float) -> Body:
        """The same body under a share of its pressure."""
        return self if self.pressure is None else replace(self, pressure=share * self.pressure)

    @property
    def _bulk(self) -> Bulk:
        return Bulk(self.law, jnp.asarray(self.density), jnp.asarray(self.fraction), jnp.asarray(self.kept))

    @property
    def _membrane(self) -> Membrane:
        pressure = np.zeros(len(self.skin_thickness)) if self.pressure is None else self.pressure
        return Membrane(
            self.skin, jnp.asarray(self.skin_thickness), jnp.asarray(self.wrinkling_strain), jnp.asarray(pressure)
        )

    @cached_property
    def active_nodes(self) -> np.ndarray:
        """Nodes that some tissue holds (n_nodes,) bool."""
        active = np.zeros(self.frame.space.n_nodes)
        active[self.frame.space.element_nodes[self.fraction > 0.0]] = 1.0
        return self.frame.ranks.sum(active) > 0.0

    def dilation(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Volume ratio, projected in each element, at quadrature points: X, x (n_nodes, 3) [mm] -> (n_elements, n_qp) [1]."""
        cells = self.frame.space.element_nodes
        return np.asarray(_dilations(self._tables, X[cells], x[cells], self._bulk))

    def residual(
        self, X: np.ndarray, x: np.ndarray, gravity: np.ndarray, J_bar: np.ndarray | None = None
    ) -> np.ndarray:
        """Internal minus external force per depth -> (n_nodes, 3) [mN/mm].

        X, x (n_nodes, 3) [mm], gravity (3,) [mm/s^2]; J_bar (n_elements, n_qp) is ``dilation`` unless given.
        """
        J_bar = self.dilation(X, x) if J_bar is None else J_bar
        return self.frame.scatter(
            _forces(self._tables, *self._gather(X, x), J_bar, self._bulk, self._membrane, gravity)
        )

    def linearised(
        self, X: np.ndarray, x: np.ndarray, J_bar: np.ndarray, *, in_plane: bool, damping: float = 0.0
    ) -> tuple[sp.bsr_array, VolumeRates]:
        """Derivative of the residual by x on the free dofs [mN/mm^2], and what ties it to the volume ratios.

        The derivative is the sum of what all ranks return. Rows of nodes that no tissue holds are those of the identity;
        ``damping`` times the nodal mass [kg/mm] is added to the diagonal.
        """
        skin = _skin_tangents(self._tables, *self._edges(X, x), self._membrane)
        linearise = partial(_linearisations, self._tables)
        return self._assembled(
            linearise, X, x, J_bar, skin, in_plane, damping * self.lumped_mass(X) if damping else None
        )

    def linearised_reference(
        self, X: np.ndarray, x: np.ndarray, J_bar: np.ndarray, gravity: np.ndarray, *, in_plane: bool
    ) -> tuple[sp.bsr_array, VolumeRates]:
        """The same by the reference positions X."""
        skin = _reference_skin_tangents(self._tables, *self._edges(X, x), self._membrane)
        linearise = partial(_reference_linearisations, self._tables, gravity)
        return self._assembled(linearise, X, x, J_bar, skin, in_plane)

    def _assembled(
        self,
        linearise: Callable[..., Linearised],
        X: np.ndarray,
        x: np.ndarray,
        J_bar: np.ndarray,
        skin: Array,
        in_plane: bool,
        added: np.ndarray | None = None,
    ) -> tuple[sp.bsr_array, VolumeRates]:
        """Sum the elements' matrices piece by piece: all of them at once would take more memory than the factor."""
        free, pattern = self.frame.solved(in_plane)
        cells, bulk = self.frame.space.element_nodes, jax.tree.map(np.asarray, self._bulk)
        data, rates = pattern.zeros(), VolumeRates.empty(*J_bar.shape, 3 * cells.shape[1])

        def one(piece: slice) -> Linearised:
            part = linearise(X[cells[piece]], x[cells[piece]], J_bar[piece], _part(bulk, piece, len(cells)))
            return jax.block_until_ready(part)

        pieces = list(_pieces(len(cells)))
        for (piece, done), part in zip(pieces, in_order(one, [piece for piece, _ in pieces])):
            pattern.add_contracted(data, 0, piece.start + done, [np.asarray(factor)[done:] for factor in part[:4]])
            rates.force_rate[piece], rates.volume_rate[piece] = part.force_rate, part.volume_rate
        pattern.add(data, 1, 0, np.asarray(skin))
        diagonal = np.where(np.repeat(self.active_nodes, 3)[free], 0.0, 1.0)
        if added is not None:
            diagonal += np.repeat(added, 3)[free]
        return pattern.matrix(data, diagonal / self.frame.ranks.size), rates

    def volume_force(self, rates: VolumeRates, gap: np.ndarray) -> np.ndarray:
        """Change of force when J_bar changes by ``gap`` (n_elements, n_qp) -> (n_nodes, 3) [mN/mm]."""
        force = np.einsum("eqm,eq->em", rates.force_rate, gap).reshape(len(gap), -1, 3)
        return self.frame.scatter([force, np.zeros((*self.frame.skin_nodes.shape, 3))])

    def volume_change(self, rates: VolumeRates, moved: np.ndarray) -> np.ndarray:
        """Change of J_bar when nodes move (n_nodes, 3) [mm], to first order -> (n_elements, n_qp) [1]."""
        cells = moved[self.frame.space.element_nodes]
        return np.einsum("eqm,em->eq", rates.volume_rate, cells.reshape(len(cells), -1))

    def starting_dilation(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """``dilation``, but not far from rest: that of a shape to start from is not believed (n_elements, n_qp) [1]."""
        rest = np.asarray(self.law.volume_at_rest())
        return rest * np.clip(self.dilation(X, x) / rest, 1.0 - START_VOLUME, 1.0 + START_VOLUME)

    def _gather(self, X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        cells = self.frame.space.element_nodes
        return X[cells], x[cells], *self._edges(X, x)

    def _edges(self, X: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        return X[self.frame.skin_nodes], x[self.frame.skin_nodes]

    def energy_density(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Strain energy per reference volume of tissue at quadrature points -> (n_elements, n_qp) [kPa]; 0 where open."""
        cells = self.frame.space.element_nodes
        W = _energies(self._tables, X[cells], x[cells], self._bulk)
        return np.where(self.fraction[:, None] > 0.0, np.asarray(W), 0.0)

    def law_gradient(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """F with its projected volume ratio, as the law sees it -> (n_elements, n_qp, 3, 3) [1]."""
        cells = self.frame.space.element_nodes
        return np.asarray(_filled_gradients(self._tables, X[cells], x[cells], self._bulk))

    def inner_force(self, X: np.ndarray, x: np.ndarray) -> float:
        """Norm of what the elements pull at each node, all in one direction [mN]: the scale of balance where no load is."""
        zero = np.zeros(3)
        parts = _forces(self._tables, *self._gather(X, x), self.dilation(X, x), self._bulk, self._membrane, zero)
        return float(np.linalg.norm(self.frame.scatter([np.abs(part) for part in parts])))

    def strain_energy(self, X: np.ndarray, x: np.ndarray) -> float:
        """Strain energy of tissue and skin per depth [uJ/mm = mN]."""
        return self.frame.total(self._own_strain_energy(X, x))

    def _own_strain_energy(self, X: np.ndarray, x: np.ndarray) -> float:
        bulk = np.sum(self.energy_density(X, x) * self.volumes(X) * self.fraction[:, None])
        edges = self.frame.skin_nodes
        return float(bulk + np.sum(_skin_energies(self._tables, X[edges], x[edges], self._membrane)))

    def potential(self, X: np.ndarray, x: np.ndarray, gravity: np.ndarray) -> float:
        """Strain energy minus the work of gravity from X to x, per depth [mN]: least in a stable equilibrium without pressure."""
        moved = np.einsum("qa,eai->eqi", self.frame.space.table.value, (x - X)[self.frame.space.element_nodes])
        mass = self.density * self.volumes(X) * self.fraction[:, None]
        work = float(np.einsum("eq,eqi,i->", mass, moved, gravity))
        return self.frame.total(self._own_strain_energy(X, x) - work)

    def lumped_mass(self, X: np.ndarray) -> np.ndarray:
        """Mass per depth at the nodes, row sums of |N_a| (n_nodes,) [kg/mm]: positive, a scale and no more."""
        mass = self.density * self.volumes(X) * self.fraction[:, None]
        shares = np.einsum("eq,qa->ea", mass, np.abs(self.frame.space.table.value))
        nodes = self.frame.space.element_nodes.ravel()
        own = np.bincount(nodes, weights=shares.ravel(), minlength=self.frame.space.n_nodes)
        return self.frame.ranks.sum(own)

    def inside_out(self, X: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Where, in x, elements lie that some point of has turned over between X and x, of all ranks (n, 3) [mm].

        That is no shape of any tissue, whatever balances.
        """
        turned = (local_volumes(self.frame.space, X) * local_volumes(self.frame.space, x) <= 0.0).any(axis=1)
        corners = self.frame.space.element_nodes[turned & (self.fraction > 0.0), :3]
        told = self.frame.ranks.gather(x[corners].mean(axis=1).tobytes())
        return np.concatenate([np.frombuffer(places) for places in told]).reshape(-1, 3)

    def volumes(self, X: np.ndarray) -> np.ndarray:
        """Volume (a section's area) at quadrature points: X (n_nodes, 3) [mm] -> (n_elements, n_qp) [mm^3, mm^2]."""
        return measures(self.frame.space, X)

    @property
    def _tables(self) -> _Tables:
        return _Tables(self.frame.space)


class VolumeRates(NamedTuple):
    """What ties an assembled linearisation to the volume ratios at quadrature points, as in :class:`.elements.Linearised`."""

    force_rate: np.ndarray
    """Change of force by J_bar (n, n_qp, 3a) [mN/mm]."""
    volume_rate: np.ndarray
    """Change of J_bar by the positions (n, n_qp, 3a) [1/mm]."""

    @classmethod
    def empty(cls, *shape: int) -> VolumeRates:
        """Not filled yet."""
        return cls(np.empty(shape), np.empty(shape))


def _pieces(n: int) -> Iterator[tuple[slice, int]]:
    """Equal pieces of n elements, and how many in each were done before: the last overlaps, so that nothing compiles twice."""
    size = min(n, PIECE)
    for first in range(0, n, size) if n else ():
        start = min(first, n - size)
        yield slice(start, start + size), first - start


def _part(filling, piece: slice, n: int):
    """What fills a piece of n elements, law or bulk."""
    return jax.tree.map(lambda leaf: leaf[piece] if leaf.ndim and len(leaf) == n else leaf, filling)


class _Tables:
    """Static argument of the compiled functions: equal for equal spaces."""

    def __init__(self, space: AnySpace) -> None:
        self.bulk, self.edge, self._kind = space.table, space.facet_table, space.kind

    def __hash__(self) -> int:
        return hash(self._kind)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Tables) and other._kind == self._kind


def measures(space: AnySpace, X: np.ndarray) -> np.ndarray:
    """Volume (a section's area) of each quadrature point: X (n_nodes, 3) [mm] -> (n_elements, n_qp) [mm^3, mm^2]."""
    return space.table.weight * np.abs(local_volumes(space, X))


def local_volumes(space: AnySpace, X: np.ndarray) -> np.ndarray:
    """Signed volume (a section's area) over that of the reference element (n_elements, n_qp) [mm^3, mm^2]."""
    axes = space.table.gradient.shape[-1]
    return np.linalg.det(np.einsum("eai,qab->eqib", X[space.element_nodes][..., :axes], space.table.gradient))


def deformation_gradients(space: AnySpace, X: np.ndarray, x: np.ndarray) -> np.ndarray:
    """F = dx/dX at quadrature points: X, x (n_nodes, 3) [mm] -> (n_elements, n_qp, 3, 3) [1]."""
    cells = space.element_nodes
    return np.asarray(_gradients(_Tables(space), X[cells], x[cells]))


_kept_shares = jax.jit(kept_share, static_argnums=1, compiler_options=COMPILER)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _gradients(tables, X_cells, x_cells):
    return deformation_gradient(X_cells, x_cells, tables.bulk.gradient)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _dilations(tables, X_cells, x_cells, bulk):
    return dilation(X_cells, x_cells, bulk, tables.bulk)


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
def _filled_gradients(tables, X_cells, x_cells, bulk):
    return filled_gradient(X_cells, x_cells, bulk, tables.bulk)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _energies(tables, X_cells, x_cells, bulk):
    return bulk_energy(X_cells, x_cells, bulk, tables.bulk)


@partial(jax.jit, static_argnums=0, compiler_options=COMPILER)
def _skin_energies(tables, X_edges, x_edges, membrane):
    return membrane_energy(X_edges, x_edges, membrane, tables.edge)


KERNELS = (
    _dilations,
    _forces,
    _linearisations,
    _skin_tangents,
    _reference_linearisations,
    _reference_skin_tangents,
    _filled_gradients,
    _energies,
    _skin_energies,
    _gradients,
    _kept_shares,
)


def compiled_variants() -> int:
    """How many variants of the kernels have been compiled in this process; a healing cycle must not raise it."""
    return sum(f._cache_size() for f in KERNELS)


def mean_energy(body: Body, X: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Strain energy density, mean over each element (n_elements,) [kPa]."""
    weights = body.volumes(X)
    return np.sum(body.energy_density(X, x) * weights, axis=1) / np.sum(weights, axis=1)
