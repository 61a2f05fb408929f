"""Batched element forces, energies and tangents.

A section is one slice of a body that is uniform along its normal: positions are x(s, t) + z e3 with three components
each, so deformation gradients are 3 x 3 and gravity may have a component along the normal (antiplane shear). With no
such component this is plane strain. Quantities "per depth" of a section are totals for a solid: read mN for mN/mm, mm^3
for mm^2.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..materials.material import Material
from ..numerics.tensors import cofactor, det, inv, product
from .space import Table

NORMAL = np.array([0.0, 0.0, 1.0])


class Bulk(NamedTuple):
    """Material of the elements: law, density and volume fraction of the tissue, per element or quadrature point."""

    law: Material
    density: Array | np.ndarray
    """Mass per reference volume (n_elements, n_qp) [kg/mm^3]."""
    fraction: Array | np.ndarray
    """Fraction of each element that is tissue (n_elements,) [1]."""
    fluctuation_fraction: Array | np.ndarray
    """Fraction of the fluctuation of det F in each element that J_bar retains (n_elements,) [1]."""


class Membrane(NamedTuple):
    """Skin, an incompressible membrane on boundary edges (section) or faces (solid), and the pressure on these faces."""

    law: Material
    thickness: Array | np.ndarray
    """Reference thickness (n_facets,) [mm]."""
    wrinkling_strain: Array | float
    """Compressive strain at which the skin wrinkles [1]."""
    pressure: Array | np.ndarray | float = 0.0
    """External pressure on a solid's faces, along their current normal (n_facets,) [kPa]."""
    prestretch: Array | float = 1.0
    """In-plane stretch in the reference configuration, equal in all directions [1]."""


def local_map(x: Array, gradient: np.ndarray) -> Array:
    """Return the derivative of position with respect to local coordinates: x (n, n_shape, 3) -> (n, n_qp, 3, 3) [mm].

    ``gradient`` are the derivatives of the shape functions (:class:`.space.Table`). In a section, the third column of the
    result is the unit normal of the section.
    """
    columns = jnp.einsum("eai,qab->eqib", x, gradient)
    if columns.shape[-1] == 3:
        return columns
    normal = jnp.broadcast_to(NORMAL, (*columns.shape[:2], 3))
    return jnp.concatenate([columns, normal[..., None]], axis=-1)


def deformation_gradient(X: Array, x: Array, gradient: np.ndarray) -> Array:
    """Return F = dx/dX at quadrature points: X, x (n, n_shape, 3) [mm] -> (n, n_qp, 3, 3) [1]."""
    return product(local_map(x, gradient), inv(local_map(X, gradient)))


def projection(basis: np.ndarray, weights: Array) -> Array:
    """Return the matrix of the L2 projection on a few basis functions in each element.

    The matrix acts on values at the quadrature points: basis (n_qp, 1 or 3), weights (n, n_qp) -> (n, n_qp, n_qp).
    """
    mass = jnp.einsum("eq,qi,qj->eij", weights, basis, basis)
    inverse = 1.0 / mass if basis.shape[1] == 1 else inv(mass)
    return jnp.einsum("qi,eij,rj,er->eqr", basis, inverse, basis, weights)


# bulk over shear modulus at a Poisson ratio of 0.499, up to which a P2 tetrahedron with four points does not lock
LOCKING_RATIO = 500.0


def fluctuation_fraction(law: Material, shape: tuple[int, ...]) -> Array:
    r"""Return the fraction of the fluctuation of det F in an element that J_bar retains in a solid (*shape) [1].

    At points with the leading shape ``shape`` it is :math:`\min(1, \sqrt{500 \mu / \kappa})`, with the moduli in the
    stress-free state.

    A P2 tetrahedron with four quadrature points has four volume constraints, about as many as it has degrees of freedom of its
    own, so it begins to lock beyond a Poisson ratio of 0.499. There the bulk modulus acts in full on the mean volume ratio of an
    element, and on the fluctuation as it would at 0.499 (reduced by the square of this fraction), so that the
    pressure can still vary within an element. Measured errors: docs/decisions/0013.
    """
    shear, bulk = law.moduli_at_rest(shape)
    return jnp.sqrt(jnp.clip(LOCKING_RATIO * shear / bulk, 0.0, 1.0))


