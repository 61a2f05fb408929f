"""Fibres with distributed orientation and waviness: recruitment, and optionally a viscous branch per fibre."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import combinations_with_replacement, product

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from ..core.law import Law, choice, count, param
from ..numerics.implicit import solve
from ..numerics.tensors import right_cauchy_green, tangent_of
from .material import EnergyMaterial, Response, State
from .orientation import Bingham, Fisher, Orientation, Single, VonMises
from .waviness import Beta, Triangular, Uniform, Waviness

ORIENTATIONS = {"von-mises": VonMises, "single": Single, "fisher": Fisher, "bingham": Bingham}
WAVINESSES = {"uniform": Uniform, "triangular": Triangular, "beta": Beta}
MONOMIALS = {
    order: list(combinations_with_replacement(range(3), order)) for order in (2, 4)
}  # indices of the components of V in each monomial
PLACES = {  # index of the monomial in every entry of V x V, or of V x V x V x V
    order: np.array([names.index(tuple(sorted(at))) for at in product(range(3), repeat=order)]).reshape((3,) * order)
    for order, names in MONOMIALS.items()
}


class FibreViscosity(Law):
    r"""A Maxwell branch along each fibre.

    .. math:: \dot\lambda_v / \lambda_v = \tau / \eta, \qquad \tau = \beta \mu_f (\lambda_e^2 - 1 / \lambda_e), \qquad
        \lambda_e = \lambda_f / \lambda_v, \qquad \eta = 3 \beta \mu_f \, t_r

    Source: Guo, Mofrad & Buganza Tepole, Eqs (6)-(7), with eta in kPa s. :math:`\lambda_f = \max(\lambda / \lambda_w, 1)` is the
    stretch of the straightened fibre: while the fibre is slack, its branch relaxes
    and transmits no force.

    Parameters
    ----------
    beta : float or (...) array [1]
        Stiffness of the branch relative to that of the fibre.
    relaxation : float or (...) array [s]
        Relaxation time :math:`t_r` at small strain.
    n_waviness : int
        Number of Gauss points over the waviness (for each smooth piece of its density).
    """

    beta: float | Array = param("1", "beta", low=0.0)
    relaxation: float | Array = param("s", "t_r", above=0.0)
    n_waviness: int = count("n_w", low=1, high=1024, default=16)


class FibreDistribution(EnergyMaterial):
    r"""Fibres with distributed directions and waviness.

    .. math:: \Psi = \frac{\mu_f}{2} \int \rho_w \int \rho_\theta \left[ \bar\lambda^2 + \frac{2}{\bar\lambda} - 3 \right]
        d\theta \, d\lambda_w, \qquad \bar\lambda = \max(\lambda / \lambda_w, 1), \qquad \lambda = |F V(\theta)|

    Source: Guo, Mofrad & Buganza Tepole, Eqs (4)-(5); a slack fibre carries no load, which the printed equations omit. The
    integral of the elastic part over waviness is in closed form (for beta densities: by quadrature to rounding error). The
    integral over directions is the sum of :mod:`.orientation`; :func:`quadrature_error` measures its error.

    Parameters
    ----------
    mu_f : float or (...) array [kPa]
        Stiffness: a straight fibre has the modulus 3 mu_f at small strain.
    orientation : Orientation
        Directions of the fibres.
    waviness : Waviness, optional
        Distribution of the waviness; if omitted, all fibres are straight from the start.
    viscous : FibreViscosity, optional
        Viscous branches; if omitted, the fibres are elastic.
    """

    mu_f: float | Array = param("kPa", "mu_f", low=0.0)
    orientation: Orientation = choice(ORIENTATIONS)
    waviness: Waviness | None = choice(WAVINESSES, default=None)
    viscous: FibreViscosity | None = None

    def energy(self, F: Array, state: State = ()) -> Array:
        """Return Psi at points: F (..., 3, 3) [1] -> (...) [kPa]."""
        stretch, weight = stretches(F, self.orientation)
        total = self.mu_f * jnp.sum(weight * self._elastic(stretch), axis=-1)
        if self.viscous is None:
            return total
        branch = _per_fibre(self._straightened(stretch) * jnp.exp(-state))
        return total + self.mu_f * self.viscous.beta * jnp.sum(weight * self._over_waviness(branch), axis=-1)

    def initial_state(self, shape: tuple[int, ...]) -> State:
        """Return the log of each fibre's viscous stretch, all 0 (*shape, n directions, n waviness); () without viscosity."""
        if self.viscous is None:
            return ()
        return jnp.zeros((*shape, self.orientation.n_directions, self._waviness()[1].shape[-1]))

    def advance(self, F: Array, state: State, dt: float) -> State:
        """Advance the viscous stretches by dt [s] with backward Euler in their logarithms, stable for any step size."""
        if self.viscous is None:
            return state
        strain = jnp.log(self._straightened(stretches(F, self.orientation)[0]))
        share = _trailing(dt / (3.0 * self.viscous.relaxation), strain.ndim)
        whole = strain - state

        def residual(elastic: Array) -> Array:
            e = elastic[..., 0]
            return (e + share * (jnp.exp(2.0 * e) - jnp.exp(-e)) - whole)[..., None]

        return strain - solve(residual, jax.lax.stop_gradient(whole / (1.0 + 3.0 * share))[..., None])[..., 0]

    def response(self, F: Array, state: State = (), dt: float = 0.0) -> Response:
        """Return stress, tangent and new history; for elastic fibres by the much cheaper :func:`by_moments`."""
        if self.viscous is not None:
            return super().response(F, state, dt)
        return Response(*by_moments(F, self.orientation, self.mu_f, lambda x: self._elastic(jnp.sqrt(x))), state)

    def dissipated(self, F: Array, before: State, after: State, dt: float) -> Array:
        """Return the sum of dt tau^2 / eta over the fibres, with tau at the end of the step."""
        if self.viscous is None:
            return jnp.zeros(F.shape[:-2])
        stretch, weight = stretches(F, self.orientation)
        elastic = self._straightened(stretch) * jnp.exp(-after)
        tau = elastic * elastic - 1.0 / elastic
        lost = jnp.sum(weight * self._over_waviness(tau * tau), axis=-1)
        return dt * self.viscous.beta * self.mu_f / (3.0 * self.viscous.relaxation) * lost

    def _elastic(self, stretch: Array) -> Array:
        """Return the energy of fibres divided by mu_f, integrated over waviness: (..., n) -> (..., n)."""
        if self.waviness is None:
            return _per_fibre(_at_least_one(stretch))
        mass, first, inverse_square = self.waviness.recruited(stretch)
        return 0.5 * (stretch**2 * inverse_square + 2.0 * first / stretch - 3.0 * mass)

    def _straightened(self, stretch: Array) -> Array:
        """Return the stretch beyond straightening of fibres of each waviness, at least 1: (..., n) -> (..., n, n_w)."""
        at, _ = self._waviness()
        return _at_least_one(stretch[..., None] / at[..., None, :])

    def _over_waviness(self, values: Array) -> Array:
        """Integrate values over waviness: (..., n, n_w) -> (..., n)."""
        return jnp.sum(values * self._waviness()[1][..., None, :], axis=-1)

    def _waviness(self) -> tuple[Array, Array]:
        """Return the waviness (..., n_w) of the viscous branches and the quadrature weights."""
        if self.waviness is None or self.viscous is None:
            return jnp.ones(1), jnp.ones(1)
        return self.waviness.points(self.viscous.n_waviness)


