"""Batched element forces; their tangents are derivatives of the same functions, never written twice.

A section is one slice of a body that is uniform along its normal: positions are x(s, t) + z e3 with three components
each, so deformation gradients are 3 x 3 and gravity may have a component along the normal (antiplane shear). With no
such component this is plane strain.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.tensors import cofactor, det, inv, product
from ..materials.material import EnergyMaterial
from .space import Table

NORMAL = np.array([0.0, 0.0, 1.0])


class Bulk(NamedTuple):
    """What fills the elements; leaves broadcast against (n_elements, n_qp)."""

    law: EnergyMaterial
    density: Array
    """Mass per reference volume (n_elements, n_qp) [kg/mm^3]."""
    fraction: Array
    """Share of each element that is tissue (n_elements,) [1]."""


class Membrane(NamedTuple):
    """Skin: an incompressible membrane along boundary edges."""

    law: EnergyMaterial
    thickness: Array
    """Reference thickness (n_edges,) [mm]."""
    wrinkling_strain: Array
    """Shortening at which it wrinkles [1]."""


def local_map(x: Array, gradient: np.ndarray) -> Array:
    """Derivative of position by the local axes and the normal: x (n, n_shape, 3) -> (n, n_qp, 3, 3) [mm]."""
    columns = jnp.einsum("eai,qab->eqib", x, gradient)
    normal = jnp.broadcast_to(NORMAL, (*columns.shape[:2], 3))
    return jnp.concatenate([columns, normal[..., None]], axis=-1)


def deformation_gradient(X: Array, x: Array, gradient: np.ndarray) -> Array:
    """F = dx/dX at quadrature points: X, x (n, n_shape, 3) [mm] -> (n, n_qp, 3, 3) [1]."""
    return product(local_map(x, gradient), inv(local_map(X, gradient)))


def linear_projection(points: np.ndarray, weights: Array) -> Array:
    """L2 projection on linear functions of each element, quadrature points to quadrature points.

    points (n_qp, 2) local coordinates, weights (n, n_qp) -> (n, n_qp, n_qp).
    """
    basis = np.column_stack([np.ones(len(points)), points - 1.0 / 3.0])
    mass = jnp.einsum("eq,qi,qj->eij", weights, basis, basis)
    return jnp.einsum("qi,eij,rj,er->eqr", basis, inv(mass), basis, weights)


def dilated(F: Array, J_bar: Array) -> Array:
    """F with its volume ratio replaced: (J_bar / J)^(1/3) F, (..., 3, 3) -> (..., 3, 3) [1]."""
    return jnp.cbrt(J_bar / det(F))[..., None, None] * F


def kinematics(X: Array, x: Array, table: Table) -> tuple[Array, Array, Array]:
    """F [1], L2 projection on linear functions, and weights [mm^2] at quadrature points: X, x (n, a, 3) [mm]."""
    X_map = local_map(X, table.gradient)
    weights = table.weight * jnp.abs(det(X_map))  # the mesh library orients triangles either way
    return product(local_map(x, table.gradient), inv(X_map)), linear_projection(table.points, weights), weights  # pyright: ignore[reportReturnType]


def dilation(X: Array, x: Array, bulk: Bulk, table: Table) -> Array:
    """Element-wise linear projection J_bar of the volume ratio, at quadrature points: X, x (n, 7, 3) [mm] -> (n, n_qp).

    Pressure and volume then live in the discontinuous linear space, which with the bubble is stable and of full order
    however incompressible the tissue (Crouzeix & Raviart 1973; three fields as in Simo, Taylor & Pister 1985).
    """
    F, projection, _ = kinematics(X, _tissue_only(X, x, bulk), table)
    return jnp.einsum("eqr,er->eq", projection, det(F))


def bulk_energy(X: Array, x: Array, bulk: Bulk, table: Table) -> Array:
    """Strain energy per reference volume at quadrature points: X, x (n, 7, 3) [mm] -> (n, n_qp) [kPa]."""
    F, _, _ = kinematics(X, _tissue_only(X, x, bulk), table)
    return bulk.law.energy(dilated(F, dilation(X, x, bulk, table)))


def _tissue_only(X: Array, x: Array, bulk: Bulk) -> Array:
    """Leave open elements undeformed: whatever their nodes do, nothing of it, not even a NaN, reaches the tissue."""
    return jnp.where(bulk.fraction[:, None, None] > 0.0, x, X)


def point_stress(law: EnergyMaterial, F: Array, J_bar: Array, pressure: Array) -> tuple[Array, Array]:
    r"""Stress that does the work on F, and mean stress conjugate to J_bar: (..., 3, 3), (...), (...) [1, 1, kPa].

    With :math:`\bar F = (\bar J / J)^{1/3} F` and :math:`\bar P = P(\bar F)` the virtual work of the element is
    :math:`\int (s \bar P - t F^{-T} + \pi\, \mathrm{cof} F) : \delta F`, :math:`s = (\bar J/J)^{1/3}`,
    :math:`t = \bar P : \bar F / 3`, :math:`\pi` (``pressure``) the projection of the mean stress :math:`t / \bar J`.
    """
    J = det(F)
    F_bar = dilated(F, J_bar)
    P_bar = law.stress(F_bar)
    t = jnp.sum(P_bar * F_bar, axis=(-2, -1)) / 3.0
    P = jnp.cbrt(J_bar / J)[..., None, None] * P_bar + (pressure - t / J)[..., None, None] * cofactor(F)
    return P, t / J_bar


def slopes(X: Array, table: Table) -> Array:
    """Gradients of the shape functions along the element's axes: X (n, a, 3) [mm] -> (n, n_qp, a, n_axes) [1/mm]."""
    axes = table.gradient.shape[-1]  # nothing changes along a section's normal
    return jnp.einsum("qab,eqbJ->eqaJ", table.gradient, inv(local_map(X, table.gradient))[..., :axes, :axes])