def with_volume_ratio(F: Array, J_bar: Array) -> Array:
    """Return F with its volume ratio replaced by J_bar: (J_bar / J)^(1/3) F, (..., 3, 3) -> (..., 3, 3) [1]."""
    return jnp.cbrt(J_bar / det(F))[..., None, None] * F


class Smoothing(NamedTuple):
    """Operator that smooths volume ratio or pressure within each element; self-adjoint in the L2 inner product."""

    onto: Array
    """Matrix of the L2 projection in each element (n, n_qp, n_qp) [1]."""
    fluctuation_fraction: Array
    """Fraction of the fluctuation about the projection that is retained (n_elements,) [1]."""

    def projected(self, values: Array) -> Array:
        """Return the L2 projection of values at quadrature points, without fluctuation: (n, n_qp, ...) -> (n, n_qp, ...)."""
        return jnp.einsum("eqr,er...->eq...", self.onto, values)

    def split(self, values: Array) -> tuple[Array, Array]:
        """Return the two terms of ``smooth``: a * values, and (1 - a) * projected values, each (n, n_qp, ...).

        a is ``fluctuation_fraction``.
        """
        retained = self.fluctuation_fraction.reshape(-1, *[1] * (values.ndim - 1))
        return retained * values, (1.0 - retained) * self.projected(values)

    def smooth(self, values: Array) -> Array:
        """Return the projection plus the retained fraction of the fluctuation about it: (n, n_qp, ...) -> (n, n_qp, ...)."""
        return sum(self.split(values))  # pyright: ignore[reportReturnType]


def kinematics(X: Array, x: Array, bulk: Bulk, table: Table) -> tuple[Array, Smoothing, Array]:
    """Return F [1], the smoothing operator and integration weights [mm^2] at quadrature points: X, x (n, a, 3) [mm].

    Elements without tissue are treated as undeformed, so that their nodes cannot affect the tissue, not even by a NaN.
    """
    x = jnp.where(bulk.fraction[:, None, None] > 0.0, x, X)
    X_map = local_map(X, table.gradient)
    weights = table.weight * jnp.abs(det(X_map))  # the mesh library does not orient triangles consistently
    F: Array = product(local_map(x, table.gradient), inv(X_map))
    return F, Smoothing(projection(table.volume, weights), bulk.fluctuation_fraction), weights  # pyright: ignore[reportReturnType]


def volume_ratio(X: Array, x: Array, bulk: Bulk, table: Table) -> Array:
    """Return J_bar, the volume ratio projected in each element, at quadrature points: X, x (n, a, 3) [mm] -> (n, n_qp).

    In a section J_bar is linear: pressure and volume ratio are then discontinuous and linear, which with bubble functions is
    stable and of full order at any Poisson ratio (Crouzeix & Raviart 1973; three fields as in Simo, Taylor
    & Pister 1985). In a solid J_bar is the mean plus a fraction of the fluctuation about it (:func:`fluctuation_fraction`).
    """
    F, smoothing, _ = kinematics(X, x, bulk, table)
    return smoothing.smooth(det(F))


def law_gradient(X: Array, x: Array, bulk: Bulk, table: Table) -> Array:
    """Return F with volume ratio J_bar, the input of the law: X, x (n, a, 3) [mm] -> (n, n_qp, 3, 3) [1]."""
    F, smoothing, _ = kinematics(X, x, bulk, table)
    return with_volume_ratio(F, smoothing.smooth(det(F)))


