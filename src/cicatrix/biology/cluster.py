"""Bonds that share a load: when one opens, the others bear its part."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from ..core.law import Law, param
from ..core.random import Phase, site_words
from ..numerics.roots import rising_root

SEARCHED_PN, N_SEARCHED = (1e-4, 1e6), 512  # forces of one bond, at equal ratios


class ForceSharing(Law):
    r"""Cluster under a constant force, in units of a bond's own rate of opening and of the force that speeds it up e-fold.

    .. math:: r_i = i \, e^{f / i}, \qquad g_i = \gamma (N - i)

    with i of N bonds closed. Source: Erdmann & Schwarz, Phys. Rev. Lett. 92, 108102 (2004) and J. Chem. Phys. 121, 8997 (2004),
    after Bell (1978); Guo, Mofrad & Buganza Tepole name integrin clustering and give no form.

    Parameters
    ----------
    gamma : float or (...) array [1]
        Rate of closing over that of opening without load.
    """

    gamma: float | Array = param("1", "gamma", low=0.0)

    def opening(self, closed: Array, force: Array) -> Array:
        """Rate at which one of i closed bonds opens: i (...), whole force f (...) [1] -> (...) [1]."""
        return closed * jnp.exp(force / closed)

    def closing(self, closed: Array, size: int) -> Array:
        """Rate at which one of the open bonds closes (...) [1]."""
        return self.gamma * (size - closed)

    def lifetime(self, size: int, force: Array) -> Array:
        """Mean time until all of N bonds, closed at first, are open: force f (...) [1] -> (...) [1]."""
        closed = jnp.arange(1.0, size + 1.0)
        force = jnp.asarray(force, float)[..., None]
        return mean_lifetime(self.opening(closed, force), self.closing(closed, size) + jnp.zeros_like(force))

    def critical_force(self, size: int) -> Array:
        r"""Largest force under which the deterministic equation :math:`\dot i = -i e^{f/i} + \gamma (N - i)` has a fixed point.

        :math:`f_c = N w` with :math:`w e^w = \gamma / e`, (...) [1].
        """
        gamma = jnp.asarray(self.gamma, float)
        w = rising_root(lambda w: w * jnp.exp(w) - gamma / jnp.e, jnp.zeros_like(gamma), gamma / jnp.e)
        return size * w


def mean_lifetime(opening: Array, closing: Array) -> Array:
    """Mean time from N closed bonds to none, by the one-step master equation: rates (..., N) [1/s] -> (...) [s].

    Parameters
    ----------
    opening, closing : (..., N) array [1/s]
        With i = 1 .. N bonds closed, of one of these to open and of another one to close; none closes when all are, and none
        once all are open.

    Notes
    -----
    From i to i - 1 it takes 1/r_i + g_i/r_i times what it takes from i + 1 to i (Van Kampen, Stochastic Processes, chapter XII);
    only sums and products of positive numbers, so nothing is lost.
    """

    def onward(above: Array, rates: tuple[Array, Array]) -> tuple[Array, Array]:
        r, g = rates
        here = (1.0 + g * above) / r
        return here, here

    rates = (jnp.moveaxis(opening, -1, 0), jnp.moveaxis(jnp.asarray(closing).at[..., -1].set(0.0), -1, 0))
    _, steps = lax.scan(onward, jnp.zeros(opening.shape[:-1]), rates, reverse=True)
    return jnp.sum(steps, axis=0)


def sample_lifetimes(opening: np.ndarray, closing: np.ndarray, n: int, seed: int, most: int = 10_000_000) -> np.ndarray:
    """Lifetimes (n,) [s] of clusters that start closed, by exact stochastic simulation: rates (N,) [1/s] as of ``mean_lifetime``.

    A draw belongs to seed, cluster and event. Clusters that live through ``most`` events give NaN.
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
    """Mean lifetime (...) [s] of N bonds that bear N times a force together, each with its own piece of substrate.

    Parameters
    ----------
    per_bond : (...) array [pN]
        Force of each while all are closed.
    k_off : callable
        Rate of opening of one bond under a force (..., N) [pN] -> (..., N) [1/s].
    k_on : (...) array [1/s]
        Rate of closing of one.
    rebinding : bool
        Whether a bond that is open closes again.
    """
    closed = jnp.arange(1.0, size + 1.0)
    opening = closed * k_off(jnp.asarray(per_bond)[..., None] * size / closed)
    closing = (jnp.asarray(k_on)[..., None] * (size - closed)) * float(rebinding) + jnp.zeros_like(opening)
    return mean_lifetime(opening, closing)


def critical_load(size: int, k_off: Callable[[Array], Array], k_on: np.ndarray) -> np.ndarray:
    r"""Largest force (s,) [pN] under which the mean number of closed bonds has a fixed point, in s places.

    N bonds that each bear f hold :math:`F = N f \, k_{on} / (k_{on} + k_{off}(f))` together; the largest F is searched for. Of
    :class:`ForceSharing` it is :meth:`ForceSharing.critical_force`.

    Parameters
    ----------
    k_off : callable
        Rate of opening of one bond under a force (s, n) [pN] -> (s, n) [1/s].
    k_on : (s,) array [1/s]
        Rate of closing of one.
    """
    low, high = (np.full(k_on.shape, np.log(force)) for force in SEARCHED_PN)
    for _ in range(3):  # the last grid is fine to 1e-6
        step = (high - low) / (N_SEARCHED - 1)
        force = np.exp(low[:, None] + step[:, None] * np.arange(N_SEARCHED))
        bound = k_on[:, None] / (k_on[:, None] + np.asarray(k_off(jnp.asarray(force))))
        held = np.nan_to_num(force * bound)  # not a number where the substrate does not hold
        best = held.argmax(axis=1)
        low, high = low + (best - 1) * step, low + (best + 1) * step
    return size * held.max(axis=1)
