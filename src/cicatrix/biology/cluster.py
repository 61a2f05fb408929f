"""Clusters of bonds that share a load: when one bond opens, the closed ones carry its part of the load."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from ..core.law import Law, param
from ..core.random import Phase, site_words
from ..numerics.roots import rising_root

SEARCHED_PN, N_SEARCHED = (1e-4, 1e6), 512  # range and number of forces per bond in the search, log-spaced


class ForceSharing(Law):
    r"""Cluster of bonds that share a constant force, in dimensionless form.

    Rates are relative to the unloaded opening rate of one bond, forces to the force that raises this rate by a factor of e.

    .. math:: r_i = i \, e^{f / i}, \qquad g_i = \gamma (N - i)

    with i of N bonds closed. Source: Erdmann & Schwarz, Phys. Rev. Lett. 92, 108102 (2004) and J. Chem. Phys. 121, 8997 (2004),
    after Bell (1978); Guo, Mofrad & Buganza Tepole mention integrin clustering without an equation.

    Parameters
    ----------
    gamma : float or (...) array [1]
        Closing rate over opening rate without load.
    """

    gamma: float | Array = param("1", "gamma", low=0.0)

    def opening(self, closed: Array, force: Array) -> Array:
        """Return the rate at which one of i closed bonds opens: i (...), total force f (...) [1] -> (...) [1]."""
        return closed * jnp.exp(force / closed)

    def closing(self, closed: Array, size: int) -> Array:
        """Return the rate at which one of the open bonds closes: i closed bonds (...), N = ``size`` bonds -> (...) [1]."""
        return self.gamma * (size - closed)

    def lifetime(self, size: int, force: Array) -> Array:
        """Return the mean time until all of N initially closed bonds are open: force f (...) [1] -> (...) [1]."""
        closed = jnp.arange(1.0, size + 1.0)
        force = jnp.asarray(force, float)[..., None]
        return mean_lifetime(self.opening(closed, force), self.closing(closed, size) + jnp.zeros_like(force))

    def critical_force(self, size: int) -> Array:
        r"""Return the largest force for which :math:`\dot i = -i e^{f/i} + \gamma (N - i)` (deterministic) has a fixed point.

        :math:`f_c = N w` with :math:`w e^w = \gamma / e`, (...) [1].
        """
        gamma = jnp.asarray(self.gamma, float)
        w = rising_root(lambda w: w * jnp.exp(w) - gamma / jnp.e, jnp.zeros_like(gamma), gamma / jnp.e)
        return size * w


def mean_lifetime(opening: Array, closing: Array) -> Array:
    """Return the mean time from N closed bonds to none, by the one-step master equation: rates (..., N) [1/s] -> (...) [s].

    Parameters
    ----------
    opening, closing : (..., N) array [1/s]
        Rates at which one more bond opens or closes while i = 1 .. N bonds are closed. The closing rate at i = N is ignored;
        with all bonds open, none closes again.

    Notes
    -----
    The mean time from i to i - 1 is 1/r_i plus g_i/r_i times that from i + 1 to i (Van Kampen, Stochastic Processes, chapter
    XII). Only sums and products of positive numbers occur, so there is no cancellation.
    """

    def step(above: Array, rates: tuple[Array, Array]) -> tuple[Array, Array]:
        r, g = rates
        here = (1.0 + g * above) / r
        return here, here

    rates = (jnp.moveaxis(opening, -1, 0), jnp.moveaxis(jnp.asarray(closing).at[..., -1].set(0.0), -1, 0))
    _, steps = lax.scan(step, jnp.zeros(opening.shape[:-1]), rates, reverse=True)
    return jnp.sum(steps, axis=0)


def sample_lifetimes(opening: np.ndarray, closing: np.ndarray, n: int, seed: int, most: int = 10_000_000) -> np.ndarray:
    """Sample lifetimes (n,) [s] of n clusters of N initially closed bonds by exact stochastic simulation: rates (N,) [1/s].

    The rates are those of :func:`mean_lifetime`. Random numbers depend only on seed, cluster and event. Clusters that
    survive ``most`` events give NaN.
    """
    size = len(opening)
    closed, time, left = np.full(n, size), np.zeros(n), np.arange(n)
    for event in range(most):
        words = site_words(seed, left, event, Phase.CLUSTER)
        u, v = ((words[:, i].astype(float) + 0.5) / 2.0**32 for i in (0, 1))
        r, g = opening[closed[left] - 1], np.where(closed[left] < size, closing[closed[left] - 1], 0.0)
        time[left] -= np.log(u) / (r + g)
        closed[left] += np.where(v * (r + g) < r, -1, 1)
        left = left[closed[left] > 0]
        if not left.size:
            break
    time[left] = np.nan
    return time


def shared(size: int, per_bond: Array, k_off: Callable[[Array], Array], k_on: Array, rebinding: bool) -> Array:
    """Return the mean lifetime (...) [s] of N = ``size`` bonds that share the load N x ``per_bond``, each on its own substrate.

    Parameters
    ----------
    per_bond : (...) array [pN]
        Force of each bond while all are closed.
    k_off : callable
        Opening rate of one bond under a force (..., N) [pN] -> (..., N) [1/s].
    k_on : (...) array [1/s]
        Closing rate of one bond.
    rebinding : bool
        Whether open bonds close again.
    """
    closed = jnp.arange(1.0, size + 1.0)
    opening = closed * k_off(jnp.asarray(per_bond)[..., None] * size / closed)
    closing = (jnp.asarray(k_on)[..., None] * (size - closed)) * float(rebinding) + jnp.zeros_like(opening)
    return mean_lifetime(opening, closing)


def critical_load(size: int, k_off: Callable[[Array], Array], k_on: np.ndarray) -> np.ndarray:
    r"""Return the largest force (s,) [pN] on N = ``size`` bonds for which their mean closed number has a fixed point.

    At force f per closed bond, N bonds carry :math:`F = N f \, k_{on} / (k_{on} + k_{off}(f))` together; F is maximised over f.
    For :class:`ForceSharing` the result is :meth:`ForceSharing.critical_force`.

    Parameters
    ----------
    k_off : callable
        Opening rate of one bond under n forces at each of s points: (s, n) [pN] -> (s, n) [1/s].
    k_on : (s,) array [1/s]
        Closing rate of one bond.
    """
    low, high = (np.full(k_on.shape, np.log(force)) for force in SEARCHED_PN)
    for _ in range(3):  # each pass refines the grid about the maximum; the last relative spacing is 1e-6
        step = (high - low) / (N_SEARCHED - 1)
        force = np.exp(low[:, None] + step[:, None] * np.arange(N_SEARCHED))
        bound = k_on[:, None] / (k_on[:, None] + np.asarray(k_off(jnp.asarray(force))))
        held = np.nan_to_num(force * bound)  # NaN where the substrate is not valid
        best = held.argmax(axis=1)
        low, high = low + (best - 1) * step, low + (best + 1) * step
    return size * held.max(axis=1)