def bulk_energy(X: Array, x: Array, bulk: Bulk, table: Table) -> Array:
    """Return strain energy per reference volume at quadrature points: X, x (n, a, 3) [mm] -> (n, n_qp) [kPa]."""
    return bulk.law.energy(law_gradient(X, x, bulk, table))


def point_stress(law: Material, F: Array, J_bar: Array, pressure: Array) -> tuple[Array, Array]:
    r"""Return the stress conjugate to F and the mean stress conjugate to J_bar: F (..., 3, 3), J_bar, pressure (...) [1, 1, kPa].

    With :math:`\bar F = (\bar J / J)^{1/3} F` and :math:`\bar P = P(\bar F)` the virtual work of the element is
    :math:`\int (s \bar P - t F^{-T} + \pi\, \mathrm{cof} F) : \delta F`, :math:`s = (\bar J/J)^{1/3}`,
    :math:`t = \bar P : \bar F / 3`, :math:`\pi` (``pressure``) the smoothed mean stress :math:`t / \bar J`.
    """
    J = det(F)
    F_bar = with_volume_ratio(F, J_bar)
    P_bar = law.stress(F_bar)
    t = jnp.sum(P_bar * F_bar, axis=(-2, -1)) / 3.0
    P = jnp.cbrt(J_bar / J)[..., None, None] * P_bar + (pressure - t / J)[..., None, None] * cofactor(F)
    return P, t / J_bar


class PointRates(NamedTuple):
    """Stress and mean stress of :func:`point_stress` at quadrature points, and their derivatives at fixed pressure."""

    P: Array
    """Stress conjugate to F (..., 3, 3) [kPa]."""
    mean: Array
    """Mean stress conjugate to J_bar (...) [kPa]."""
    P_by_F: Array
    """Derivative of P with respect to F (..., 3, 3, 3, 3) [kPa]."""
    mean_by_F: Array
    """Derivative of the mean stress with respect to F (..., 3, 3) [kPa]."""
    P_by_J: Array
    """Derivative of P with respect to J_bar (..., 3, 3) [kPa]."""
    mean_by_J: Array
    """Derivative of the mean stress with respect to J_bar (...) [kPa]."""


def point_rates(law: Material, F: Array, J_bar: Array, smoothing: Smoothing) -> PointRates:
    r"""Return the result of :func:`point_stress` and its derivatives, from the law's stress and tangent at :math:`\bar F`.

    F is (n, n_qp, 3, 3) [1] and J_bar (n, n_qp) [1]; the pressure is the mean stress smoothed in each element. By the chain
    rule, with :math:`\bar A = dP/dF` at :math:`\bar F`, :math:`h = \bar A : \bar F`, :math:`\tilde h = \bar F : \bar A`,
    :math:`q = (\bar F : h)/3 + t` and :math:`G = F^{-T}`: :math:`3\,dt/dF = s(\tilde h + \bar P) - qG` and

    .. math:: \frac{dP}{dF} = s^2 \bar A - \frac{s}{3} (h + \bar P) \otimes G - G \otimes \frac{dt}{dF}
        + J\pi\, G \otimes G - (J\pi - t) [G_{iL} G_{kJ}]_{iJkL}
    """
    J, F_bar = det(F), with_volume_ratio(F, J_bar)
    P_bar, A_bar, _ = law.response(F_bar)
    s, G = jnp.cbrt(J_bar / J)[..., None, None], cofactor(F) / J[..., None, None]
    right = jnp.sum(A_bar * F_bar[..., None, None, :, :], axis=(-2, -1)) + P_bar
    left = jnp.sum(A_bar * F_bar[..., :, :, None, None], axis=(-4, -3)) + P_bar
    t = jnp.sum(P_bar * F_bar, axis=(-2, -1)) / 3.0
    q = jnp.sum(right * F_bar, axis=(-2, -1)) / 3.0  # includes P_bar : F_bar / 3 = t
    t_by_F = (s * left - q[..., None, None] * G) / 3.0
    mean = t / J_bar
    swollen = J * smoothing.smooth(mean)
    square = G[..., :, :, None, None] * G[..., None, None, :, :]
    P_by_F = (
        (s * s)[..., None, None] * A_bar
        - (s * right / 3.0)[..., :, :, None, None] * G[..., None, None, :, :]
        - G[..., :, :, None, None] * t_by_F[..., None, None, :, :]
        + swollen[..., None, None, None, None] * square
        - (swollen - t)[..., None, None, None, None] * jnp.swapaxes(square, -3, -1)
    )
    P = s * P_bar + (swollen - t)[..., None, None] * G
    t_by_J = q / (3.0 * J_bar)
    P_by_J = (s * right / 3.0 - (q / 3.0)[..., None, None] * G) / J_bar[..., None, None]
    return PointRates(P, mean, P_by_F, t_by_F / J_bar[..., None, None], P_by_J, (t_by_J - mean) / J_bar)