def bulk_force(X: Array, x: Array, J_bar: Array, bulk: Bulk, gravity: Array, table: Table) -> Array:
    """Internal minus gravity forces per depth on the nodes: X, x (n, 7, 3) [mm], J_bar (n, n_qp) -> (n, 7, 3) [mN/mm]."""
    F, projection, weights = kinematics(X, _tissue_only(X, x, bulk), table)
    P, _ = point_stress(bulk.law, F, J_bar, _pressure(bulk.law, F, J_bar, projection))
    weights = weights * bulk.fraction[:, None]
    B = slopes(X, table)
    internal = jnp.einsum("eq,eqiJ,eqaJ->eai", weights, P[..., : B.shape[-1]], B)
    mass = weights * bulk.density
    return internal - jnp.einsum("eq,qa->ea", mass, table.value)[..., None] * gravity


def _pressure(law: EnergyMaterial, F: Array, J_bar: Array, projection: Array) -> Array:
    """Projection of the mean stress (n, n_qp) [kPa]."""
    _, mean_stress = point_stress(law, F, J_bar, jnp.zeros_like(J_bar))
    return jnp.einsum("eqr,er->eq", projection, mean_stress)


class Linearised(NamedTuple):
    """First order of ``bulk_force`` about (x, J_bar), with J_bar then tied to x again: J_bar + dJ_bar = J_bar(x + dx)."""

    stiffness: Array
    """Change of force by dx (n, 21, 21) [mN/mm^2]."""
    force_rate: Array
    """Change of force by J_bar at each quadrature point (n, n_qp, 21) [mN/mm]."""
    volume_rate: Array
    """Change of J_bar(x) by dx (n, n_qp, 21) [1/mm]; 0 in open elements."""


def linearised(X: Array, x: Array, J_bar: Array, bulk: Bulk, table: Table) -> Linearised:
    """Contract the point tangents to element matrices; ``tangent`` of ``tied_force`` is the slow twin where J_bar = J_bar(x)."""
    x = _tissue_only(X, x, bulk)
    F, projection, weights = kinematics(X, x, table)
    B = slopes(X, table)
    n, n_qp, a, axes = B.shape
    by_F, by_J = _point_derivatives(bulk.law, F, J_bar, _pressure(bulk.law, F, J_bar, projection), axes)
    weights = (weights * bulk.fraction[:, None])[..., None]

    def to_nodes(P: Array) -> Array:
        return jnp.einsum("eqaJ,eqiJ->eqai", B, P).reshape(n, n_qp, 3 * a)

    dJ = jnp.einsum("eqr,erm->eqm", projection, to_nodes(cofactor(F)[..., :axes]))
    per_volume = weights * (to_nodes(by_J[0][..., :axes]) + by_J[1][..., None] * dJ)
    A = weights[..., None, None, None] * by_F[0]
    K = jnp.einsum("eqaJ,eqJikb->eaikb", B, jnp.einsum("eqiJkL,eqbL->eqJikb", A, B))
    K = jnp.swapaxes(K, -1, -2).reshape(n, 3 * a, 3 * a)
    K += jnp.swapaxes(per_volume, 1, 2) @ dJ + jnp.swapaxes(weights * dJ, 1, 2) @ to_nodes(by_F[1])
    has_tissue = (bulk.fraction > 0.0)[:, None, None]
    return Linearised(K, per_volume, jnp.where(has_tissue, dJ, 0.0))


def tied_force(X: Array, x: Array, bulk: Bulk, gravity: Array, table: Table) -> Array:
    """``bulk_force`` at J_bar = J_bar(x), the gradient of the energy: X, x (n, 7, 3) [mm] -> (n, 7, 3) [mN/mm]."""
    return bulk_force(X, x, dilation(X, x, bulk, table), bulk, gravity, table)


