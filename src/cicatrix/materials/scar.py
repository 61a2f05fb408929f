"""Constitutive law of healing tissue: matrix, deposited collagen, permanent deformation and active stress of cells."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from ..core.law import param
from ..numerics.tensors import det, inv, product
from .material import EnergyMaterial, State


class Scar(EnergyMaterial):
    r"""Matrix, dispersed collagen fibres and active stress, relative to a permanent deformation.

    .. math:: \Psi &= J_p \left[ k_0 (I_1 - 3) + \varphi \frac{k_f}{2 k_2} (e^{k_2 \langle E \rangle^2} - 1) \right]
            + J_p T \ln (C : A_0), \qquad E = C_e : A_0 - 1 \\
        \Psi &= J_p \varphi \left[ k_0 (I_1 - 3 - 2 \ln J_e) + \frac{k_v}{2} (J_e - 1)^2
            + \frac{k_f}{2 k_2} (e^{k_2 \langle E \rangle^2} - 1) \right] + J_p T \ln (C : A_0)

    The first energy is that of an incompressible sheet in plane stress, the second that of a solid. :math:`F_e = F F_p^{-1}`,
    :math:`J_p = \det F_p`; the last term has the stress :math:`S = 2 J_p T A_0 / (C : A_0)`, so that the Cauchy traction T does
    not depend on stretch. Source: docs/theory/wound.md. Fibres carry no compression, which the source does not state; the
    shear modulus at rest is 2 k_0, for a solid times phi.

    Parameters
    ----------
    F_p : (..., 3, 3) array [1]
        Permanent deformation.
    A_0 : (..., 3, 3) array [1]
        Structure tensor of the fibres, of trace 1; for a sheet, in the plane of the first two axes.
    k_0 : float or (...) array [kPa]
        Stiffness of the matrix.
    k_f, k_2 : float or (...) array [kPa], [1]
        Stiffness of collagen at its healthy density, and exponent of its stiffening.
    k_v : float or (...) array [kPa]
        Bulk stiffness; used only for a solid.
    phi : float or (...) array [1]
        Collagen density relative to healthy tissue.
    tension : float or (...) array [kPa]
        Active tension T of the cells.
    is_sheet : bool
        Whether the tissue is a sheet with the third axis as its normal; only the first two rows and columns of F are then used.
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
        """Return Psi per reference volume: F (..., 3, 3) [1] -> (...) [kPa]; it increases with stretch, against the tension."""
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
        """Return the mean squared fibre stretch C : A_0, with C = F^T F: (..., 3, 3) -> (...) [1]."""
        return jnp.sum(product(F, self.A_0) * F, axis=(-2, -1))

    def volume_at_rest(self, state: State = ()) -> Array:
        """Return the stress-free volume ratio J_p (...) [1]."""
        return det(self.F_p)

    def moduli_at_rest(self, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
        """Return the shear and bulk modulus without fibres [kPa]; the bulk modulus of a sheet is 0, as it is free to thin."""
        part = 1.0 if self.is_sheet else self.phi
        shear, bulk = 2.0 * self.k_0 * part, 0.0 if self.is_sheet else part * (self.k_v + 2.0 * self.k_0 / 3.0)
        return jnp.broadcast_to(shear, shape), jnp.broadcast_to(bulk, shape)


def _thinned(F: Array, volume: Array) -> Array:
    """Return the in-plane part of F, with the thickness stretch that gives the volume ratio ``volume``: F -> (..., 3, 3)."""
    area = F[..., 0, 0] * F[..., 1, 1] - F[..., 0, 1] * F[..., 1, 0]
    none = jnp.zeros_like(area)
    rows = [F[..., 0, 0], F[..., 0, 1], none, F[..., 1, 0], F[..., 1, 1], none, none, none, volume / area]
    return jnp.stack(rows, axis=-1).reshape(F.shape)
