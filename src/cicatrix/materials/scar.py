"""Tissue that heals, at an instant: matrix and collagen that has been laid down, deformed for good and pulled at by cells."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.tensors import det, inv, product
from .material import EnergyMaterial, State


class Scar(EnergyMaterial):
    r"""Matrix, dispersed collagen fibres and active stress, about a permanent deformation.

    .. math:: \Psi &= J_p \left[ k_0 (I_1 - 3) + \varphi \frac{k_f}{2 k_2} (e^{k_2 \langle E \rangle^2} - 1) \right]
            + J_p T \ln (C : A_0), \qquad E = C_e : A_0 - 1 \\
        \Psi &= J_p \varphi \left[ k_0 (I_1 - 3 - 2 \ln J_e) + \frac{k_v}{2} (J_e - 1)^2
            + \frac{k_f}{2 k_2} (e^{k_2 \langle E \rangle^2} - 1) \right] + J_p T \ln (C : A_0)

    of a sheet, incompressible and free of stress across, and of a solid. :math:`F_e = F F_p^{-1}`, :math:`J_p = \det F_p`; the
    last term has the stress :math:`S = 2 J_p T A_0 / (C : A_0)`, so that the Cauchy traction T does not depend on stretch.
    Source: docs/theory/wound.md. Fibres bear no push, which the source does not say; the
    shear modulus at rest is 2 k_0.

    Parameters
    ----------
    F_p : (..., 3, 3) array [1]
        Permanent deformation.
    A_0 : (..., 3, 3) array [1]
        Structure tensor of the fibres, of trace 1; of a sheet in the plane of its first two axes.
    k_0 : float or (...) array [kPa]
        Of the matrix.
    k_f, k_2 : float or (...) array [kPa], [1]
        Of collagen at its healthy density, and how it stiffens.
    k_v : float or (...) array [kPa]
        Against change of volume; of a solid alone.
    phi : float or (...) array [1]
        Collagen over that of healthy tissue.
    tension : float or (...) array [kPa]
        T.
    is_sheet : bool
        Whether the third axis is a sheet's normal; then only the first two rows and columns of F count.
    """

    F_p: Array
    A_0: Array
    k_0: float | Array = param("kPa", "k_0", above=0.0)
    k_f: float | Array = param("kPa", "k_f", low=0.0)
    k_2: float | Array = param("1", "k_2", above=0.0)
    k_v: float | Array = param("kPa", "k_v", low=0.0)
    phi: float | Array = param("1", "phi", low=0.0)
    tension: float | Array = param("kPa", "T", low=0.0)
    is_sheet: bool = eqx.field(static=True, default=False)

    def energy(self, F: Array, state: State = ()) -> Array:
        """Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]; grows when the tissue is stretched against the pull."""
        J_p = det(self.F_p)
        if self.is_sheet:
            F = _thinned(F, J_p)
        F_e = product(F, inv(self.F_p))
        matrix = self.k_0 * (jnp.sum(F_e * F_e, axis=(-2, -1)) - 3.0)
        fibres = (
            self.phi
            * self.k_f
            / (2.0 * self.k_2)
            * jnp.expm1(self.k_2 * jnp.maximum(self._stretched(F_e) - 1.0, 0.0) ** 2)
        )
        pull = self.tension * jnp.log(self._stretched(F))
        if self.is_sheet:
            return J_p * (matrix + fibres + pull)
        J_e = det(F_e)
        bulk = 0.5 * self.k_v * (J_e - 1.0) ** 2 - 2.0 * self.k_0 * jnp.log(J_e)
        return J_p * (self.phi * (matrix + bulk) + fibres + pull)

    def _stretched(self, F: Array) -> Array:
        """Mean square of the stretch of fibres, C : A_0."""
        return jnp.sum(product(F, self.A_0) * F, axis=(-2, -1))

    def volume_at_rest(self, state: State = ()) -> Array:
        """J_p (...) [1]."""
        return det(self.F_p)

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Shear and bulk modulus of matrix and bulk [kPa]; 0 is the bulk modulus of a sheet, which may always thin."""
        part = 1.0 if self.is_sheet else self.phi
        shear, bulk = 2.0 * self.k_0 * part, 0.0 if self.is_sheet else part * (self.k_v + 2.0 * self.k_0 / 3.0)
        return jnp.broadcast_to(shear, shape), jnp.broadcast_to(bulk, shape)


def _thinned(F: Array, volume: Array) -> Array:
    """F of a sheet in its plane, with the thickness that a volume leaves it: (..., 3, 3), (...) -> (..., 3, 3)."""
    area = F[..., 0, 0] * F[..., 1, 1] - F[..., 0, 1] * F[..., 1, 0]
    none = jnp.zeros_like(area)
    rows = [F[..., 0, 0], F[..., 0, 1], none, F[..., 1, 0], F[..., 1, 1], none, none, none, volume / area]
    return jnp.stack(rows, axis=-1).reshape(F.shape)