def slopes(X: Array, table: Table) -> Array:
    """Return gradients of the shape functions along the spatial axes: X (n, a, 3) [mm] -> (n, n_qp, a, n_axes) [1/mm]."""
    axes = table.gradient.shape[-1]  # 2 for a section: no gradient along its normal
    return jnp.einsum("qab,eqbJ->eqaJ", table.gradient, inv(local_map(X, table.gradient))[..., :axes, :axes])


def bulk_force(X: Array, x: Array, J_bar: Array, bulk: Bulk, gravity: Array, table: Table) -> Array:
    """Return internal forces minus weight at the nodes of elements: X, x (n, a, 3) [mm], J_bar (n, n_qp) -> (n, a, 3) [mN/mm]."""
    F, smoothing, weights = kinematics(X, x, bulk, table)
    P, _ = point_stress(bulk.law, F, J_bar, smoothing.smooth(_mean_stress(bulk.law, F, J_bar)))
    weights = weights * bulk.fraction[:, None]
    B = slopes(X, table)
    internal = jnp.einsum("eq,eqiJ,eqaJ->eai", weights, P[..., : B.shape[-1]], B)
    mass = weights * bulk.density
    return internal - jnp.einsum("eq,qa->ea", mass, table.value)[..., None] * gravity


def _mean_stress(law: Material, F: Array, J_bar: Array) -> Array:
    """Return the mean stress conjugate to J_bar: F (n, n_qp, 3, 3), J_bar (n, n_qp) -> (n, n_qp) [kPa]."""
    return point_stress(law, F, J_bar, jnp.zeros_like(J_bar))[1]


class Linearised(NamedTuple):
    """Linearisation of ``bulk_force`` with respect to positions u (x or X), after elimination of the volume ratios J_bar.

    Element matrices are given by the factors from which :func:`..core.native.add_contracted` computes them.
    """

    slopes: Array
    """B: gradients of the shape functions along the spatial axes (n, n_qp, a, n_axes) [1/mm]."""
    tangent: Array
    """Tangent dP/dF at each point times its integration weight (n, n_qp, 3, n_axes, 3, n_axes)."""
    columns: Array
    """Left factors of m rank-one terms of each element matrix (n, m, 3a)."""
    rows: Array
    """Right factors of the m rank-one terms (n, m, 3a)."""
    force_rate: Array
    """Derivative of the nodal forces with respect to J_bar at each quadrature point (n, n_qp, 3a) [mN/mm]."""
    volume_rate: Array
    """Derivative of J_bar with respect to u (n, n_qp, 3a) [1/mm]; 0 in elements without tissue."""