def stretches(F: Array, orientation: Orientation) -> tuple[Array, Array]:
    """Return the fibre stretch in every direction and the weights of the directions: F (..., 3, 3) -> (..., n) [1], (..., n)."""
    squared, _, weight = squared_stretches(F, orientation)
    return jnp.sqrt(squared), weight


def squared_stretches(F: Array, orientation: Orientation) -> tuple[Array, Array, Array]:
    """Return V . C V of the fibres (..., n) [1], their directions V (..., n, 3) and weights (..., n) at F (..., 3, 3)."""
    V, weight = orientation.directions()
    C = right_cauchy_green(F)[..., None, :, :]
    squared = sum(C[..., i, i] * V[..., i] ** 2 for i in range(3))
    squared += sum(2.0 * C[..., i, j] * V[..., i] * V[..., j] for i, j in ((0, 1), (0, 2), (1, 2)))
    return squared, V, weight  # pyright: ignore[reportReturnType]


def by_moments(
    F: Array, orientation: Orientation, stiffness: float | Array, energy: Callable[[Array], Array]
) -> tuple[Array, Array]:
    r"""Return P and dP/dF of fibres with additive energies, from moments of their directions.

    .. math:: S = 2 \sum w_k \psi'(\lambda_k^2) \, V_k \otimes V_k, \qquad
        \partial S / \partial E = 4 \sum w_k \psi''(\lambda_k^2) \, V_k \otimes V_k \otimes V_k \otimes V_k

    JAX differentiates the energy psi of a fibre; ``EnergyMaterial.response`` gives the same result at a higher cost.

    Parameters
    ----------
    F : (..., 3, 3) [1]
    orientation : Orientation
    stiffness : float or (...) array [kPa]
        Factor of the energy.
    energy : function, elementwise
        Energy psi as a function of the squared stretch (..., n) -> (..., n) [1].
    """
    squared, V, weight = squared_stretches(F, orientation)
    slope = jax.grad(lambda x: jnp.sum(energy(x)))
    first, second = jax.jvp(slope, (squared,), (jnp.ones_like(squared),))
    share = _trailing(stiffness, squared.ndim) * weight
    return tangent_of(F, _moment(2.0 * share * first, V, 2), _moment(4.0 * share * second, V, 4))


