"""Batched element forces; their tangents are derivatives of the same functions, never written twice.

A section is one slice of a body that is uniform along its normal: positions are x(s, t) + z e3 with three components
each, so deformation gradients are 3 x 3 and gravity may have a component along the normal (antiplane shear). With no
such component this is plane strain. What is "per depth" for a section is the whole for a solid: read mN for mN/mm, mm^3
for mm^2.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..materials.material import EnergyMaterial
from ..numerics.tensors import cofactor, det, inv, product
from .space import Table

NORMAL = np.array([0.0, 0.0, 1.0])


class Bulk(NamedTuple):
    """What fills the elements; leaves broadcast against (n_elements, n_qp)."""

    law: EnergyMaterial
    density: Array
    """Mass per reference volume (n_elements, n_qp) [kg/mm^3]."""
    fraction: Array
    """Share of each element that is tissue (n_elements,) [1]."""
    kept: Array
    """Share of the volume ratio's fluctuation within each element that its projection keeps (n_elements,) [1]."""


class Membrane(NamedTuple):
    """Skin: an incompressible membrane along boundary edges of a section, on boundary faces of a solid; pressure on these."""

    law: EnergyMaterial
    thickness: Array
    """Reference thickness (n_facets,) [mm]."""
    wrinkling_strain: Array
    """Shortening at which it wrinkles [1]."""
    pressure: Array | float = 0.0
    """On a solid's faces from outside, along the normal that they have now (n_facets,) [kPa]."""


def local_map(x: Array, gradient: np.ndarray) -> Array:
    """Derivative of position by the local axes, and a section's normal: x (n, n_shape, 3) -> (n, n_qp, 3, 3) [mm]."""
    columns = jnp.einsum("eai,qab->eqib", x, gradient)
    if columns.shape[-1] == 3:
        return columns
    normal = jnp.broadcast_to(NORMAL, (*columns.shape[:2], 3))
    return jnp.concatenate([columns, normal[..., None]], axis=-1)


def deformation_gradient(X: Array, x: Array, gradient: np.ndarray) -> Array:
    """F = dx/dX at quadrature points: X, x (n, n_shape, 3) [mm] -> (n, n_qp, 3, 3) [1]."""
    return product(local_map(x, gradient), inv(local_map(X, gradient)))


def projection(basis: np.ndarray, weights: Array) -> Array:
    """L2 projection on a few functions of each element, quadrature points to quadrature points.

    basis (n_qp, 1 or 3), weights (n, n_qp) -> (n, n_qp, n_qp).
    """
    mass = jnp.einsum("eq,qi,qj->eij", weights, basis, basis)
    inverse = 1.0 / mass if basis.shape[1] == 1 else inv(mass)
    return jnp.einsum("qi,eij,rj,er->eqr", basis, inverse, basis, weights)


# bulk over shear modulus, Poisson ratio 0.499: up to there four points of a P2 tetrahedron do not lock
STIFFEST = 500.0


def kept_share(law: EnergyMaterial, shape: tuple[int, ...]) -> Array:
    r"""Share of the fluctuation of a solid's volume ratio that is kept, at points of a shape [1].

    :math:`\min(1, \sqrt{500 \mu / \kappa})`, with the moduli at rest.

    A P2 tetrahedron with four points checks the volume four times, about as often as it has degrees of freedom of its own:
    beyond a Poisson ratio of 0.499 it begins to lock. There the bulk modulus acts in full on the mean volume ratio of an element,
    and on the fluctuation about it as it would at 0.499 (the square of this share times itself), which leaves room for the
    gradient of the pressure. docs/decisions/0013 has the measured errors.
    """
    shear, bulk = law.moduli_at_rest(shape)
    return jnp.sqrt(jnp.clip(STIFFEST * shear / bulk, 0.0, 1.0))


