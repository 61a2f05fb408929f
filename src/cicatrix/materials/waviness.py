r"""How wavy fibres are: densities of the stretch :math:`\lambda_w \ge 1` at which a fibre is straight.

A fibre bears load only when it is straight (Guo, Mofrad & Buganza Tepole, Eqs (4)-(5), with the cut-off that their print
leaves out), so a law needs the moments of the density up to the stretch that there is.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.special import beta as beta_function
from scipy.special import roots_jacobi

from ..core.errors import InputError
from ..core.law import Law, param

SHARPEST = 1e-13  # share of the support below which no fibre counts: keeps powers of it finite


class Waviness(Law):
    """A density of the stretch at which fibres are straight.

    Parameters
    ----------
    low, high : float or (...) array [1]
        Stretch at which the first fibres are straight, and that at which all are.
    """

    low: float | Array = param("1", "lambda_1", low=1.0)
    high: float | Array = param("1", "lambda_2", low=1.0)

    def __check_init__(self):
        super().__check_init__()
        low, high = self.low, self.high
        if all(isinstance(x, (int, float, np.ndarray)) for x in (low, high)) and not np.all(np.less(low, high)):
            raise InputError(f"{type(self).__name__}.high must be above low; got low = {low}, high = {high}.")

    def recruited(self, stretch: Array) -> tuple[Array, Array, Array]:
        r"""Moments :math:`\int_{low}^{stretch} \rho \, \lambda_w^k d\lambda_w` for k = 0, 1, -2; of the shape of ``stretch``."""
        raise NotImplementedError

    def points(self, n: int) -> tuple[Array, Array]:
        """Gauss points of the density (..., n) [1] and their weights, which add up to 1."""
        raise NotImplementedError

    def _limits(self, stretch: Array) -> tuple[Array, Array, Array]:
        """Ends of the support, and where recruitment has got to."""
        low, high = (jnp.asarray(end, float) for end in (self.low, self.high))
        low, high = (end.reshape(*end.shape, *[1] * (stretch.ndim - end.ndim)) for end in (low, high))
        return low, high, jnp.clip(stretch, low, high)

    def _linear_points(self, n: int, pieces: tuple[tuple[float, float], ...], density) -> tuple[Array, Array]:
        """Gauss-Legendre points of pieces of the support [0, 1] on which its density is smooth."""
        x, w = np.polynomial.legendre.leggauss(n)
        s = np.concatenate([a + (b - a) * 0.5 * (x + 1.0) for a, b in pieces])
        weight = np.concatenate([(b - a) * 0.5 * w for a, b in pieces]) * density(s)
        low, high = jnp.asarray(self.low, float)[..., None], jnp.asarray(self.high, float)[..., None]
        return low + (high - low) * s, jnp.broadcast_to(jnp.asarray(weight), (*low.shape[:-1], len(s)))


class Uniform(Waviness):
    """All stretches between ``low`` and ``high`` [1] alike."""

    def recruited(self, stretch: Array) -> tuple[Array, Array, Array]:
        """In closed form."""
        low, high, m = self._limits(stretch)
        density = 1.0 / (high - low)
        return density * (m - low), 0.5 * density * (m * m - low * low), density * (1.0 / low - 1.0 / m)

    def points(self, n: int) -> tuple[Array, Array]:
        """Of Gauss and Legendre."""
        return self._linear_points(n, ((0.0, 1.0),), np.ones_like)


class Triangular(Waviness):
    """Rising in a line from ``low`` to the middle, and falling to ``high`` [1]."""

    def recruited(self, stretch: Array) -> tuple[Array, Array, Array]:
        """In closed form, on each side of the middle."""
        low, high, m = self._limits(stretch)
        middle, steep = 0.5 * (low + high), 4.0 / (high - low) ** 2
        up = _ramp(low, jnp.minimum(m, middle), low, steep)
        down = _ramp(middle, jnp.maximum(m, middle), high, -steep)
        return up[0] + down[0], up[1] + down[1], up[2] + down[2]

    def points(self, n: int) -> tuple[Array, Array]:
        """Of Gauss and Legendre, n on each side of the middle."""
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
        """By Gauss-Jacobi points between the nearer end and the stretch: see the tests for how exact."""
        low, high, m = self._limits(stretch)
        z = jnp.clip((m - low) / (high - low), SHARPEST, 1.0 - SHARPEST)
        is_near = z < 0.5
        part = self._next_to(is_near, jnp.minimum(z, 1.0 - z), low, high)
        half = jnp.full_like(high - low, 0.5)
        whole = [
            sum(ends) for ends in zip(*(self._next_to(side, half, low, high) for side in (True, False)), strict=True)
        ]
        first, second, third = (jnp.where(is_near, x, all_ - x) for x, all_ in zip(part, whole, strict=True))
        return first, second, third

    def _next_to(self, is_near: Array | bool, z: Array, low: Array, high: Array) -> tuple[Array, ...]:
        """Moments over the share z (at most a half) of the support next to its lower end or its upper one."""
        (s_low, w_low), (s_high, w_high) = _jacobi(self.p), _jacobi(self.q)
        end, way = jnp.where(is_near, low, high), jnp.where(is_near, high - low, low - high)
        here, there = jnp.where(is_near, self.p, self.q), jnp.where(is_near, self.q, self.p)
        scale = z**here / beta_function(self.p, self.q)
        out = [jnp.zeros_like(scale)] * 3
        for k in range(len(s_low)):
            s, w = jnp.where(is_near, s_low[k], s_high[k]), jnp.where(is_near, w_low[k], w_high[k])
            mass = w * scale * (1.0 - z * s) ** (there - 1.0)
            x = end + way * z * s
            out = [out[0] + mass, out[1] + mass * x, out[2] + mass / (x * x)]
        return tuple(out)

    def points(self, n: int) -> tuple[Array, Array]:
        """Of Gauss and Jacobi."""
        x, w = roots_jacobi(n, self.q - 1.0, self.p - 1.0)
        low, high = jnp.asarray(self.low, float)[..., None], jnp.asarray(self.high, float)[..., None]
        weight = jnp.broadcast_to(jnp.asarray(w / w.sum()), (*low.shape[:-1], n))
        return low + (high - low) * 0.5 * (x + 1.0), weight


def _ramp(start: Array, end: Array, zero: Array, slope: Array) -> tuple[Array, Array, Array]:
    """Moments k = 0, 1, -2 of slope (x - zero) between start and end."""

    def whole(x: Array) -> tuple[Array, Array, Array]:
        return 0.5 * x * x - zero * x, x**3 / 3.0 - 0.5 * zero * x * x, jnp.log(x) + zero / x

    first, second, third = (slope * (b - a) for a, b in zip(whole(start), whole(end), strict=True))
    return first, second, third


def _jacobi(p: float, n: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights of the integral of s^(p-1) f(s) over [0, 1]."""
    x, w = roots_jacobi(n, 0.0, p - 1.0)
    return 0.5 * (x + 1.0), w * 0.5**p