class _Rates(NamedTuple):
    """Quantities at quadrature points from which the linearisations with respect to x and to X are computed."""

    F: Array
    """Deformation gradient (n, n_qp, 3, 3) [1]."""
    B: Array
    """Gradients of the shape functions along the spatial axes (n, n_qp, a, n_axes) [1/mm]."""
    smoothing: Smoothing
    weights: Array
    """Integration weights (n, n_qp, 1) [mm^2], 0 in elements without tissue."""
    P: Array
    """First Piola-Kirchhoff stress along the spatial axes (n, n_qp, 3, n_axes) [kPa]."""
    mean: Array
    """Mean stress (n, n_qp) [kPa]."""
    P_by_F: Array
    """Derivative of P with respect to F (n, n_qp, 3, n_axes, 3, n_axes) [kPa]."""
    mean_by_F: Array
    """Derivative of the mean stress with respect to F (n, n_qp, 3, n_axes) [kPa]."""
    volume_by_x: Array
    """Derivative of J_bar with respect to x (n, n_qp, 3a) [1/mm]."""
    force_by_volume: Array
    """Derivative of the nodal forces with respect to J_bar (n, n_qp, 3a) [mN/mm]."""


def _rates(X: Array, x: Array, J_bar: Array, bulk: Bulk, table: Table) -> _Rates:
    F, smoothing, weights = kinematics(X, x, bulk, table)
    B = slopes(X, table)
    axes = B.shape[-1]
    point = point_rates(bulk.law, F, J_bar, smoothing)
    weights = (weights * bulk.fraction[:, None])[..., None]
    volume_by_x = smoothing.smooth(_to_nodes(B, cofactor(F)[..., :axes]))
    force_by_volume = weights * (_to_nodes(B, point.P_by_J[..., :axes]) + point.mean_by_J[..., None] * volume_by_x)
    P, P_by_F, mean_by_F = point.P[..., :axes], point.P_by_F[..., :axes, :, :axes], point.mean_by_F[..., :axes]
    rates = _Rates(F, B, smoothing, weights, P, point.mean, P_by_F, mean_by_F, volume_by_x, force_by_volume)
    return jax.lax.optimization_barrier(rates)  # otherwise XLA recomputes them for each matrix entry that uses them


def _to_nodes(B: Array, P: Array) -> Array:
    """Return P : dF/du for each nodal component u: B (n, n_qp, a, n_axes), P (n, n_qp, 3, n_axes) -> (n, n_qp, 3a).

    B are the gradients of the shape functions.
    """
    return jnp.einsum("eqaJ,eqiJ->eqai", B, P).reshape(*B.shape[:2], -1)


def linearised(X: Array, x: Array, J_bar: Array, bulk: Bulk, table: Table) -> Linearised:
    """Linearise ``bulk_force`` with respect to the positions x.

    If J_bar = J_bar(x), the element matrices equal those of ``tangent`` applied to ``tied_force``, a slow reference.
    """
    r = _rates(X, x, J_bar, bulk, table)
    columns = jnp.concatenate([r.force_by_volume, r.weights * r.volume_by_x], axis=1)
    rows = jnp.concatenate([r.volume_by_x, _to_nodes(r.B, r.mean_by_F)], axis=1)
    tangent = r.weights[..., None, None, None] * r.P_by_F
    return Linearised(r.B, tangent, columns, rows, r.force_by_volume, _where_tissue(bulk, r.volume_by_x))


