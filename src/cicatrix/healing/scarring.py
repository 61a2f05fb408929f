"""Local model of a healing wound: collagen, permanent stretch, direction and dispersion of fibres, and mechanosensing."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from ..biology.sensing import Sensing
from ..biology.turnover import Densities, Turnover
from ..core.law import Law, param
from ..materials.scar import Scar
from ..numerics.compiler import COMPILER
from ..numerics.implicit import solve
from ..numerics.spectral import eigh
from ..numerics.tensors import IDENTITY, along, det, right_cauchy_green

ALIKE = 1e-6  # difference of squared stretches, relative to their sum, below which they count as equal


class Local(NamedTuple):
    """Internal variables of healing tissue at points (...), with d = 2 axes in a sheet and d = 3 in a solid."""

    phi: Array
    """Collagen relative to that of healthy tissue (...) [1]."""
    stretch: Array
    """Permanent stretches along ``axes`` (..., d) [1]."""
    dispersion: Array
    """Dispersion kappa of the fibres (...) [1]: 1/d if isotropic, 0 if all lie along the first axis."""
    axes: Array
    """Material axes a_0, s_0, n_0 as rows (..., 3, 3) [1]."""
    signal_state: Array
    """State variables of mechanosensing (..., n_states)."""


class ElasticMeasures(NamedTuple):
    """Elastic strain measures at points (...)."""

    stretches: Array
    """Elastic stretch along each of the material axes (..., d) [1]."""
    strain: Array
    """Elastic area strain of a sheet or volume strain of a solid [1]."""
    fibre: Array
    """Elastic stretch of the fibres, root mean square over their directions [1]."""


class Contracture(Law):
    r"""Permanent stretch by turnover of collagen, :math:`\dot\lambda_i = (\varphi^+ / \tau_P) (\lambda^e_i - 1)`.

    Source: docs/theory/wound.md. Between the elastic stretches ``low`` and ``high`` the permanent stretch does not change;
    outside, the distance from this band takes the place of :math:`\lambda^e_i - 1`.

    Parameters
    ----------
    tau_P : float or (...) array [1]
        Amount of deposited collagen over which the elastic stretch relaxes.
    low, high : float or (...) array [1]
        Limits of the elastic stretch between which the permanent stretch does not change.
    """

    tau_P: float | Array = param("1", "tau_P", above=0.0, default=0.485)
    low: float | Array = param("1", "band,low", low=0.0, high=1.0, default=1.0)
    high: float | Array = param("1", "band,high", low=1.0, default=1.0)

    def rate(self, elastic: ElasticMeasures, deposition: Array, change: Array) -> Array:
        """Return the rate of the permanent stretches (..., d) [1/s] for a production and a net change of collagen (...) [1/s]."""
        beyond = elastic.stretches - jnp.clip(elastic.stretches, self.low, self.high)
        return (deposition / self.tau_P)[..., None] * beyond


class CollagenGrowth(Law):
    r"""Growth in proportion to the net change of collagen, :math:`\dot\lambda_i = \dot\varphi / \varrho_f`.

    Source: Guo, Mofrad & Buganza Tepole, Eq. (27).

    Parameters
    ----------
    density : float or (...) array [1]
        Change of collagen per unit of permanent stretch, varrho_f.
    """

    density: float | Array = param("1", "varrho_f", above=0.0, default=1.0)

    def rate(self, elastic: ElasticMeasures, deposition: Array, change: Array) -> Array:
        """Return the rate of the permanent stretches (..., d) [1/s] for a production and a net change of collagen (...) [1/s]."""
        return jnp.broadcast_to((change / self.density)[..., None], elastic.stretches.shape)


class Reorientation(Law):
    r"""Rotation of the fibres towards the largest elastic stretch, and their alignment with it.

    .. math:: \dot a_0 = \frac{2 \pi \varphi^+}{\tau_\omega} \lambda_{max} (I - a_0 \otimes a_0) \, e_{max}, \qquad
        \dot\kappa = \frac{\varphi^+}{\tau_\kappa}
            \left[ \frac{1}{d} \left(\frac{\lambda_{mid}}{\lambda_{max}}\right)^{\gamma_\kappa} - \kappa \right]

    Source: docs/theory/wound.md. Where the direction of the largest stretch is not unique the fibres do not rotate.

    Parameters
    ----------
    tau_omega, tau_kappa : float or (...) array [1]
        Amounts of deposited collagen over which the fibres rotate and align.
    gamma_kappa : float or (...) array [1]
        Exponent of the stretch ratio; the larger it is, the more strongly the fibres align.
    """

    tau_omega: float | Array = param("1", "tau_omega", above=0.0)
    tau_kappa: float | Array = param("1", "tau_kappa", above=0.0)
    gamma_kappa: float | Array = param("1", "gamma_kappa", low=0.0, default=5.0)


class Scarring(Law):
    r"""Local evolution equations of a healing wound, and the constitutive law of the resulting tissue.

    Collagen follows :class:`..biology.turnover.Turnover`; the active traction is

    .. math:: T = \left[ \left( t_\rho + t_{\rho,c} \frac{c}{K_{t,c} + c} \right) \rho \, \frac{\varphi}{K_t^2 + \varphi^2}
            - T_0 \right]_+

    Source: docs/theory/wound.md; all densities are relative to healthy tissue. T_0 is not in the source: it is for bodies whose
    shape before surgery already includes the traction of healthy tissue.

    Parameters
    ----------
    turnover : Turnover
        Rates of cells, cytokine and collagen.
    sensing : Sensing
        Model of the mechanical signal H.
    yielding : Contracture or CollagenGrowth
        Evolution law of the permanent stretch.
    turning : Reorientation, optional
        Evolution law of the fibre direction and dispersion; without it they do not change.
    k_0, k_f, k_2, k_v : float or (...) array [kPa], [kPa], [1], [kPa]
        Stiffness parameters, as in :class:`..materials.scar.Scar`.
    t_rho, t_rho_c : float or (...) array [kPa]
        Traction coefficients: of cells without cytokine, and the largest increase by cytokine.
    K_t, K_t_c : float or (...) array [1]
        Saturation constants of collagen and of cytokine.
    T_0 : float or (...) array [kPa]
        Traction that is subtracted; default 0.
    is_sheet : bool
        Whether the body is a sheet whose normal is the third axis.
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
        """Number d of axes with a permanent stretch."""
        return 2 if self.is_sheet else 3

    def elastic_measures(self, F: Array, has: Local) -> ElasticMeasures:
        """Return the elastic strain measures of tissue deformed by F (..., 3, 3) [1]."""
        return self._elastic_measures(*self._measures(F, has.axes), has.stretch, has.dispersion)

    def _elastic_measures(self, total: Array, whole: Array, stretch: Array, dispersion: Array) -> ElasticMeasures:
        own = total / stretch
        squares = own * own
        mean = dispersion * jnp.sum(squares, axis=-1) + (1.0 - self.n_axes * dispersion) * squares[..., 0]
        return ElasticMeasures(own, whole / jnp.prod(stretch, axis=-1) - 1.0, jnp.sqrt(mean))

    def signal(self, F: Array, has: Local) -> Array:
        """Return the mechanical signal H (...) [1] at points deformed by F (..., 3, 3) [1]."""
        elastic = self.elastic_measures(F, has)
        return self.sensing.value(has.signal_state, elastic.fibre, elastic.strain)

    def step(self, F: Array, rho: Array, c: Array, start: Local, guess: Local, dt: Array | float) -> Local:
        """Return the state after an implicit Euler step dt [s] with end values F (..., 3, 3) and rho, c (...) [1].

        Fibre axes and principal directions are evaluated at ``guess``, a state near the end of the step.
        """
        total, whole = self._measures(F, guess.axes)
        ratio, first, largest = self._principal(F, guess) if self.turning else (0.0, 0.0, 0.0)

        def residual(z: Array) -> Array:
            phi, stretch, dispersion, signal_state = self._unpacked(z)
            elastic = self._elastic_measures(total, whole, stretch, dispersion)
            densities = Densities(rho, c, phi)
            H = self.sensing.value(signal_state, elastic.fibre, elastic.strain)
            made, change = self.turnover.deposition(densities, H), self.turnover.rates(densities, H).m_f
            gathered = (
                jnp.zeros_like(dispersion)
                if self.turning is None
                else made / self.turning.tau_kappa * (ratio - dispersion)
            )
            sensing = self.sensing.rate(signal_state, elastic.fibre, elastic.strain)
            rate = self._packed(change, self.yielding.rate(elastic, made, change), gathered, sensing)
            return z - self._packed(start.phi, start.stretch, start.dispersion, start.signal_state) - dt * rate

        z = solve(residual, self._packed(guess.phi, guess.stretch, guess.dispersion, guess.signal_state))
        phi, stretch, dispersion, signal_state = self._unpacked(z)
        end = Local(phi, stretch, dispersion, start.axes, signal_state)
        if self.turning is None:
            return end
        made = self.turnover.deposition(Densities(rho, c, phi), self.signal(F, end))
        return end._replace(
            axes=self._turned(
                start.axes, guess.axes, first, dt * 2.0 * jnp.pi * made / self.turning.tau_omega * largest
            )
        )

    def _measures(self, F: Array, axes: Array) -> tuple[Array, Array]:
        """Return the stretches along the axes (..., d), and the area or volume ratio (...)."""
        columns = [along(F, axes[..., i, :]) for i in range(self.n_axes)]
        total = jnp.stack([jnp.sqrt(jnp.sum(v * v, axis=-1)) for v in columns], axis=-1)
        whole = F[..., 0, 0] * F[..., 1, 1] - F[..., 0, 1] * F[..., 1, 0] if self.is_sheet else det(F)
        return total, whole

    def _principal(self, F: Array, has: Local) -> tuple[Array, Array, Array]:
        """Return the steady dispersion (...), and direction (..., 3; 0 if not unique) and value (...) of the largest stretch."""
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
        """Rotate the axes ``start`` (..., 3, 3): their first turns by an angle (...) towards a direction ``first`` (..., 3)."""
        a = guess[..., 0, :]
        side = jnp.sum(a * first, axis=-1, keepdims=True)
        pull = jnp.where(side < 0.0, -1.0, 1.0) * (first - side * a)
        new = start[..., 0, :] + angle[..., None] * pull
        new = new / jnp.linalg.norm(new, axis=-1, keepdims=True)
        return _carried(start, new)

    def scar(self, has: Local, rho: Array, c: Array) -> Scar:
        """Return the constitutive law of the tissue for its internal variables, and cells and cytokine rho, c (...) [1]."""
        tension = jnp.maximum(self.traction(rho, c, has.phi) - self.T_0, 0.0)
        stiffness = self.k_0, self.k_f, self.k_2, self.k_v
        return Scar(self.permanent(has), self.structure(has), *stiffness, has.phi, tension, self.is_sheet)

    def traction(self, rho: Array | float, c: Array | float, phi: Array | float) -> Array | float:
        """Return the traction of cells, without subtraction of T_0: cells, cytokine and collagen (...) [1] -> (...) [kPa]."""
        return (self.t_rho + self.t_rho_c * c / (self.K_t_c + c)) * rho * phi / (self.K_t**2 + phi**2)

    def permanent(self, has: Local) -> Array:
        """Return the permanent deformation F_p (..., 3, 3) [1]."""
        return _along_axes(has.stretch, has.axes) + (_across(has.axes) if self.is_sheet else 0.0)

    def inverse(self, has: Local) -> Array:
        """Return the inverse F_p^-1 of the permanent deformation (..., 3, 3) [1]."""
        return _along_axes(1.0 / has.stretch, has.axes) + (_across(has.axes) if self.is_sheet else 0.0)

    def structure(self, has: Local) -> Array:
        """Return the structure tensor A_0 = kappa I + (1 - d kappa) a_0 x a_0 (..., 3, 3) [1]; in a sheet I is in-plane."""
        whole = IDENTITY - _across(has.axes) if self.is_sheet else IDENTITY
        a = has.axes[..., 0, :]
        dispersion = has.dispersion[..., None, None]
        return dispersion * whole + (1.0 - self.n_axes * dispersion) * a[..., :, None] * a[..., None, :]

    def _packed(self, phi: Array, stretch: Array, dispersion: Array, signal_state: Array) -> Array:
        shape = phi.shape
        return jnp.concatenate(
            [phi[..., None], jnp.broadcast_to(stretch, (*shape, self.n_axes)), dispersion[..., None], signal_state],
            axis=-1,
        )

    def _unpacked(self, z: Array) -> tuple[Array, Array, Array, Array]:
        d = self.n_axes
        return z[..., 0], z[..., 1 : 1 + d], z[..., 1 + d], z[..., 2 + d :]


