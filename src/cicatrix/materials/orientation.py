"""Orientation of fibres: densities on the circle and on the sphere, and quadrature points for integrals over them.

Fibres along V and -V are the same, so densities are even and half of the directions are sufficient.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, count, param
from ..numerics.tensors import IDENTITY


class Orientation(Law):
    """Base class of distributions of fibre directions."""

    def directions(self) -> tuple[Array, Array]:
        """Return n fibre directions, unit vectors (..., n, 3), and their quadrature weights (..., n), which add up to 1."""
        raise NotImplementedError

    def finer(self, factor: int) -> Orientation:
        """Return the same density with ``factor`` times as many directions per turn."""
        return self

    @property
    def n_directions(self) -> int:
        """Number of directions."""
        return self.directions()[1].shape[-1]


class Single(Orientation):
    """All fibres along one direction in the plane of the first two axes.

    Parameters
    ----------
    mean : float or (...) array [rad]
        Angle from the first axis.
    """

    mean: float | Array = param("rad", "theta_0", low=-2.0 * np.pi, high=2.0 * np.pi, default=0.0, typed="deg")

    def directions(self) -> tuple[Array, Array]:
        """Return one direction (..., 1, 3) with weight 1."""
        mean = jnp.asarray(self.mean, float)[..., None]
        V = jnp.stack([jnp.cos(mean), jnp.sin(mean), jnp.zeros_like(mean)], axis=-1)
        return V, jnp.ones(V.shape[:-1])


class Along(Orientation):
    """All fibres along one direction in space, which may differ from point to point.

    Parameters
    ----------
    direction : 3 floats or (...) arrays [1]
        Components of a vector along the fibres, of any length but 0.
    """

    direction: tuple[float | Array, ...] = param("1", "a")

    def __check_init__(self):
        super().__check_init__()
        if len(self.direction) != 3:
            raise InputError(f"a direction must have three components; got {len(self.direction)}.")
        known = all(isinstance(x, (int, float, np.ndarray)) for x in self.direction)
        if known and not np.all(sum(np.square(np.asarray(x, float)) for x in self.direction) > 0.0):
            raise InputError("the three components of a direction must not all be 0.")

    def directions(self) -> tuple[Array, Array]:
        """Return one unit vector (..., 1, 3) with weight 1."""
        a = jnp.stack(jnp.broadcast_arrays(*(jnp.asarray(x, float) for x in self.direction)), axis=-1)
        V = (a / jnp.sqrt(jnp.sum(a * a, axis=-1, keepdims=True)))[..., None, :]
        return V, jnp.ones(V.shape[:-1])


class VonMises(Orientation):
    r"""Fibres in the plane of the first two axes, with a von Mises density.

    .. math:: \rho(\theta) = \frac{e^{c \cos 2 (\theta - \theta_0)}}{\pi I_0(c)}, \qquad \int_0^\pi \rho \, d\theta = 1

    Source: the density rho of Guo, Mofrad & Buganza Tepole, Eq. (4), in this form. Equally spaced angles form the trapezoidal
    rule for a periodic function, whose error falls exponentially with their number if the function is smooth.

    Parameters
    ----------
    concentration : float or (...) array [1]
        c; 0 is isotropic in the plane.
    mean : float or (...) array [rad]
        Angle of the mean direction from the first axis.
    n_angles : int
        Number of directions.
    """

    concentration: float | Array = param("1", "c", low=0.0, high=500.0)
    mean: float | Array = param("rad", "theta_0", low=-2.0 * np.pi, high=2.0 * np.pi, default=0.0, typed="deg")
    n_angles: int = count("n", low=2, high=4096, default=40)

    def finer(self, factor: int) -> VonMises:
        """Return the same density with ``factor`` times as many angles."""
        return dataclasses.replace(self, n_angles=factor * self.n_angles)

    def directions(self) -> tuple[Array, Array]:
        """Return directions (..., n_angles, 3) at equal angles from the mean one, and weights (..., n_angles)."""
        angles = jnp.pi * jnp.arange(self.n_angles) / self.n_angles
        c, mean = jnp.asarray(self.concentration, float)[..., None], jnp.asarray(self.mean, float)[..., None]
        weight = jnp.exp(c * (jnp.cos(2.0 * angles) - 1.0))
        theta = mean + angles
        V = jnp.stack([jnp.cos(theta), jnp.sin(theta), jnp.zeros_like(theta)], axis=-1)
        return V, weight / weight.sum(axis=-1, keepdims=True)


class Fisher(Orientation):
    r"""Fibres about an axis in space, with a symmetrised von Mises-Fisher density.

    .. math:: \rho(V) = \frac{c \cosh(c \, V \cdot a)}{4 \pi \sinh c}

    Parameters
    ----------
    concentration : float or (...) array [1]
        c; 0 is isotropic.
    axis : 3 numbers [1]
        Axis a, of any length.
    n_heights : int
        Number of Gauss points along the axis of half a sphere; the number of angles about the axis is twice this.
    """

    concentration: float | Array = param("1", "c", low=0.0, high=500.0)
    axis: tuple[float, ...] = param("1", "a", default=(1.0, 0.0, 0.0), static=True)
    n_heights: int = count("n", low=2, high=256, default=12)

    def __check_init__(self):
        super().__check_init__()
        a = np.asarray(self.axis, float)
        if a.shape != (3,) or not 0.0 < np.linalg.norm(a) < np.inf:
            raise InputError(f"Fisher.axis must be three numbers that are not all 0; got {list(self.axis)}.")

    def finer(self, factor: int) -> Fisher:
        """Return the same density with ``factor`` times as many points along the axis and about it."""
        return dataclasses.replace(self, n_heights=factor * self.n_heights)

    def directions(self) -> tuple[Array, Array]:
        """Return directions (2 n^2, 3) and weights (..., 2 n^2), with n = ``n_heights``."""
        V, area = _half_sphere(_frame(self.axis), self.n_heights)
        c, along = jnp.asarray(self.concentration, float)[..., None], V @ _frame(self.axis)[:, 2]
        weight = area * 0.5 * (jnp.exp(c * (along - 1.0)) + jnp.exp(-c * (along + 1.0)))
        return jnp.asarray(V), weight / weight.sum(axis=-1, keepdims=True)


class Bingham(Orientation):
    r"""Fibres in space with a Bingham density, which has three planes of symmetry.

    .. math:: \rho(V) \propto e^{c_1 V_1^2 + c_2 V_2^2}

    V_1 and V_2 are the components along the first two axes of the body. Equal large concentrations align the fibres with the
    plane of these axes; a single large concentration aligns them with its axis.

    Parameters
    ----------
    c1, c2 : float or (...) array [1]
        Concentrations.
    n_heights : int
        Number of Gauss points along the third axis of half a sphere; the number of angles about that axis is twice this.
    """

    c1: float | Array = param("1", "c_1", low=-100.0, high=100.0)
    c2: float | Array = param("1", "c_2", low=-100.0, high=100.0)
    n_heights: int = count("n", low=2, high=256, default=12)

    def finer(self, factor: int) -> Bingham:
        """Return the same density with ``factor`` times as many points along the third axis and about it."""
        return dataclasses.replace(self, n_heights=factor * self.n_heights)

    def directions(self) -> tuple[Array, Array]:
        """Return directions (2 n^2, 3) and weights (..., 2 n^2), with n = ``n_heights``."""
        V, area = _half_sphere(np.asarray(IDENTITY), self.n_heights)
        c1, c2 = (jnp.asarray(c, float)[..., None] for c in (self.c1, self.c2))
        largest = jnp.maximum(jnp.maximum(c1, c2), 0.0)
        weight = area * jnp.exp(c1 * V[:, 0] ** 2 + c2 * V[:, 1] ** 2 - largest)
        return jnp.asarray(V), weight / weight.sum(axis=-1, keepdims=True)


def _frame(axis: tuple[float, ...]) -> np.ndarray:
    """Return a matrix (3, 3) with orthonormal columns, of which the third one is along ``axis``."""
    a = np.asarray(axis, float)
    q, _ = np.linalg.qr(np.column_stack([a, np.eye(3)[np.argsort(np.abs(a))[:2]].T]))
    return np.column_stack([q[:, 1], q[:, 2], a / np.linalg.norm(a)])


def _half_sphere(frame: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (2 n^2, 3) of half a sphere about the frame's third column, and weights, their shares of its area."""
    x, w = np.polynomial.legendre.leggauss(n)
    height, w = 0.5 * (x + 1.0), 0.5 * w
    angle = np.pi * (np.arange(2 * n) + 0.5) / n
    h, a = (grid.ravel() for grid in np.meshgrid(height, angle, indexing="ij"))
    across = np.sqrt(1.0 - h * h)
    local = np.stack([across * np.cos(a), across * np.sin(a), h], axis=1)
    return local @ frame.T, np.repeat(w, 2 * n) / (2 * n)
