"""Fascia behind the breast: it slides along the chest wall on tangential springs and does not open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..geometry.distance import Distance
from .elements import tangent
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
    density = _density(_at_points(X, table), _at_points(x, table), springs)
    return jnp.asarray(jnp.sum(_extents(X, table) * density, axis=-1))


def spring_force(X: Array, x: Array, springs: Springs, table: Table) -> Array:
    """Return the forces of the springs at the nodes, per depth: X, x (n, 3 or 6, 3) [mm] -> same shape [mN/mm]."""
    traction = _traction(_at_points(X, table), _at_points(x, table), springs)
    return jnp.einsum("eq,eqi,qa->eai", _extents(X, table), traction, table.value)


def spring_tangent(X: Array, x: Array, springs: Springs, table: Table) -> Array:
    """Return the derivative of the forces with respect to x: (n, a, 3) [mm] twice -> (n, 3a, 3a) [mN/mm^2]."""
    here, there = _at_points(X, table), _at_points(x, table)
    rate = _derivative(lambda p: _traction(here, p, springs), there)
    return _to_nodes(_extents(X, table), rate, table)


def reference_spring_tangent(X: Array, x: Array, springs: Springs, table: Table) -> Array:
    """Return the derivative of the forces with respect to X: (n, a, 3) [mm] twice -> (n, 3a, 3a) [mN/mm^2]."""
    here, there = _at_points(X, table), _at_points(x, table)
    rate = _derivative(lambda p: _traction(p, there, springs), here)
    lever = jnp.einsum("eqi,qa->eqai", _traction(here, there, springs), table.value)
    swept = tangent(lambda Y: _extents(Y, table), X)
    grown = jnp.einsum("eqai,eqm->eaim", lever, swept).reshape(len(X), 3 * X.shape[1], -1)
    return _to_nodes(_extents(X, table), rate, table) + grown


def _at_points(X: Array, table: Table) -> Array:
    """Return the positions of the quadrature points of facets: (n, a, 3) -> (n, n_qp, 3) [mm]."""
    return jnp.einsum("eai,qa->eqi", X, table.value)


def _density(here: Array, there: Array, springs: Springs) -> Array:
    """Return the energy per reference area at points: their places at rest and now (n, n_qp, 3) [mm] -> (n, n_qp) [kPa mm]."""
    lifted = springs.wall.at(there) - springs.wall.at(here)
    slid = jnp.sum((there - here) ** 2, axis=-1)
    return jnp.asarray(0.5 * springs.normal * lifted**2 + 0.5 * springs.along[:, None] * slid)


def _traction(here: Array, there: Array, springs: Springs) -> Array:
    """Return the force of the springs per reference area at points: two (n, n_qp, 3) [mm] -> (n, n_qp, 3) [kPa]."""
    return jax.grad(lambda p: jnp.sum(_density(here, p, springs)))(there)


def _derivative(function: Callable[[Array], Array], points: Array) -> Array:
    """Return the derivative of a vector at each point with respect to that point: points (n, n_qp, 3) -> (n, n_qp, 3, 3)."""
    along = [jax.jvp(function, (points,), (jnp.broadcast_to(axis, points.shape),))[1] for axis in np.eye(3)]
    return jnp.stack(along, axis=-1)


def _to_nodes(extents: Array, rate: Array, table: Table) -> Array:
    """Return the matrices of facets from the derivatives of the traction (n, n_qp, 3, 3): -> (n, 3a, 3a)."""
    n, a = len(rate), table.value.shape[1]
    return jnp.einsum("eq,eqij,qa,qb->eaibj", extents, rate, table.value, table.value).reshape(n, 3 * a, 3 * a)


def _extents(X: Array, table: Table) -> Array:
    """Return the length [mm] or area [mm^2] of the quadrature points of edges or faces: (n, 3 or 6, 3) [mm] -> (n, n_qp)."""
    tangents = jnp.einsum("eai,qab->eqib", X, table.gradient)
    if tangents.shape[-1] == 1:
        return jnp.asarray(table.weight * jnp.sqrt(jnp.sum(tangents[..., :2, 0] ** 2, axis=-1)))
    normal = jnp.cross(tangents[..., 0], tangents[..., 1])
    return jnp.asarray(table.weight * jnp.sqrt(jnp.sum(normal**2, axis=-1)))