def dilated(F: Array, J_bar: Array) -> Array:
    """F with its volume ratio replaced: (J_bar / J)^(1/3) F, (..., 3, 3) -> (..., 3, 3) [1]."""
    return jnp.cbrt(J_bar / det(F))[..., None, None] * F


class Smoothing(NamedTuple):
    """What makes one volume ratio, or one pressure, of the values at an element's quadrature points; its own adjoint."""

    onto: Array
    """L2 projection (n, n_qp, n_qp) [1]."""
    kept: Array
    """Share of what the projection takes away that is left (n_elements,) [1]."""

    def projected(self, values: Array) -> Array:
        """(n, n_qp, ...) -> (n, n_qp, ...), all fluctuation taken away."""
        return jnp.einsum("eqr,er...->eq...", self.onto, values)

    def split(self, values: Array) -> tuple[Array, Array]:
        """(n, n_qp, ...) -> the share of the values as they are, and that of their projection; their sum is smooth."""
        kept = self.kept.reshape(-1, *[1] * (values.ndim - 1))
        return kept * values, (1.0 - kept) * self.projected(values)

    def smooth(self, values: Array) -> Array:
        """(n, n_qp, ...) -> (n, n_qp, ...)."""
        return sum(self.split(values))  # pyright: ignore[reportReturnType]


def kinematics(X: Array, x: Array, bulk: Bulk, table: Table) -> tuple[Array, Smoothing, Array]:
    """F [1], smoothing of the volume ratio, and weights [mm^2] at quadrature points: X, x (n, a, 3) [mm].

    Open elements are left undeformed: whatever their nodes do, nothing of it, not even a NaN, reaches the tissue.
    """
    x = jnp.where(bulk.fraction[:, None, None] > 0.0, x, X)
    X_map = local_map(X, table.gradient)
    weights = table.weight * jnp.abs(det(X_map))  # the mesh library orients triangles either way
    F: Array = product(local_map(x, table.gradient), inv(X_map))
    return F, Smoothing(projection(table.volume, weights), bulk.kept), weights  # pyright: ignore[reportReturnType]


def dilation(X: Array, x: Array, bulk: Bulk, table: Table) -> Array:
    """Element-wise projection J_bar of the volume ratio, at quadrature points: X, x (n, a, 3) [mm] -> (n, n_qp).

    In a section it is linear: pressure and volume then live in the discontinuous linear space, which with the bubble is
    stable and of full order however incompressible the tissue (Crouzeix & Raviart 1973; three fields as in Simo, Taylor
    & Pister 1985). In a solid it is the mean and a share of the fluctuation about it (:func:`kept_share`).
    """
    F, smoothing, _ = kinematics(X, x, bulk, table)
    return smoothing.smooth(det(F))


def filled_gradient(X: Array, x: Array, bulk: Bulk, table: Table) -> Array:
    """F with the projected volume ratio, as the law sees it: X, x (n, a, 3) [mm] -> (n, n_qp, 3, 3) [1]."""
    F, smoothing, _ = kinematics(X, x, bulk, table)
    return dilated(F, smoothing.smooth(det(F)))


def bulk_energy(X: Array, x: Array, bulk: Bulk, table: Table) -> Array:
    """Strain energy per reference volume at quadrature points: X, x (n, a, 3) [mm] -> (n, n_qp) [kPa]."""
    return bulk.law.energy(filled_gradient(X, x, bulk, table))


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


class PointRates(NamedTuple):
    """:func:`point_stress` at quadrature points, the pressure held, and how it changes."""

    P: Array
    """(..., 3, 3) [kPa]."""
    mean: Array
    """Mean stress (...) [kPa]."""
    P_by_F: Array
    """(..., 3, 3, 3, 3) [kPa]."""
    mean_by_F: Array
    """(..., 3, 3) [kPa]."""
    P_by_J: Array
    """By J_bar (..., 3, 3) [kPa]."""
    mean_by_J: Array
    """(...) [kPa]."""


