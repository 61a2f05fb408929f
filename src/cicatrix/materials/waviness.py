r"""Waviness of fibres: densities of the stretch :math:`\lambda_w \ge 1` at which a fibre becomes straight.

A fibre carries load only when it is straight (Guo, Mofrad & Buganza Tepole, Eqs (4)-(5), with the cut-off that is missing
in print), so a law needs the integrals of the density, times powers of :math:`\lambda_w`, from 1 to the current stretch.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import scipy  # SciPy imports its submodules at first access
from jax import Array

from ..core.errors import InputError
from ..core.law import Law, param

MIN_FRACTION = 1e-13  # smallest fraction of the support that is integrated, so that its powers stay finite


class Waviness(Law):
    """Base class of densities of the stretch at which fibres become straight.

    Parameters
    ----------
    low, high : float or (...) array [1]
        Stretch at which the first fibres become straight, and stretch at which all are straight.
    """

    low: float | Array = param("1", "lambda_1", low=1.0)
    high: float | Array = param("1", "lambda_2", low=1.0)

    def __check_init__(self):
        super().__check_init__()
        low, high = self.low, self.high
        if all(isinstance(x, (int, float, np.ndarray)) for x in (low, high)) and not np.all(np.less(low, high)):
            raise InputError(f"{type(self).__name__}.high must be above low; got low = {low}, high = {high}.")

    def recruited(self, stretch: Array) -> tuple[Array, Array, Array]:
        r"""Return the moments of the density up to a stretch, for k = 0, 1 and -2, each with the shape of ``stretch``.

        .. math:: \int_{low}^{stretch} \rho(\lambda_w) \, \lambda_w^k \, d\lambda_w
        """
        raise NotImplementedError

    def points(self, n: int) -> tuple[Array, Array]:
        """Return points (..., m) [1] and weights (..., m) of a Gauss rule over the density; the weights add up to 1.

        n is the number of points for each smooth piece of the density.
        """
        raise NotImplementedError

    def _limits(self, stretch: Array) -> tuple[Array, Array, Array]:
        """Return ``low`` and ``high``, broadcastable to the stretch, and the stretch clipped to the range between them."""
        low, high = (jnp.asarray(end, float) for end in (self.low, self.high))
        low, high = (end.reshape(*end.shape, *[1] * (stretch.ndim - end.ndim)) for end in (low, high))
        return low, high, jnp.clip(stretch, low, high)

    def _linear_points(self, n: int, pieces: tuple[tuple[float, float], ...], density) -> tuple[Array, Array]:
        """Return points (..., m) [1] and weights (..., m) of Gauss-Legendre quadrature over the density, n points in each piece.

        ``density`` is a function on the support scaled to [0, 1]; it is smooth in each of the ``pieces``, given by their ends.
        """
        x, w = np.polynomial.legendre.leggauss(n)
        s = np.concatenate([a + (b - a) * 0.5 * (x + 1.0) for a, b in pieces])
        weight = np.concatenate([(b - a) * 0.5 * w for a, b in pieces]) * density(s)
        low, high = jnp.asarray(self.low, float)[..., None], jnp.asarray(self.high, float)[..., None]
        return low + (high - low) * s, jnp.broadcast_to(jnp.asarray(weight), (*low.shape[:-1], len(s)))


class Uniform(Waviness):
    """Uniform density between ``low`` and ``high`` [1]."""

    def recruited(self, stretch: Array) -> tuple[Array, Array, Array]:
        """Return the moments k = 0, 1, -2 of the density from ``low`` to the stretch, in closed form: (...) -> three (...)."""
        low, high, m = self._limits(stretch)
        density = 1.0 / (high - low)
        return density * (m - low), 0.5 * density * (m * m - low * low), density * (1.0 / low - 1.0 / m)

    def points(self, n: int) -> tuple[Array, Array]:
        """Return n points (..., n) [1] and weights (..., n) of Gauss-Legendre quadrature over the density."""
        return self._linear_points(n, ((0.0, 1.0),), np.ones_like)


class Triangular(Waviness):
    """Triangular density that rises linearly from ``low`` to the middle and falls linearly to ``high`` [1]."""

    def recruited(self, stretch: Array) -> tuple[Array, Array, Array]:
        """Return the moments k = 0, 1, -2 of the density from ``low`` to the stretch, in closed form: (...) -> three (...)."""
        low, high, m = self._limits(stretch)
        middle, steep = 0.5 * (low + high), 4.0 / (high - low) ** 2
        up = _ramp(low, jnp.minimum(m, middle), low, steep)
        down = _ramp(middle, jnp.maximum(m, middle), high, -steep)
        return up[0] + down[0], up[1] + down[1], up[2] + down[2]

    def points(self, n: int) -> tuple[Array, Array]:
        """Return points (..., 2 n) [1] and weights (..., 2 n) of Gauss-Legendre quadrature, n in each half of the support."""
        return self._linear_points(n, ((0.0, 0.5), (0.5, 1.0)), lambda s: 4.0 * np.minimum(s, 1.0 - s))


class Beta(Waviness):
    r"""A beta density between ``low`` and ``high`` [1].

    .. math:: \rho \propto (\lambda_w - \lambda_1)^{p - 1} (\lambda_2 - \lambda_w)^{q - 1}

    Parameters
    ----------
    p, q : float [1]
        Exponents; the same at all points, and not differentiable.
    """

    p: float = param("1", "p", low=1.0, high=50.0, default=2.0, static=True)
    q: float = param("1", "q", low=1.0, high=50.0, default=2.0, static=True)

    def recruited(self, stretch: Array) -> tuple[Array, Array, Array]:
        """Return the moments k = 0, 1, -2 of the density from ``low`` to the stretch: (...) -> three (...).

        They are integrated by Gauss-Jacobi quadrature between the stretch and the nearer end of the support.
        """
        low, high, m = self._limits(stretch)
        z = jnp.clip((m - low) / (high - low), MIN_FRACTION, 1.0 - MIN_FRACTION)
        is_near = z < 0.5
        part = self._end_moments(is_near, jnp.minimum(z, 1.0 - z), low, high)
        half = jnp.full_like(high - low, 0.5)
        whole = [
            sum(ends)
            for ends in zip(*(self._end_moments(side, half, low, high) for side in (True, False)), strict=True)
        ]
        first, second, third = (jnp.where(is_near, x, all_ - x) for x, all_ in zip(part, whole, strict=True))
        return first, second, third

    def _end_moments(self, is_near: Array | bool, z: Array, low: Array, high: Array) -> tuple[Array, ...]:
        """Return the moments k = 0, 1, -2 of the density over a part of the support that adjoins one of its ends: three (...).

        The part adjoins ``low`` where ``is_near`` is True and ``high`` elsewhere; its length relative to the support is z (...),
        at most one half.
        """
        (s_low, w_low), (s_high, w_high) = _jacobi(self.p), _jacobi(self.q)
        end, direction = jnp.where(is_near, low, high), jnp.where(is_near, high - low, low - high)
        here, there = jnp.where(is_near, self.p, self.q), jnp.where(is_near, self.q, self.p)
        scale = z**here / scipy.special.beta(self.p, self.q)
        out = [jnp.zeros_like(scale)] * 3
        for k in range(len(s_low)):
            s, w = jnp.where(is_near, s_low[k], s_high[k]), jnp.where(is_near, w_low[k], w_high[k])
            mass = w * scale * (1.0 - z * s) ** (there - 1.0)
            x = end + direction * z * s
            out = [out[0] + mass, out[1] + mass * x, out[2] + mass / (x * x)]
        return tuple(out)

    def points(self, n: int) -> tuple[Array, Array]:
        """Return n points (..., n) [1] and weights (..., n) of Gauss-Jacobi quadrature over the density."""
        x, w = scipy.special.roots_jacobi(n, self.q - 1.0, self.p - 1.0)
        low, high = jnp.asarray(self.low, float)[..., None], jnp.asarray(self.high, float)[..., None]
        weight = jnp.broadcast_to(jnp.asarray(w / w.sum()), (*low.shape[:-1], n))
        return low + (high - low) * 0.5 * (x + 1.0), weight


def _ramp(start: Array, end: Array, zero: Array, slope: Array) -> tuple[Array, Array, Array]:
    """Return the moments k = 0, 1, -2 of the linear density slope (x - zero) from ``start`` to ``end``: three (...)."""

    def whole(x: Array) -> tuple[Array, Array, Array]:
        return 0.5 * x * x - zero * x, x**3 / 3.0 - 0.5 * zero * x * x, jnp.log(x) + zero / x

    first, second, third = (slope * (b - a) for a, b in zip(whole(start), whole(end), strict=True))
    return first, second, third


def _jacobi(p: float, n: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Return n points (n,) and weights (n,) of Gauss-Jacobi quadrature for integrals of s^(p-1) f(s) over [0, 1]."""
    x, w = scipy.special.roots_jacobi(n, 0.0, p - 1.0)
    return 0.5 * (x + 1.0), w * 0.5**p
