"""One body, several ranks: to each its elements, and the rows of its nodes."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np

from ..core.errors import InvariantError
from ..core.ranks import Ranks
from ..numerics.krylov import Layout
from .body import Body, Frame
from .space import SolidSpace


def shared(body: Body, ranks: Ranks) -> Body:
    """Take this rank's part of a body: its own elements and all nodes; sums over elements are those over all ranks.

    Nodal vectors are whole on every rank and bit by bit alike, so that all take the same decisions.

    Parameters
    ----------
    body : Body
        A solid without skin, pressure and sliding nodes, whole and the same on every rank.
    ranks : Ranks
        Who shares it.
    """
    frame = body.frame
    if not isinstance(frame.space, SolidSpace) or frame.skin_facets.size or frame.sliding_nodes.size:
        raise InvariantError("ranks share bodies of tetrahedra without skin, pressure and sliding nodes only")
    n, cells = frame.space.n_elements, frame.space.element_nodes
    mine = bisected(frame.space.positions[cells].mean(axis=1), ranks.size) == ranks.rank
    part = Frame(replace(frame.space, element_nodes=cells[mine]), frame.skin_facets, frame.fixed_nodes, ranks=ranks)
    law = jax.tree.map(lambda leaf: leaf[mine] if np.ndim(leaf) and len(leaf) == n else leaf, body.law)
    return replace(body, frame=part, law=law, density=body.density[mine], fraction=body.fraction[mine])


def layout_of(frame: Frame) -> Layout:
    """Rows of the free nodes of a shared solid: a node is of the first rank that has an element at it."""
    n, ranks = frame.space.n_nodes, frame.ranks
    touched = np.zeros(n, np.uint8)
    touched[frame.space.element_nodes] = 1
    by_rank = np.array([np.frombuffer(part, np.uint8) for part in ranks.gather(touched.tobytes())])
    dofs, _ = frame.solved(False)
    nodes = dofs.reshape(-1, 3)[:, 0] // 3
    return Layout(ranks, by_rank.argmax(axis=0)[nodes], frame.space.positions[nodes])


def bisected(centres: np.ndarray, n_parts: int) -> np.ndarray:
    """Cut points (n, 3) [mm] into parts of equal size, across the longest side each time: number of each one's part (n,)."""
    part = np.zeros(len(centres), int)
    if n_parts == 1:
        return part
    along = centres[:, np.ptp(centres, axis=0).argmax()]
    first, upper = n_parts // 2, np.argsort(along, kind="stable")[len(centres) * (n_parts // 2) // n_parts :]
    part[upper] = first + bisected(centres[upper], n_parts - first)
    lower = np.setdiff1d(np.arange(len(centres)), upper)
    part[lower] = bisected(centres[lower], first)
    return part
