"""A course of healing by fields as a checkpoint holds it, and the network that its cells sense by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from ..healing.fields import Course, WoundState
from ..healing.scarring import Local
from ..study.fields import Network
from ..study.wound_case import NetworkTable
from .networks import read_network


def course_arrays(course: Course) -> dict[str, np.ndarray]:
    """States that the next step looks back to."""
    return {f"{k}.{j}": leaf for k, state in enumerate(course.past) for j, leaf in enumerate(jax.tree.leaves(state))}


def course_scalars(course: Course) -> dict[str, Any]:
    """Its clock."""
    return {
        "step": course.step,
        "taken": course.taken,
        "rejected": course.rejected,
        "iterations": course.iterations,
        "last": course.last,
        **{f"time.{k}": t for k, t in enumerate(course.times)},
    }


def course_from(arrays: Mapping[str, np.ndarray], scalars: Mapping[str, Any]) -> Course:
    """The course that they are of."""
    n = sum(name.startswith("time.") for name in scalars)
    leaves = 2 + len(Local._fields)
    past = []
    for k in range(n):
        x, fields, *local = (arrays[f"{k}.{j}"] for j in range(leaves))
        past.append(WoundState(x, fields, Local(*local)))
    times = tuple(scalars[f"time.{k}"] for k in range(n))
    return Course(tuple(past), times, *(scalars[name] for name in ("step", "taken", "rejected", "iterations", "last")))


def network_of(table: object) -> Network | None:
    """Read the network that cells sense by and its start, if the table of mechanosensing names one."""
    if not isinstance(table, NetworkTable):
        return None
    model = read_network(table.species, table.reactions, table.inhibition)
    return model.law, model.start
