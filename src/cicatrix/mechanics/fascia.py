"""Fascia behind the breast: it slides along the chest wall on tangential springs and does not open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..geometry.distance import Distance
from .space import Table

NORMAL_KPA_PER_MM = (
    30.0  # stiffness against lifting off and sinking in: 1 kPa, more than the weight of a breast, moves 0.03 mm
)


@dataclass(frozen=True, eq=False)
class Fascia:
    r"""Springs between the deep side of the breast and the chest wall, which does not move.

    .. math:: \psi = \frac{k_n}{2} [d(x) - d(X)]^2 + \frac{k_t}{2} |x - X|^2

    per reference area, with the signed distance d to the wall: a point of the fascia keeps its distance from the wall
    also where the wall is curved, and is pulled back to where it was. On a flat wall the stiffness along the
    normal is :math:`k_n + k_t`.

    Parameters
    ----------
    wall : Distance
        Signed distance to the chest wall.
    along : float or (n_facets,) array [kPa/mm]
        Stiffness k_t of the springs on each facet.
    normal : float [kPa/mm]
        Stiffness k_n against a change of the distance to the wall.

    Raises
    ------
    InputError
        If a stiffness is negative.
    """

    wall: Distance
    along: np.ndarray | float
    normal: float = NORMAL_KPA_PER_MM

    def __post_init__(self) -> None:
        for name, value in (("along", self.along), ("normal", self.normal)):
            if not np.all(np.asarray(value) >= 0.0):
                least = float(np.min(value))
                raise InputError(f"The fascia's stiffness {name} the wall must not be negative; got {least:g} kPa/mm.")

    def scaled(self, factor: float) -> Fascia:
        """Return springs that are stiffer along the wall by a factor."""
        return Fascia(self.wall, factor * np.asarray(self.along), self.normal)

    def on(self, n_facets: int) -> Springs:
        """Return the springs of a number of facets, as arrays."""
        return Springs(self.wall, np.broadcast_to(np.asarray(self.along, float), n_facets), self.normal)


class Springs(NamedTuple):
    """Springs of the fascia on facets, as arguments of compiled functions."""

    wall: Distance
    along: Array | np.ndarray
    """Stiffness along the wall (n_facets,) [kPa/mm]."""
    normal: Array | float
    """Stiffness against a change of the distance to the wall [kPa/mm]."""


def spring_energy(X: Array, x: Array, springs: Springs, table: Table) -> Array:
    """Return the energy of each facet, per depth: X, x (n, 3 or 6, 3) [mm], edges or faces -> (n,) [mN]."""
    here, there = (jnp.einsum("eai,qa->eqi", y, table.value) for y in (X, x))
    stretched = springs.wall.at(there) - springs.wall.at(here)
    moved = jnp.sum((there - here) ** 2, axis=-1)
    density = 0.5 * springs.normal * stretched**2 + 0.5 * springs.along[:, None] * moved
    return jnp.asarray(jnp.sum(table.weight * _extent(X, table) * density, axis=-1))


def _extent(X: Array, table: Table) -> Array:
    """Return the length element of edges [mm], or the area element of faces [mm^2]: (n, 3 or 6, 3) [mm] -> (n, n_qp)."""
    tangents = jnp.einsum("eai,qab->eqib", X, table.gradient)
    if tangents.shape[-1] == 1:
        return jnp.sqrt(jnp.sum(tangents[..., :2, 0] ** 2, axis=-1))
    normal = jnp.cross(tangents[..., 0], tangents[..., 1])
    return jnp.sqrt(jnp.sum(normal**2, axis=-1))


def spring_force(X: Array, x: Array, springs: Springs, table: Table) -> Array:
    """Return the forces of the springs at the nodes, per depth: X, x (n, 3 or 6, 3) [mm] -> same shape [mN/mm]."""
    if not len(X):
        return jnp.zeros_like(x)
    return jax.grad(lambda y: jnp.sum(spring_energy(X, y, springs, table)))(x)