def orthonormalised(has: Local) -> Local:
    """Return a state with its axes made orthonormal, as is needed after a linear combination of states."""
    a, s = has.axes[..., 0, :], has.axes[..., 1, :]
    a = a / jnp.linalg.norm(a, axis=-1, keepdims=True)
    s = s - jnp.sum(a * s, axis=-1, keepdims=True) * a
    s = s / jnp.linalg.norm(s, axis=-1, keepdims=True)
    return has._replace(axes=jnp.stack([a, s, jnp.cross(a, s)], axis=-2))


def product_of(A: Array, B: Array) -> Array:
    """Return the matrix product A B (..., 3, 3)."""
    return jnp.einsum("...ij,...jk->...ik", A, B)


def _carried(axes: Array, new: Array) -> Array:
    """Rotate axes (..., 3, 3) so that the first becomes ``new`` (..., 3), about the common normal of the two."""
    old = axes[..., 0, :]
    whole = old + new
    shrink = 1.0 + jnp.sum(old * new, axis=-1)

    def carried(v: Array) -> Array:
        share = jnp.sum(v * whole, axis=-1) / shrink
        return v - share[..., None] * whole + 2.0 * jnp.sum(v * old, axis=-1)[..., None] * new

    return jnp.stack([new, carried(axes[..., 1, :]), carried(axes[..., 2, :])], axis=-2)


def _along_axes(values: Array, axes: Array) -> Array:
    """Return the sum over the first d axes of values (..., d) times the dyad of the axis: (..., 3, 3)."""
    d = values.shape[-1]
    return jnp.einsum("...d,...di,...dj->...ij", values, axes[..., :d, :], axes[..., :d, :])


def _across(axes: Array) -> Array:
    n = axes[..., 2, :]
    return n[..., :, None] * n[..., None, :]


@partial(jax.jit, compiler_options=COMPILER)
def local_step(
    law: Scarring, F: Array, rho: Array, c: Array, start: Local, guess: Local, dt: float
) -> tuple[Local, Array]:
    """Return the result of :meth:`Scarring.step` and the signal H at the end of the step; compiled once per type of law."""
    end = law.step(F, rho, c, start, guess, dt)
    return end, law.signal(F, end)


@partial(jax.jit, compiler_options=COMPILER)
def tissue(law: Scarring, has: Local, rho: Array, c: Array) -> Scar:
    """Return the constitutive law of the tissue by :meth:`Scarring.scar`, compiled."""
    return law.scar(has, rho, c)
