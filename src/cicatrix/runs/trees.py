"""Convert pytrees of arrays to named arrays of a checkpoint, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np


def packed_tree(tree: Any) -> dict[str, np.ndarray]:
    """Return the leaves of a pytree by number: ``leaf.0``, ``leaf.1``, ..."""
    return {f"leaf.{number}": np.asarray(leaf) for number, leaf in enumerate(jax.tree.leaves(tree))}


def unpacked_tree(form: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """Return a pytree with the structure of ``form`` and the leaves in ``arrays``, as named by ``packed_tree``."""
    structure = jax.tree.structure(form)
    return jax.tree.unflatten(structure, [arrays[f"leaf.{number}"] for number in range(structure.num_leaves)])