def linearised_reference(X: Array, x: Array, J_bar: Array, bulk: Bulk, gravity: Array, table: Table) -> Linearised:
    r"""Linearise ``bulk_force`` with respect to the reference positions X at fixed x.

    The slow reference is ``tangent`` applied to ``tied_force`` as a function of X. A shift of X with gradient H changes F by
    :math:`-FH`, the gradients B of the shape functions by :math:`-BH` and volumes by the factor 1 + tr H; gravity acts on
    mass per reference volume and changes with the volumes.
    """
    r = _rates(X, x, J_bar, bulk, table)
    axes = r.B.shape[-1]
    along = np.eye(3)[:axes]  # unit vectors of the element's axes
    swept = _to_nodes(r.B, jnp.broadcast_to(along.T, r.P.shape))  # tr H
    A = -jnp.einsum("eqiJmL,eqmk->eqiJkL", r.P_by_F, r.F)
    A += jnp.einsum("eqiJ,Lk->eqiJkL", r.P, along) - jnp.einsum("eqiL,Jk->eqiJkL", r.P, along)
    J = det(r.F)
    as_it_is, _ = r.smoothing.split(swept)
    mean_only = r.smoothing.split(r.smoothing.projected(J)[..., None] * swept)[1]
    volume_rate = -(J[..., None] * as_it_is + mean_only)
    excess = r.mean - r.smoothing.projected(r.mean)
    by_projection = r.smoothing.split(_to_nodes(r.B, cofactor(r.F)[..., :axes]))[1]
    by_mean = _to_nodes(r.B, jnp.einsum("eqiJ,eqik->eqkJ", r.mean_by_F, r.F))
    weight = (table.value[:, :, None] * gravity).reshape(len(table.value), -1)
    pairs = [
        (r.force_by_volume, volume_rate),
        (r.weights * by_projection, excess[..., None] * swept),
        (-r.weights * r.volume_by_x, by_mean),
        (-r.weights * bulk.density[..., None] * weight, swept),
    ]
    columns, rows = (jnp.concatenate(side, axis=1) for side in zip(*pairs))
    tangent = r.weights[..., None, None, None] * A
    return Linearised(r.B, tangent, columns, rows, r.force_by_volume, _where_tissue(bulk, volume_rate))


def _where_tissue(bulk: Bulk, rate: Array) -> Array:
    return jnp.where((bulk.fraction > 0.0)[:, None, None], rate, 0.0)


def tied_force(X: Array, x: Array, bulk: Bulk, gravity: Array, table: Table) -> Array:
    """Return ``bulk_force`` at J_bar = J_bar(x), the gradient of the energy: X, x (n, a, 3) [mm] -> (n, a, 3) [mN/mm]."""
    return bulk_force(X, x, volume_ratio(X, x, bulk, table), bulk, gravity, table)


def membrane_energy(X: Array, x: Array, membrane: Membrane, table: Table) -> Array:
    """Return the strain energy of each skin facet: X, x (n, 3, 3) or (n, 6, 3) [mm], edges or faces -> (n,) [mN].

    The thickness changes so that volume is preserved. A stiff film on soft tissue wrinkles when compressed by more than a
    small strain, and then carries no more than its wrinkling load (Allen 1969). Wrinkles are finer than the mesh,
    so this is the energy averaged over them.
    """
    extent, W = _tension_field(_tangents(X, table), _tangents(x, table), membrane)
    return jnp.asarray(membrane.thickness * jnp.sum(table.weight * extent * W, axis=-1))


def _tangents(x: Array, table: Table) -> Array:
    """Return the tangents of facets, of an edge along it and along the section's normal: (n, a, 3) -> (n, n_qp, 3, 2) [mm]."""
    along = jnp.einsum("eai,qab->eqib", x, table.gradient)
    if along.shape[-1] == 2:
        return along
    normal = jnp.broadcast_to(NORMAL, along.shape[:-1])
    return jnp.concatenate([along, normal[..., None]], axis=-1)