def quadrature_error(law: FibreDistribution, F: Array) -> float:
    """Return the largest quadrature error of the stress at F (..., 3, 3), relative to the largest stress.

    The error of the sums over directions and waviness is measured with the initial history, by comparison with four times as
    many directions per turn and four times as many waviness points.
    """
    reference, found = _initial_stress(_finer(law, 4), F), _initial_stress(law, F)
    return float(jnp.abs(found - reference).max() / jnp.maximum(jnp.abs(reference).max(), 1e-300))


def fibres_within(law: Law) -> list[FibreDistribution]:
    """Return all fibre distributions among the parts of a law."""
    parts = jax.tree.leaves(law, is_leaf=lambda part: isinstance(part, FibreDistribution))
    return [part for part in parts if isinstance(part, FibreDistribution)]


def exact_to(law: FibreDistribution, tolerance: float, F: Array) -> FibreDistribution:
    """Return the law with as many directions and waviness points as :func:`quadrature_error` at F needs to meet a tolerance.

    Raises
    ------
    InputError
        If the maximum numbers of directions and points are not sufficient.
    """
    while quadrature_error(law, F) > tolerance:
        law = _finer(law, 2)
    return law


@jax.jit
def _initial_stress(law: FibreDistribution, F: Array) -> Array:
    return law.stress(F, law.initial_state(F.shape[:-2]))


def _finer(law: FibreDistribution, factor: int) -> FibreDistribution:
    viscous = law.viscous and dataclasses.replace(law.viscous, n_waviness=factor * law.viscous.n_waviness)
    return dataclasses.replace(law, orientation=law.orientation.finer(factor), viscous=viscous)


def _moment(values: Array, V: Array, order: int) -> Array:
    """Sum values (..., n) times V x V (order 2) or V x V x V x V (order 4): V (..., n, 3) -> (..., 3, 3) or (..., 3, 3, 3, 3)."""
    monomials = jnp.stack([jnp.prod(V[..., list(name)], axis=-1) for name in MONOMIALS[order]], axis=-1)
    is_shared = V.ndim == 2
    sums = values @ monomials if is_shared else jnp.sum(values[..., None] * monomials, axis=-2)
    return sums[..., PLACES[order]]


def _per_fibre(stretch: Array) -> Array:
    """Return the energy of a straight fibre divided by mu_f, from its stretch: (...) -> (...) [1]."""
    return 0.5 * (stretch**2 + 2.0 / stretch - 3.0)


def _at_least_one(stretch: Array) -> Array:
    """Raise stretches below 1 to 1, as slack fibres carry no compression; at exactly 1 the derivative is 1."""
    return jnp.where(stretch >= 1.0, stretch, 1.0)


def _trailing(value: float | Array, ndim: int) -> Array:
    """Append axes to one value per point, so that it broadcasts against arrays with ``ndim`` axes."""
    value = jnp.asarray(value, float)
    return value.reshape(*value.shape, *[1] * (ndim - value.ndim)) if value.ndim else value