def point_rates(law: EnergyMaterial, F: Array, J_bar: Array, smoothing: Smoothing) -> PointRates:
    r"""Stress and its derivatives from the law's own answer at :math:`\bar F`, in the cheapest way that it knows.

    By the chain rule, with :math:`\bar A = dP/dF` there, :math:`h = \bar A : \bar F`, :math:`\tilde h = \bar F : \bar A`,
    :math:`q = (\bar F : h)/3 + t` and :math:`G = F^{-T}`: :math:`3\,dt/dF = s(\tilde h + \bar P) - qG` and

    .. math:: \frac{dP}{dF} = s^2 \bar A - \frac{s}{3} (h + \bar P) \otimes G - G \otimes \frac{dt}{dF}
        + J\pi\, G \otimes G - (J\pi - t) [G_{iL} G_{kJ}]_{iJkL}
    """
    J, F_bar = det(F), dilated(F, J_bar)
    P_bar, A_bar, _ = law.response(F_bar)
    s, G = jnp.cbrt(J_bar / J)[..., None, None], cofactor(F) / J[..., None, None]
    right = jnp.sum(A_bar * F_bar[..., None, None, :, :], axis=(-2, -1)) + P_bar
    left = jnp.sum(A_bar * F_bar[..., :, :, None, None], axis=(-4, -3)) + P_bar
    t = jnp.sum(P_bar * F_bar, axis=(-2, -1)) / 3.0
    q = jnp.sum(right * F_bar, axis=(-2, -1)) / 3.0  # with P_bar : F_bar / 3 = t in it
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
    """Gradients of the shape functions along the element's axes: X (n, a, 3) [mm] -> (n, n_qp, a, n_axes) [1/mm]."""
    axes = table.gradient.shape[-1]  # nothing changes along a section's normal
    return jnp.einsum("qab,eqbJ->eqaJ", table.gradient, inv(local_map(X, table.gradient))[..., :axes, :axes])


def bulk_force(X: Array, x: Array, J_bar: Array, bulk: Bulk, gravity: Array, table: Table) -> Array:
    """Internal minus gravity forces per depth on the nodes: X, x (n, a, 3) [mm], J_bar (n, n_qp) -> (n, a, 3) [mN/mm]."""
    F, smoothing, weights = kinematics(X, x, bulk, table)
    P, _ = point_stress(bulk.law, F, J_bar, smoothing.smooth(_mean_stress(bulk.law, F, J_bar)))
    weights = weights * bulk.fraction[:, None]
    B = slopes(X, table)
    internal = jnp.einsum("eq,eqiJ,eqaJ->eai", weights, P[..., : B.shape[-1]], B)
    mass = weights * bulk.density
    return internal - jnp.einsum("eq,qa->ea", mass, table.value)[..., None] * gravity


def _mean_stress(law: EnergyMaterial, F: Array, J_bar: Array) -> Array:
    """Mean stress conjugate to J_bar (n, n_qp) [kPa]."""
    return point_stress(law, F, J_bar, jnp.zeros_like(J_bar))[1]


class Linearised(NamedTuple):
    """First order of ``bulk_force`` about (u, J_bar), u the positions x or X, with J_bar then tied to them again.

    Element matrices are left as what they are contracted from, :func:`..core.native.add_contracted`.
    """

    slopes: Array
    """B, gradients of the shape functions along the element's axes (n, n_qp, a, n_axes) [1/mm]."""
    tangent: Array
    """Tangent of each point times its weight (n, n_qp, 3, n_axes, 3, n_axes)."""
    columns: Array
    """Left factors of what is of rank one at each point (n, m, 3a)."""
    rows: Array
    """Right factors (n, m, 3a)."""
    force_rate: Array
    """Change of force by J_bar at each quadrature point (n, n_qp, 3a) [mN/mm]."""
    volume_rate: Array
    """Change of J_bar by du (n, n_qp, 3a) [1/mm]; 0 in open elements."""