def _tension_field(X_map: Array, x_map: Array, membrane: Membrane) -> tuple[Array, Array]:
    r"""Return reference area element [mm^2] and energy density [kPa] of facets from their tangents (..., 3, 2) [mm].

    A tension-field energy (Pipkin 1986) with a small resistance to compression, in terms of the logarithms
    :math:`e_1 \ge e_2` of the principal stretches:

    .. math:: \Psi(a_1, a_2) + k \, [f(n) + f(p) + f'(n) f'(p) / 2], \qquad
        f(p) = \epsilon_w [p - \epsilon_w (1 - e^{-p/\epsilon_w})]

    The law is evaluated at the strains :math:`a_1 = \max(e_1, 0)` and :math:`a_2 = \max(e_2, -a_1/2)`. A film pulled along the
    first direction contracts along the second by up to half the strain :math:`a_1`, as in simple tension; if it is shorter than
    that along the second, it is slack there. :math:`p = \max(-a_1/2 - e_2, 0)` is this excess shortening along the second
    direction, :math:`n = \max(-e_1, 0)` the shortening along the first. First derivatives are continuous everywhere, second
    ones at rest; the energy is convex in the principal stretches. Stretches are those since the skin was free of stress, the
    prestretch included. The compressive Kirchhoff stress of the film, in one
    direction or both, is at most :math:`k \epsilon_w`.
    """
    area, e = principal_strains(X_map, x_map)
    e = [strain + jnp.log(membrane.prestretch) for strain in e]
    pulled = jnp.maximum(e[0], 0.0)
    across = jnp.maximum(e[1], -0.5 * pulled)
    both = [wrinkled(jnp.maximum(d, 0.0), membrane.wrinkling_strain) for d in (-e[0], -0.5 * pulled - e[1])]
    wrinkles = both[0][0] + both[1][0] + 0.5 * both[0][1] * both[1][1]
    return area, membrane.law.energy(sheet(jnp.exp(pulled), jnp.exp(across))) + film_modulus(membrane.law) * wrinkles


def wrinkled(shortening: Array, limit: Array) -> tuple[Array, Array]:
    """Return energy and compressive stress of a wrinkling film, both divided by its modulus: (...) [1] -> (...), (...) [1]."""
    pull = -limit * jnp.expm1(-shortening / limit)
    return limit * (shortening - pull), pull


NEARLY_EQUAL = 1e-8  # relative difference of squared principal stretches below which they are treated as equal


def principal_strains(X_map: Array, x_map: Array) -> tuple[Array, tuple[Array, Array]]:
    """Return reference area element [mm^2] and logarithmic principal stretches of faces, the larger first [1].

    X_map, x_map (..., 3, 2) [mm] are the derivatives of position with respect to local coordinates. A symmetric function of the
    two strains has exact first derivatives; second derivatives are accurate to about 1e-8 where the stretches are equal,
    because their difference is bounded away from 0.
    """
    (G11, G12, G22), (g11, g12, g22) = _metric(X_map), _metric(x_map)
    area2, lean = G11 * G22 - G12**2, G12 / G11
    # right Cauchy-Green tensor in orthonormal axes of the reference face, the first along its first tangent
    C11 = g11 / G11
    C12 = (g12 - lean * g11) / jnp.sqrt(area2)
    C22 = (g22 - 2.0 * lean * g12 + lean**2 * g11) * G11 / area2
    mean = 0.5 * (C11 + C22)
    radius = jnp.sqrt((0.5 * (C11 - C22)) ** 2 + C12**2 + (NEARLY_EQUAL * mean) ** 2)
    larger = 0.5 * jnp.log(mean + radius)
    both = 0.5 * jnp.log((g11 * g22 - g12**2) / area2)
    return jnp.sqrt(area2), (larger, both - larger)


def _metric(tangents: Array) -> tuple[Array, Array, Array]:
    """Return the metric (scalar products 11, 12, 22) of two tangent vectors: (..., 3, 2) [mm] -> 3 x (...) [mm^2]."""
    a, b = tangents[..., 0], tangents[..., 1]
    return jnp.sum(a * a, axis=-1), jnp.sum(a * b, axis=-1), jnp.sum(b * b, axis=-1)


def sheet(one: Array, other: Array) -> Array:
    """Return the deformation gradient (..., 3, 3) of an incompressible film with two principal stretches (...) [1]."""
    return jnp.stack([one, other, 1.0 / (one * other)], axis=-1)[..., None] * jnp.eye(3)


