"""A body of tetrahedra from arrays: space, tissue and supports."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...core.units import seconds_from_hours
from ...geometry.tetrahedra import EDGES
from ...mechanics.body import Body
from .case import HistoryTable


def moved(body: Body, displacement: np.ndarray) -> np.ndarray:
    """Where fixed nodes are held: displacement (n, 3) [mm] of the given nodes -> (n_nodes, 3) [mm].

    Added middles of edges go half the way of both ends.
    """
    space = body.frame.space
    held_at = space.positions.copy()
    held_at[: len(displacement)] += displacement
    one, other = np.array(EDGES).T
    middles = space.element_nodes[:, 4:]
    added = middles >= len(displacement)
    corners = space.element_nodes[:, :4]
    held_at[middles[added]] = 0.5 * (held_at[corners[:, one]] + held_at[corners[:, other]])[added]
    return held_at


def instants(history: HistoryTable) -> np.ndarray:
    """Times [s] and shares of the loads at which a body is led through them: (n, 2), equal steps per segment."""
    corners = np.stack([seconds_from_hours(np.array(history.time_h)), np.array(history.share)], axis=1)
    k = np.arange(1, history.steps_per_segment + 1)[:, None] / history.steps_per_segment
    return np.vstack([corners[:1], *(a + k * (b - a) for a, b in pairwise(corners))])