class _Rates(NamedTuple):
    """What both linearisations are contracted from, at quadrature points."""

    F: Array
    B: Array
    smoothing: Smoothing
    weights: Array
    """(n, n_qp, 1) [mm^2], 0 in open elements."""
    P: Array
    mean: Array
    """Mean stress (n, n_qp) [kPa]."""
    P_by_F: Array
    mean_by_F: Array
    volume_by_x: Array
    """Change of J_bar by dx (n, n_qp, 3a) [1/mm]."""
    force_by_volume: Array
    """Change of force by J_bar (n, n_qp, 3a) [mN/mm]."""


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
    return jax.lax.optimization_barrier(rates)  # or XLA works them out anew for each entry that is made of them


def _to_nodes(B: Array, P: Array) -> Array:
    """Work of a stress-like field on each degree of freedom: (n, n_qp, a, axes), (n, n_qp, 3, axes) -> (n, n_qp, 3a)."""
    return jnp.einsum("eqaJ,eqiJ->eqai", B, P).reshape(*B.shape[:2], -1)


def linearised(X: Array, x: Array, J_bar: Array, bulk: Bulk, table: Table) -> Linearised:
    """By x.

    ``tangent`` of ``tied_force`` by x is the slow twin of its contraction where J_bar = J_bar(x).
    """
    r = _rates(X, x, J_bar, bulk, table)
    columns = jnp.concatenate([r.force_by_volume, r.weights * r.volume_by_x], axis=1)
    rows = jnp.concatenate([r.volume_by_x, _to_nodes(r.B, r.mean_by_F)], axis=1)
    tangent = r.weights[..., None, None, None] * r.P_by_F
    return Linearised(r.B, tangent, columns, rows, r.force_by_volume, _where_tissue(bulk, r.volume_by_x))


