"""Distribution of the elements of a body, and of the matrix rows of its nodes, over MPI ranks."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np

from ..core.errors import InvariantError
from ..core.ranks import Ranks
from ..numerics.krylov import Layout
from .body import Body, Discretization
from .space import SolidSpace


def shared(body: Body, ranks: Ranks) -> Body:
    """Return the part of a body that this rank computes, with some of the elements and all nodes.

    Sums over elements include those of all ranks. Nodal vectors are complete and bitwise identical on every rank, so that
    all ranks take the same decisions.

    Parameters
    ----------
    body : Body
        A solid without skin, pressure and sliding nodes, complete and identical on every rank.
    ranks : Ranks
        Ranks that share the body.
    """
    discretization = body.discretization
    if (
        not isinstance(discretization.space, SolidSpace)
        or discretization.skin_facets.size
        or discretization.sliding_nodes.size
    ):
        raise InvariantError("ranks can share only bodies of tetrahedra without skin, pressure and sliding nodes")
    n, cells = discretization.space.n_elements, discretization.space.element_nodes
    mine = bisected(discretization.space.positions[cells].mean(axis=1), ranks.size) == ranks.rank
    part = Discretization(
        replace(discretization.space, element_nodes=cells[mine]),
        discretization.skin_facets,
        discretization.fixed_nodes,
        ranks=ranks,
    )
    law = jax.tree.map(lambda leaf: leaf[mine] if np.ndim(leaf) and len(leaf) == n else leaf, body.law)
    return replace(body, discretization=part, law=law, density=body.density[mine], fraction=body.fraction[mine])


def layout_of(discretization: Discretization) -> Layout:
    """Assign the matrix rows of each free node of a shared solid to the first rank that has an element with this node."""
    n, ranks = discretization.space.n_nodes, discretization.ranks
    touched = np.zeros(n, np.uint8)
    touched[discretization.space.element_nodes] = 1
    by_rank = np.array([np.frombuffer(part, np.uint8) for part in ranks.gather(touched.tobytes())])
    dofs, _ = discretization.solved(False)
    nodes = dofs.reshape(-1, 3)[:, 0] // 3
    return Layout(ranks, by_rank.argmax(axis=0)[nodes], discretization.space.positions[nodes])


def bisected(centres: np.ndarray, n_parts: int) -> np.ndarray:
    """Divide points (n, 3) [mm] into equal parts by recursive bisection along the longest side; return part numbers (n,)."""
    part = np.zeros(len(centres), int)
    if n_parts == 1:
        return part
    along = centres[:, np.ptp(centres, axis=0).argmax()]
    first, upper = n_parts // 2, np.argsort(along, kind="stable")[len(centres) * (n_parts // 2) // n_parts :]
    part[upper] = first + bisected(centres[upper], n_parts - first)
    lower = np.setdiff1d(np.arange(len(centres)), upper)
    part[lower] = bisected(centres[lower], first)
    return part
