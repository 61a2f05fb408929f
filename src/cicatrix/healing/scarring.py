"""What happens at a point of a healing wound: collagen, permanent stretch, direction and spread of fibres, what cells feel."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from ..biology.sensing import Sensing
from ..biology.turnover import Contents, Turnover
from ..core.law import Law, param
from ..materials.scar import Scar
from ..numerics.compiler import COMPILER
from ..numerics.implicit import solve
from ..numerics.spectral import eigh
from ..numerics.tensors import IDENTITY, along, det, right_cauchy_green

ALIKE = 1e-6  # squares of stretches, relative to their sum, that are not told apart: then no direction is the first


class Local(NamedTuple):
    """What a point holds besides cells and cytokine; each (..., ) and as many axes d, 2 of a sheet, 3 of a solid."""

    phi: Array
    """Collagen over that of healthy tissue (...) [1]."""
    stretch: Array
    """Permanent stretches along ``axes`` (..., d) [1]."""
    spread: Array
    """Dispersion kappa of the fibres (...) [1]: 1/d in all directions, 0 all along the first axis."""
    axes: Array
    """Material axes a_0, s_0, n_0 as rows (..., 3, 3) [1]."""
    sensed: Array
    """States of what cells feel (..., n_states)."""


class Felt(NamedTuple):
    """Elastic measures at a point, each (...)."""

    stretches: Array
    """Elastic stretch along each of the material axes (..., d) [1]."""
    strain: Array
    """Elastic change of a sheet's area, of a solid's volume [1]."""
    fibre: Array
    """Elastic stretch of the fibres, root of their mean square [1]."""


class Contracture(Law):
    r"""Permanent stretch by turnover of collagen, :math:`\dot\lambda_i = (\varphi^+ / \tau_P) (\lambda^e_i - 1)`.

    Source: docs/theory/wound.md. Within the band nothing yields; beyond it what exceeds the band counts.

    Parameters
    ----------
    tau_P : float or (...) array [1]
        How much new collagen it takes.
    low, high : float or (...) array [1]
        Elastic stretches between which nothing yields.
    """

    tau_P: float | Array = param("1", "tau_P", above=0.0, default=0.485)
    low: float | Array = param("1", "band,low", low=0.0, high=1.0, default=1.0)
    high: float | Array = param("1", "band,high", low=1.0, default=1.0)

    def rate(self, felt: Felt, deposition: Array, change: Array) -> Array:
        """Of permanent stretches (..., d) [1/s], by production and net change of collagen (...) [1/s]."""
        beyond = felt.stretches - jnp.clip(felt.stretches, self.low, self.high)
        return (deposition / self.tau_P)[..., None] * beyond


class CollagenGrowth(Law):
    r"""Growth by the collagen that is gained, :math:`\dot\lambda_i = \dot\varphi / \varrho_f`: R Eq. (27).

    Parameters
    ----------
    density : float or (...) array [1]
        varrho_f.
    """

    density: float | Array = param("1", "varrho_f", above=0.0, default=1.0)

    def rate(self, felt: Felt, deposition: Array, change: Array) -> Array:
        """Of permanent stretches (..., d) [1/s], by production and net change of collagen (...) [1/s]."""
        return jnp.broadcast_to((change / self.density)[..., None], felt.stretches.shape)


class Reorientation(Law):
    r"""Fibres that turn to the largest elastic stretch, and gather about it.

    .. math:: \dot a_0 = \frac{2 \pi \varphi^+}{\tau_\omega} \lambda_{max} (I - a_0 \otimes a_0) \, e_{max}, \qquad
        \dot\kappa = \frac{\varphi^+}{\tau_\kappa}
            \left[ \frac{1}{d} \left(\frac{\lambda_{mid}}{\lambda_{max}}\right)^{\gamma_\kappa} - \kappa \right]

    Source: docs/theory/wound.md. Where the largest stretch is that of more than one direction nothing turns.

    Parameters
    ----------
    tau_omega, tau_kappa : float or (...) array [1]
        How much new collagen turning and gathering take.
    gamma_kappa : float or (...) array [1]
        How sharply fibres gather.
    """

    tau_omega: float | Array = param("1", "tau_omega", above=0.0)
    tau_kappa: float | Array = param("1", "tau_kappa", above=0.0)
    gamma_kappa: float | Array = param("1", "gamma_kappa", low=0.0, default=5.0)


class Scarring(Law):
    r"""Local rates of a healing wound, and the tissue that they leave behind.

    Collagen follows :class:`..biology.turnover.Turnover`; the active traction is

    .. math:: T = \left[ \left( t_\rho + t_{\rho,c} \frac{c}{K_{t,c} + c} \right) \rho \, \frac{\varphi}{K_t^2 + \varphi^2}
            - T_0 \right]_+

    Source: docs/theory/wound.md, densities over those of healthy tissue; T_0, for bodies whose shape before surgery
    already holds the pull of healthy tissue, is ours.

    Parameters
    ----------
    turnover : Turnover
        Cells, cytokine and collagen.
    sensing : Sensing
        H.
    yielding : Contracture or CollagenGrowth
        Permanent stretch.
    turning : Reorientation, optional
        Of the fibres; without it they stay.
    k_0, k_f, k_2, k_v : float or (...) array [kPa], [kPa], [1], [kPa]
        As of :class:`..materials.scar.Scar`.
    t_rho, t_rho_c : float or (...) array [kPa]
        Traction of healthy cells, and most that cytokine adds.
    K_t, K_t_c : float or (...) array [1]
        Collagen, and cytokine, of saturation.
    T_0 : float or (...) array [kPa]
        Traction that does not count; 0 unless given.
    is_sheet : bool
        Whether the third axis is a sheet's normal.
    """

    turnover: Turnover
    sensing: Sensing
    yielding: Contracture | CollagenGrowth
    turning: Reorientation | None
    k_0: float | Array = param("kPa", "k_0", above=0.0)
    k_f: float | Array = param("kPa", "k_f", low=0.0)
    k_2: float | Array = param("1", "k_2", above=0.0)
    k_v: float | Array = param("kPa", "k_v", low=0.0)
    t_rho: float | Array = param("kPa", "t_rho", low=0.0)
    t_rho_c: float | Array = param("kPa", "t_rho,c", low=0.0)
    K_t: float | Array = param("1", "K_t", above=0.0)
    K_t_c: float | Array = param("1", "K_t,c", above=0.0)
    T_0: float | Array = param("kPa", "T_0", low=0.0, default=0.0)
    is_sheet: bool = eqx.field(static=True, default=False)

    @property
    def n_axes(self) -> int:
        """Axes along which tissue yields."""
        return 2 if self.is_sheet else 3

    def felt(self, F: Array, has: Local) -> Felt:
        """Elastic measures of tissue deformed by F (..., 3, 3) [1]."""
        return self._felt(*self._measures(F, has.axes), has.stretch, has.spread)

    def _felt(self, total: Array, whole: Array, stretch: Array, spread: Array) -> Felt:
        own = total / stretch
        squares = own * own
        mean = spread * jnp.sum(squares, axis=-1) + (1.0 - self.n_axes * spread) * squares[..., 0]
        return Felt(own, whole / jnp.prod(stretch, axis=-1) - 1.0, jnp.sqrt(mean))

    def signal(self, F: Array, has: Local) -> Array:
        """H (...) at points deformed by F (..., 3, 3) [1]."""
        felt = self.felt(F, has)
        return self.sensing.value(has.sensed, felt.fibre, felt.strain)

    def advanced(self, F: Array, rho: Array, c: Array, start: Local, guess: Local, dt: Array | float) -> Local:
        """One implicit Euler step dt [s] that ends at F (..., 3, 3), rho, c (...) [1].

        Where fibres turn, directions are those of ``guess``, a state near the end.
        """
        total, whole = self._measures(F, guess.axes)
        ratio, first, largest = self._principal(F, guess) if self.turning else (0.0, 0.0, 0.0)

        def residual(z: Array) -> Array:
            phi, stretch, spread, sensed = self._unpacked(z)
            felt = self._felt(total, whole, stretch, spread)
            contents = Contents(rho, c, phi)
            H = self.sensing.value(sensed, felt.fibre, felt.strain)
            made, change = self.turnover.deposition(contents, H), self.turnover.rates(contents, H).m_f
            gathered = (
                jnp.zeros_like(spread) if self.turning is None else made / self.turning.tau_kappa * (ratio - spread)
            )
            sensing = self.sensing.rate(sensed, felt.fibre, felt.strain)
            rate = self._packed(change, self.yielding.rate(felt, made, change), gathered, sensing)
            return z - self._packed(start.phi, start.stretch, start.spread, start.sensed) - dt * rate

        z = solve(residual, self._packed(guess.phi, guess.stretch, guess.spread, guess.sensed))
        phi, stretch, spread, sensed = self._unpacked(z)
        end = Local(phi, stretch, spread, start.axes, sensed)
        if self.turning is None:
            return end
        made = self.turnover.deposition(Contents(rho, c, phi), self.signal(F, end))
        return end._replace(
            axes=self._turned(
                start.axes, guess.axes, first, dt * 2.0 * jnp.pi * made / self.turning.tau_omega * largest
            )
        )

    def _measures(self, F: Array, axes: Array) -> tuple[Array, Array]:
        """Stretches along the axes (..., d), and change of area or volume (...)."""
        columns = [along(F, axes[..., i, :]) for i in range(self.n_axes)]
        total = jnp.stack([jnp.sqrt(jnp.sum(v * v, axis=-1)) for v in columns], axis=-1)
        whole = F[..., 0, 0] * F[..., 1, 1] - F[..., 0, 1] * F[..., 1, 0] if self.is_sheet else det(F)
        return total, whole

    def _principal(self, F: Array, has: Local) -> tuple[Array, Array, Array]:
        """Target of the spread (...), direction of the largest elastic stretch (..., 3), 0 where there is none, and it (...)."""
        C = right_cauchy_green(product_of(F, self.inverse(has)))
        if self.is_sheet:
            C = C.at[..., 2, :].set(0.0).at[..., :, 2].set(0.0)
        values, vectors = lax.stop_gradient(eigh(C))
        order = jnp.argsort(-values, axis=-1)
        values = jnp.take_along_axis(values, order, axis=-1)
        first = jnp.take_along_axis(vectors, order[..., None, :], axis=-1)[..., 0]
        largest, middle = values[..., 0], values[..., 1]
        is_one = (largest - middle > ALIKE * jnp.sum(values, axis=-1))[..., None]
        target = (middle / largest) ** (0.5 * self.turning.gamma_kappa) / self.n_axes
        return target, jnp.where(is_one, first, 0.0), jnp.sqrt(largest)

    @staticmethod
    def _turned(start: Array, guess: Array, first: Array, angle: Array) -> Array:
        """Axes (..., 3, 3) after the first has been drawn towards a direction (..., 3); the others follow with the least turn."""
        a = guess[..., 0, :]
        side = jnp.sum(a * first, axis=-1, keepdims=True)
        pull = jnp.where(side < 0.0, -1.0, 1.0) * (first - side * a)
        new = start[..., 0, :] + angle[..., None] * pull
        new = new / jnp.linalg.norm(new, axis=-1, keepdims=True)
        return _carried(start, new)

    def scar(self, has: Local, rho: Array, c: Array) -> Scar:
        """The tissue at an instant."""
        tension = jnp.maximum(self.traction(rho, c, has.phi) - self.T_0, 0.0)
        stiffness = self.k_0, self.k_f, self.k_2, self.k_v
        return Scar(self.permanent(has), self.structure(has), *stiffness, has.phi, tension, self.is_sheet)

    def traction(self, rho: Array | float, c: Array | float, phi: Array | float) -> Array | float:
        """Of cells, before T_0 is taken off (...) [kPa]."""
        return (self.t_rho + self.t_rho_c * c / (self.K_t_c + c)) * rho * phi / (self.K_t**2 + phi**2)

    def permanent(self, has: Local) -> Array:
        """F_p (..., 3, 3) [1]."""
        return _along_axes(has.stretch, has.axes) + (_across(has.axes) if self.is_sheet else 0.0)

    def inverse(self, has: Local) -> Array:
        """F_p^-1 (..., 3, 3) [1]."""
        return _along_axes(1.0 / has.stretch, has.axes) + (_across(has.axes) if self.is_sheet else 0.0)

    def structure(self, has: Local) -> Array:
        """A_0 = kappa I + (1 - d kappa) a_0 x a_0 (..., 3, 3) [1], I of a sheet in its plane."""
        whole = IDENTITY - _across(has.axes) if self.is_sheet else IDENTITY
        a = has.axes[..., 0, :]
        spread = has.spread[..., None, None]
        return spread * whole + (1.0 - self.n_axes * spread) * a[..., :, None] * a[..., None, :]

    def _packed(self, phi: Array, stretch: Array, spread: Array, sensed: Array) -> Array:
        shape = phi.shape
        return jnp.concatenate(
            [phi[..., None], jnp.broadcast_to(stretch, (*shape, self.n_axes)), spread[..., None], sensed], axis=-1
        )

    def _unpacked(self, z: Array) -> tuple[Array, Array, Array, Array]:
        d = self.n_axes
        return z[..., 0], z[..., 1 : 1 + d], z[..., 1 + d], z[..., 2 + d :]


def tidied(has: Local) -> Local:
    """A mixture of states as a state: its axes orthonormal again."""
    a, s = has.axes[..., 0, :], has.axes[..., 1, :]
    a = a / jnp.linalg.norm(a, axis=-1, keepdims=True)
    s = s - jnp.sum(a * s, axis=-1, keepdims=True) * a
    s = s / jnp.linalg.norm(s, axis=-1, keepdims=True)
    return has._replace(axes=jnp.stack([a, s, jnp.cross(a, s)], axis=-2))


def product_of(A: Array, B: Array) -> Array:
    """A B (..., 3, 3)."""
    return jnp.einsum("...ij,...jk->...ik", A, B)


def _carried(axes: Array, new: Array) -> Array:
    """Turn axes (..., 3, 3) so that the first becomes another (..., 3), about the normal of both."""
    old = axes[..., 0, :]
    whole = old + new
    shrink = 1.0 + jnp.sum(old * new, axis=-1)

    def carried(v: Array) -> Array:
        share = jnp.sum(v * whole, axis=-1) / shrink
        return v - share[..., None] * whole + 2.0 * jnp.sum(v * old, axis=-1)[..., None] * new

    return jnp.stack([new, carried(axes[..., 1, :]), carried(axes[..., 2, :])], axis=-2)


def _along_axes(values: Array, axes: Array) -> Array:
    """Sum of values (..., d) times the squares of the first d axes -> (..., 3, 3)."""
    d = values.shape[-1]
    return jnp.einsum("...d,...di,...dj->...ij", values, axes[..., :d, :], axes[..., :d, :])


def _across(axes: Array) -> Array:
    n = axes[..., 2, :]
    return n[..., :, None] * n[..., None, :]


@partial(jax.jit, compiler_options=COMPILER)
def advanced(
    law: Scarring, F: Array, rho: Array, c: Array, start: Local, guess: Local, dt: float
) -> tuple[Local, Array]:
    """:meth:`Scarring.advanced` and the signal at its end, compiled once for a kind of law."""
    end = law.advanced(F, rho, c, start, guess, dt)
    return end, law.signal(F, end)


@partial(jax.jit, compiler_options=COMPILER)
def tissue(law: Scarring, has: Local, rho: Array, c: Array) -> Scar:
    """:meth:`Scarring.scar`, compiled."""
    return law.scar(has, rho, c)