def linearised_reference(X: Array, x: Array, J_bar: Array, bulk: Bulk, gravity: Array, table: Table) -> Linearised:
    r"""By the reference positions X, x held: ``tangent`` of ``tied_force`` by X is the slow twin.

    A shift of X with gradient H along X changes F by :math:`-FH`, the slopes B of the shape functions by
    :math:`-BH` and volumes by tr H; gravity, fixed to the reference volume, changes with these.
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
    """``bulk_force`` at J_bar = J_bar(x), the gradient of the energy: X, x (n, a, 3) [mm] -> (n, a, 3) [mN/mm]."""
    return bulk_force(X, x, dilation(X, x, bulk, table), bulk, gravity, table)


def membrane_energy(X: Array, x: Array, membrane: Membrane, table: Table) -> Array:
    """Strain energy of each piece of skin: a section's edges X, x (n, 3, 3) [mm], a solid's faces (n, 6, 3) [mm] -> (n,) [mN].

    Its thickness keeps the volume. A stiff film on soft tissue wrinkles when it is shortened by more than a small strain,
    and then bears no more than the load at which it wrinkled (Allen 1969). Wrinkles are finer than the mesh, so this is the
    energy averaged over them.
    """
    density = _edge_energy if table.gradient.shape[-1] == 1 else _face_energy
    extent, W = density(X, x, membrane, table)
    return membrane.thickness * jnp.sum(table.weight * extent * W, axis=-1)


def _edge_energy(X: Array, x: Array, membrane: Membrane, table: Table) -> tuple[Array, Array]:
    r"""Length over that of the reference edge [mm] and energy density [kPa]: X, x (n, 3, 3) [mm] -> (n, n_qp), (n, n_qp).

    The law's own where the edge is stretched; where it is shortened by :math:`\epsilon`, :math:`k \epsilon_w [\epsilon -
    \epsilon_w (1 - e^{-\epsilon/\epsilon_w})]`, whose stress starts with the law's modulus k and ends at
    :math:`k \epsilon_w`. It is smooth, and its tangent never negative.
    """
    X_s = jnp.einsum("eai,qa->eqi", X, table.gradient[..., 0])
    x_s = jnp.einsum("eai,qa->eqi", x, table.gradient[..., 0])
    length = jnp.sqrt(X_s[..., 0] ** 2 + X_s[..., 1] ** 2)
    stretch = jnp.sqrt(x_s[..., 0] ** 2 + x_s[..., 1] ** 2) / length
    shear = (x_s[..., 2] - X_s[..., 2]) / length
    energy, _ = wrinkled(jnp.maximum(1.0 - stretch, 0.0), membrane.wrinkling_strain)
    return length, membrane.law.energy(film(jnp.maximum(stretch, 1.0), shear)) + film_modulus(membrane.law) * energy


def _face_energy(X: Array, x: Array, membrane: Membrane, table: Table) -> tuple[Array, Array]:
    r"""Area over that of the reference face [mm^2] and energy density [kPa]: X, x (n, 6, 3) [mm] -> (n, n_qp), (n, n_qp).

    With :math:`e_1 \ge e_2` the logarithms of the principal stretches, a tension field (Pipkin 1986) that bears a little
    compression:

    .. math:: \Psi(a_1, a_2) + k \, [f(n) + f(p) + f'(n) f'(p) / 2], \qquad
        f(p) = \epsilon_w [p - \epsilon_w (1 - e^{-p/\epsilon_w})]

    :math:`a_1 = \max(e_1, 0)` and :math:`a_2 = \max(e_2, -a_1/2)` is what the law sees: a film pulled one way is slack when
    it is narrower than it would be in simple tension. :math:`p = \max(-a_1/2 - e_2, 0)` is what it is shortened beyond that,
    :math:`n = \max(-e_1, 0)` what it is shortened the other way too. At rest the second derivatives agree on all sides, those
    of the first kind everywhere; the energy is convex in the principal stretches. Against being
    shortened, one way or both, the film pushes with a Kirchhoff stress of :math:`k \epsilon_w` at most.
    """
    X_map, x_map = (jnp.einsum("eai,qab->eqib", y, table.gradient) for y in (X, x))
    area, e = principal_strains(X_map, x_map)
    pulled = jnp.maximum(e[0], 0.0)
    across = jnp.maximum(e[1], -0.5 * pulled)
    both = [wrinkled(jnp.maximum(d, 0.0), membrane.wrinkling_strain) for d in (-e[0], -0.5 * pulled - e[1])]
    wrinkles = both[0][0] + both[1][0] + 0.5 * both[0][1] * both[1][1]
    return area, membrane.law.energy(sheet(jnp.exp(pulled), jnp.exp(across))) + film_modulus(membrane.law) * wrinkles


def wrinkled(shortening: Array, limit: Array) -> tuple[Array, Array]:
    """Energy and pull of a wrinkling film over its modulus, 0 and the shortening at first: (...) [1] -> (...), (...) [1]."""
    pull = -limit * jnp.expm1(-shortening / limit)
    return limit * (shortening - pull), pull


NEARLY_EQUAL = 1e-8  # difference of squared principal stretches, over their mean, below which they are not told apart


def principal_strains(X_map: Array, x_map: Array) -> tuple[Array, tuple[Array, Array]]:
    """Area over that of the reference face [mm^2], logarithms of the principal stretches, the larger first [1].

    X_map, x_map (..., 3, 2) [mm]: derivatives of position by the face's local axes. A function of the two strains that is
    symmetric has exact first derivatives; second ones to about 1e-8 where the stretches are equal, since their difference is
    kept from 0 there.
    """
    (G11, G12, G22), (g11, g12, g22) = _metric(X_map), _metric(x_map)
    area2, lean = G11 * G22 - G12**2, G12 / G11
    # right Cauchy-Green tensor in axes that are orthonormal in the reference, the first along the first tangent
    C11 = g11 / G11
    C12 = (g12 - lean * g11) / jnp.sqrt(area2)
    C22 = (g22 - 2.0 * lean * g12 + lean**2 * g11) * G11 / area2
    mean = 0.5 * (C11 + C22)
    radius = jnp.sqrt((0.5 * (C11 - C22)) ** 2 + C12**2 + (NEARLY_EQUAL * mean) ** 2)
    larger = 0.5 * jnp.log(mean + radius)
    both = 0.5 * jnp.log((g11 * g22 - g12**2) / area2)
    return jnp.sqrt(area2), (larger, both - larger)


def _metric(tangents: Array) -> tuple[Array, Array, Array]:
    """Products of two tangents (..., 3, 2) [mm] with each other: 11, 12, 22 [mm^2]."""
    a, b = tangents[..., 0], tangents[..., 1]
    return jnp.sum(a * a, axis=-1), jnp.sum(a * b, axis=-1), jnp.sum(b * b, axis=-1)


def sheet(one: Array, other: Array) -> Array:
    """Deformation gradient (..., 3, 3) of an incompressible film stretched along two axes of its own (...) [1]."""
    return jnp.stack([one, other, 1.0 / (one * other)], axis=-1)[..., None] * jnp.eye(3)


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


def meshed_wrinkling_strain(E_film: float, E_below: float, thickness: float, wave_mm: float) -> float:
    r"""Wrinkling strain that a mesh of a solid bears: the film's own, or less where the mesh is finer than its wrinkles [1].

    A film without bending stiffness that pushes with N on soft tissue of shear modulus mu buckles in all waves shorter than
    :math:`\pi N/\mu`, since the half-space below resists a wave number k with :math:`2 \mu k < N k^2`. A solid's mesh would
    show such waves down to ``wave_mm``, the length of its shortest edge on the skin, instead of averaging them; so the push
    :math:`N = k_f \epsilon_w t`, :math:`k_f = 4 \mu_f`, is kept at half of what the mesh bears.
    """
    bearable = E_below * wave_mm / (2.0 * np.pi * 4.0 * E_film * thickness)
    return min(wrinkling_strain(E_film, E_below), bearable)


def membrane_force(X: Array, x: Array, membrane: Membrane, table: Table) -> Array:
    """Forces per depth of the skin on the nodes: X, x (n, 3 or 6, 3) [mm] -> the same shape [mN/mm]."""
    return jax.grad(lambda y: jnp.sum(membrane_energy(X, y, membrane, table)))(x)


def pressure_force(x: Array, membrane: Membrane, table: Table) -> Array:
    """Internal minus external forces of pressure on a solid's faces, outward: x (n, 6, 3) [mm] -> (n, 6, 3) [mN]; 0 on edges."""
    if table.gradient.shape[-1] == 1:
        return jnp.zeros_like(x)
    one, other = jnp.moveaxis(jnp.einsum("eai,qab->eqib", x, table.gradient), -1, 0)
    load = jnp.einsum("q,qa,eqi->eai", table.weight, table.value, jnp.cross(one, other))
    return jnp.broadcast_to(membrane.pressure, x.shape[:1])[:, None, None] * load


def facet_force(X: Array, x: Array, membrane: Membrane, table: Table) -> Array:
    """Forces of skin and pressure on the nodes: X, x (n, a, 3) [mm] -> (n, a, 3) [mN/mm]."""
    return membrane_force(X, x, membrane, table) + pressure_force(x, membrane, table)


def tangent(force, x: Array) -> Array:
    """Derivative of batched element forces by batched node positions: (n, a, 3) -> (n, 3a, 3a) [mN/mm^2].

    Elements are independent, so one directional derivative per node component serves the whole batch.
    """
    n, a, c = x.shape
    directions = jnp.eye(a * c).reshape(a * c, a, c)
    columns = jax.vmap(lambda d: jax.jvp(force, (x,), (jnp.broadcast_to(d, x.shape),))[1])(directions)
    return jnp.moveaxis(columns.reshape(a * c, n, a * c), 0, -1)