def film_modulus(law: Material) -> Array:
    """Return the second derivative of a film's energy with respect to its stretch, at rest [kPa]; 4 mu for a neo-Hookean law."""
    one = jnp.ones(())
    return jax.grad(jax.grad(lambda s: law.energy(sheet(s, one))))(one)


def wrinkling_strain(E_film: float, E_below: float) -> float:
    """Return the compressive strain at which a stiff film on a soft half-space wrinkles: (3 E_below / E_film)^(2/3) / 4 [1].

    Source: Allen, Analysis and design of structural sandwich panels (1969), for equal Poisson ratios.
    """
    return 0.25 * (3.0 * E_below / E_film) ** (2.0 / 3.0)


def meshed_wrinkling_strain(E_film: float, E_below: float, thickness: float, wave_mm: float) -> float:
    r"""Return the wrinkling strain for the mesh of a solid: the film's own, or less if the mesh would resolve wrinkles [1].

    A film without bending stiffness under a compressive force N per length on soft tissue of shear modulus mu buckles in all
    waves shorter than :math:`\pi N/\mu`, since its resistance at wave number k is then too small, :math:`2 \mu k < N k^2`.
    A solid's mesh would resolve such waves down to ``wave_mm``, the length of its shortest edge on the skin, instead of averaging
    over them; the force :math:`N = k_f \epsilon_w t`, :math:`k_f = 4 \mu_f`, is therefore limited to half of this critical value.
    """
    bearable = E_below * wave_mm / (2.0 * np.pi * 4.0 * E_film * thickness)
    return min(wrinkling_strain(E_film, E_below), bearable)


def membrane_force(X: Array, x: Array, membrane: Membrane, table: Table) -> Array:
    """Return the internal forces of the skin at the nodes, per depth: X, x (n, 3 or 6, 3) [mm] -> same shape [mN/mm]."""
    return jax.grad(lambda y: jnp.sum(membrane_energy(X, y, membrane, table)))(x)


def pressure_force(x: Array, membrane: Membrane, table: Table) -> Array:
    """Return the residual of pressure on a solid's faces: x (n, 6, 3) [mm] -> (n, 6, 3) [mN]; 0 on edges.

    The residual is minus the external nodal forces, so a positive pressure gives values along the outward normal.
    """
    if table.gradient.shape[-1] == 1:
        return jnp.zeros_like(x)
    one, other = jnp.moveaxis(jnp.einsum("eai,qab->eqib", x, table.gradient), -1, 0)
    load = jnp.einsum("q,qa,eqi->eai", table.weight, table.value, jnp.cross(one, other))
    return jnp.broadcast_to(membrane.pressure, x.shape[:1])[:, None, None] * load


def facet_force(X: Array, x: Array, membrane: Membrane, table: Table) -> Array:
    """Return internal minus external forces of skin and pressure at the nodes: X, x (n, a, 3) [mm] -> (n, a, 3) [mN/mm]."""
    if not len(X):  # most solids have no skin, so there is nothing to trace and compile
        return jnp.zeros_like(x)
    return membrane_force(X, x, membrane, table) + pressure_force(x, membrane, table)


def tangent(force, x: Array) -> Array:
    """Return the derivative of element forces with respect to node positions: x (n, a, 3) [mm] -> (n, m, 3a) [mN/mm^2].

    ``force`` is a function (n, a, 3) [mm] -> (n, a, 3) [mN/mm], with m = 3a components; or to other values (n, m).

    Elements are independent, so one directional derivative per node component serves the whole batch.
    """
    n, a, c = x.shape
    directions = jnp.eye(a * c).reshape(a * c, a, c)
    columns = jax.vmap(lambda d: jax.jvp(force, (x,), (jnp.broadcast_to(d, x.shape),))[1])(directions)
    return jnp.moveaxis(columns.reshape(a * c, n, -1), 0, -1)
