"""Smooth signed distance to a surface, as a cubic spline through values on a grid; it can be differentiated twice."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.ndimage import spline_filter

from ..core.precision import use_double_precision

use_double_precision()

MARGIN = 16  # values added beyond the grid, so that the end conditions of the spline do not reach it (0.27^15 < 1e-8)


class Distance(eqx.Module):
    """Signed distance to a surface at any point, twice continuously differentiable."""

    def at(self, points: Array) -> Array:
        """Return the signed distance of points, positive in front of the surface: (..., 3) [mm] -> (...) [mm]."""
        raise NotImplementedError


class PlaneDistance(Distance):
    """Signed distance to a plane.

    Parameters
    ----------
    point : (3,) array [mm]
        Point of the plane.
    normal : (3,) array [1]
        Unit normal.
    """

    point: np.ndarray
    normal: np.ndarray

    def at(self, points: Array) -> Array:
        """Return the signed distance of points, positive in front of the surface: (..., 3) [mm] -> (...) [mm]."""
        return jnp.asarray((points - self.point) @ self.normal)


class SphereDistance(Distance):
    """Signed distance to a sphere, or to a circle of a section; positive outside.

    Parameters
    ----------
    centre : (3,) array [mm]
        Centre; the third component is ignored in a section.
    radius : float [mm]
        Radius.
    n_axes : int
        2 for a circle, 3 for a sphere.
    """

    centre: np.ndarray
    radius: float
    n_axes: int = eqx.field(static=True, default=3)

    def at(self, points: Array) -> Array:
        """Return the signed distance of points, positive in front of the surface: (..., 3) [mm] -> (...) [mm]."""
        away = (points - self.centre)[..., : self.n_axes]
        return jnp.sqrt(jnp.sum(away**2, axis=-1)) - self.radius


class GridDistance(Distance):
    """Signed distance as a cubic B-spline through values on a regular grid; beyond the grid it goes on linearly.

    Parameters
    ----------
    coefficients : (n_z, n_y, n_x) or (n_y, n_x) array [mm]
        Coefficients of the B-splines (:meth:`through`).
    origin : (n_axes,) array [mm]
        Position x, y(, z) of the first value.
    spacing : (n_axes,) array [mm]
        Distance of neighbouring values along x, y(, z).
    """

    coefficients: np.ndarray | Array
    origin: np.ndarray
    spacing: np.ndarray

    @classmethod
    def through(cls, values: np.ndarray, origin: np.ndarray, spacing: np.ndarray) -> GridDistance:
        """Return the spline through values (n_z, n_y, n_x) or (n_y, n_x) [mm], at least four along each axis."""
        padded = np.pad(np.asarray(values, float), MARGIN, mode="reflect", reflect_type="odd")
        inner = (slice(MARGIN - 1, 1 - MARGIN),) * padded.ndim
        coefficients = spline_filter(padded, order=3, mode="mirror")[inner]
        return cls(np.ascontiguousarray(coefficients), np.asarray(origin, float) - spacing, np.asarray(spacing, float))

    def at(self, points: Array) -> Array:
        """Return the signed distance of points, positive in front of the surface: (..., 3) [mm] -> (...) [mm]."""
        n_axes = self.coefficients.ndim
        size = np.array(self.coefficients.shape[::-1])
        where = (points[..., :n_axes] - self.origin) / self.spacing
        inside = jnp.clip(where, 1.0, size - 2.0)
        value, slope = self._spline(inside)
        return value + jnp.sum(slope * (where - inside), axis=-1)

    def _spline(self, where: Array) -> tuple[Array, Array]:
        """Return value (...) [mm] and derivatives (..., n_axes) [mm] of the spline by grid coordinates (..., n_axes) [1]."""
        n_axes, size = where.shape[-1], np.array(self.coefficients.shape[::-1])
        cell = jnp.clip(jnp.floor(where), 1, size - 3).astype(int)
        weights, rates = _weights(where - cell)
        steps = np.stack(np.meshgrid(*[np.arange(-1, 3)] * n_axes, indexing="ij"), axis=-1).reshape(-1, n_axes)
        index = cell[..., None, :] + steps
        picked = jnp.asarray(self.coefficients)[tuple(jnp.moveaxis(index, -1, 0)[::-1])]

        def summed(varied: int | None) -> Array:
            product = picked
            for axis in range(n_axes):
                factor = rates if axis == varied else weights
                product = product * factor[..., axis, :][..., steps[:, axis] + 1]
            return jnp.sum(product, axis=-1)

        return summed(None), jnp.stack([summed(axis) for axis in range(n_axes)], axis=-1)


def _weights(t: Array) -> tuple[Array, Array]:
    """Return the four cubic B-splines at a place t in a cell, and their derivatives: (...) -> two (..., 4)."""
    s = 1.0 - t
    values = [s**3, 3.0 * t**3 - 6.0 * t**2 + 4.0, 3.0 * s**3 - 6.0 * s**2 + 4.0, t**3]
    rates = [-3.0 * s**2, 9.0 * t**2 - 12.0 * t, -9.0 * s**2 + 12.0 * s, 3.0 * t**2]
    return jnp.stack(values, axis=-1) / 6.0, jnp.stack(rates, axis=-1) / 6.0