def _point_derivatives(law: EnergyMaterial, F: Array, J_bar: Array, pressure: Array, axes: int):
    """Derivatives of ``point_stress`` by F (..., 3, axes) along the element's axes, and by J_bar.

    Returns (A (..., 3, axes, 3, axes), b (..., 3, axes)) and ((..., 3, 3), (...)).
    """
    _, along = jax.linearize(lambda G, j: point_stress(law, G, j, pressure), F, J_bar)
    directions = np.eye(9).reshape(3, 3, 3, 3)[:, :axes].reshape(3 * axes, 3, 3)
    A, b = jax.vmap(lambda d: along(jnp.broadcast_to(d, F.shape), jnp.zeros_like(J_bar)))(directions)
    shape = (*F.shape[:-2], 3, axes)
    by_F = jnp.moveaxis(A[..., :axes], 0, -1).reshape(*shape, 3, axes), jnp.moveaxis(b, 0, -1).reshape(shape)
    return by_F, along(jnp.zeros_like(F), jnp.ones_like(J_bar))


def membrane_energy(X: Array, x: Array, membrane: Membrane, table: Table) -> Array:
    r"""Strain energy per depth of each skin edge: X, x (n, 3, 3) [mm] -> (n,) [mN]; its thickness keeps the volume.

    A stiff film on soft tissue wrinkles when it is shortened by more than a small strain, and then bears no more than
    the load at which it wrinkled (Allen 1969). Wrinkles are finer than the mesh, so this is the energy averaged over them:
    the law's own where the edge is stretched; where it is shortened by :math:`\epsilon`, :math:`k \epsilon_w [\epsilon -
    \epsilon_w (1 - e^{-\epsilon/\epsilon_w})]`, whose stress starts with the law's modulus k and ends at
    :math:`k \epsilon_w`. It is smooth, and its tangent never negative.
    """
    X_s = jnp.einsum("eai,qa->eqi", X, table.gradient[..., 0])
    x_s = jnp.einsum("eai,qa->eqi", x, table.gradient[..., 0])
    length = jnp.sqrt(X_s[..., 0] ** 2 + X_s[..., 1] ** 2)
    stretch = jnp.sqrt(x_s[..., 0] ** 2 + x_s[..., 1] ** 2) / length
    shear = (x_s[..., 2] - X_s[..., 2]) / length
    shortening = jnp.maximum(1.0 - stretch, 0.0)
    limit = membrane.wrinkling_strain
    wrinkles = film_modulus(membrane.law) * limit * (shortening + limit * jnp.expm1(-shortening / limit))
    W = membrane.law.energy(film(jnp.maximum(stretch, 1.0), shear)) + wrinkles
    return membrane.thickness * jnp.sum(table.weight * length * W, axis=-1)


def film(stretch: Array, shear: Array) -> Array:
    """Deformation gradient (..., 3, 3) of an incompressible film in its own axes: edge, thickness, normal of the section."""
    zero, one = jnp.zeros_like(stretch), jnp.ones_like(stretch)
    rows = [[stretch, zero, zero], [zero, 1.0 / stretch, zero], [shear, zero, one]]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def film_modulus(law: EnergyMaterial) -> Array:
    """Second derivative of the film's energy by stretch at rest [kPa]; 4 mu for a neo-Hookean law."""
    one = jnp.ones(())
    return jax.grad(jax.grad(lambda s: law.energy(film(s, 0.0 * s))))(one)


def wrinkling_strain(E_film: float, E_below: float) -> float:
    """Compression at which a stiff film on a soft half-space wrinkles: (3 E_below / E_film)^(2/3) / 4 [1].

    Source: Allen, Analysis and design of structural sandwich panels (1969), for equal Poisson ratios.
    """
    return 0.25 * (3.0 * E_below / E_film) ** (2.0 / 3.0)


def membrane_force(X: Array, x: Array, membrane: Membrane, table: Table) -> Array:
    """Forces per depth of the skin on the nodes: X, x (n, 3, 3) [mm] -> (n, 3, 3) [mN/mm]."""
    return jax.grad(lambda y: jnp.sum(membrane_energy(X, y, membrane, table)))(x)


def tangent(force, x: Array) -> Array:
    """Derivative of batched element forces by batched node positions: (n, a, 3) -> (n, 3a, 3a) [mN/mm^2].

    Elements are independent, so one directional derivative per node component serves the whole batch.
    """
    n, a, c = x.shape
    directions = jnp.eye(a * c).reshape(a * c, a, c)
    columns = jax.vmap(lambda d: jax.jvp(force, (x,), (jnp.broadcast_to(d, x.shape),))[1])(directions)
    return jnp.moveaxis(columns.reshape(a * c, n, a * c), 0, -1)
