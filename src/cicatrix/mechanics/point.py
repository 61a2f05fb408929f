r"""One homogeneous point: a law under prescribed stretches and stresses, without a mesh.

.. math:: F = \begin{pmatrix} \lambda_x & \gamma & 0 \\ 0 & \lambda_y & 0 \\ 0 & 0 & \lambda_z \end{pmatrix}, \qquad
          \sigma = J^{-1} P_{law} F^T - p I

Unknown are :math:`u = (\lambda_x, \lambda_y, \lambda_z, p)`; the four conditions are a stretch or a Cauchy stress per axis, and
:math:`\det F = \det F_g` where the tissue is incompressible (what has grown is new volume) or :math:`p = 0` where it is not.
The law's history advances inside the conditions, so growth and viscous flow are implicit too.

Derivatives of a whole history with respect to the law's parameters: the converged unknowns are held, and one more Newton step
with the Jacobian held is what JAX sees. It is the implicit function theorem, and asks a law for first derivatives only.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ..materials.material import EnergyMaterial, State
from ..numerics.small import solve
from ..numerics.tensors import det

TOLERANCE = 1e-9  # of a Newton step in the stretches: one more step is done, and squares it
MAX_ITERATIONS = 40
SHORTEST = 1e-3  # share of a Newton step
BOLDEST = 0.7  # share of a stretch that one Newton step may take away


class Control(NamedTuple):
    """What is prescribed."""

    by_stress: Array
    """Whether an axis x, y, z has its Cauchy stress prescribed, else its stretch (3,) bool."""
    incompressible: Array
    """Whether J = det F_g () bool."""


class Instant(NamedTuple):
    """The values prescribed at an instant, or stacked at several (n, ...)."""

    time: Array
    """() [s]."""
    value: Array
    """Stretch [1] or Cauchy stress [kPa] of x, y, z (3,)."""
    shear: Array
    """F_xy () [1]."""


class Point(NamedTuple):
    """Where a point stands, or a history of them (n, ...)."""

    time: Array
    """() [s]."""
    unknowns: Array
    """lambda_x, lambda_y, lambda_z [1] and the pressure p [kPa] that keeps the volume, (4,)."""
    shear: Array
    """F_xy () [1]."""
    state: State
    """History of the law, leading shape ()."""
    stress: Array
    """Cauchy stress (3, 3) [kPa]."""
    energy: Array
    """Strain energy per reference volume () [kPa]."""
    dissipation: Array
    """Work turned into heat since the start () [kPa]."""
    growth: Array
    """F_g (3, 3) [1]."""
    converged: Array
    """Whether Newton's method found it () bool; nothing else is to be used where it did not."""

    @property
    def stretch(self) -> Array:
        """lambda_x, lambda_y, lambda_z (..., 3) [1]."""
        return self.unknowns[..., :3]


def control(x: str = "stretch", y: str = "stretch", z: str = "stress", incompressible: bool = True) -> Control:
    """Say what is prescribed: "stretch" or "stress" per axis; the default leaves the thickness free of stress."""
    return Control(jnp.array([axis == "stress" for axis in (x, y, z)]), jnp.array(incompressible))


def virgin(law: EnergyMaterial, start: Instant) -> Point:
    """The point before its first instant: unstressed volume, no history, no dissipation."""
    state = law.initial_state(())
    growth = law.growth_tensor(state) + jnp.zeros((3, 3))
    length = jnp.cbrt(law.volume_at_rest(state))
    unknowns = jnp.append(length * jnp.ones(3), 0.0)
    zero = jnp.zeros(())
    yes = jnp.array(True)
    return Point(start.time + zero, unknowns, zero, state, jnp.zeros((3, 3)), zero, zero, growth, yes)


def deformation(unknowns: Array, shear: Array) -> Array:
    """F of a point: stretches first in (4,) or (3,), F_xy () -> (3, 3)."""
    return jnp.diag(unknowns[:3]).at[0, 1].set(shear)


def step(law: EnergyMaterial, control: Control, before: Point, asked: Instant) -> Point:
    """Go from a point to the next instant: implicit in the law's history, differentiable in everything once.

    To be compiled by the caller; ``converged`` of what comes back tells of failure.
    """
    start = jnp.where(jnp.append(control.by_stress, True), before.unknowns, jnp.append(asked.value, 0.0))
    found, J, converged = _newton(*jax.lax.stop_gradient((law, control, before, asked, start)))
    unknowns = found - solve(J, _conditions(law, control, before, asked, found))
    F, dt = deformation(unknowns, asked.shear), asked.time - before.time
    state = law.advance(F, before.state, dt)
    heat = before.dissipation + law.dissipated(F, before.state, state, dt)
    stress = _cauchy(law, F, state) - unknowns[3] * jnp.eye(3)
    growth = law.growth_tensor(state) + jnp.zeros((3, 3))
    energy = law.energy(F, state)
    return Point(asked.time, unknowns, asked.shear, state, stress, energy, heat, growth, converged)


def history(law: EnergyMaterial, control: Control, instants: Instant) -> Point:
    """Lead a virgin point through instants.

    Parameters
    ----------
    law : EnergyMaterial
        Parameters are numbers, or arrays of one number per point under ``jax.vmap``.
    instants : Instant
        Stacked (n, ...): the first one is reached without time passing.

    Returns
    -------
    Point
        Stacked (n, ...). ``jax.grad`` goes through it to the parameters of the law; ``converged`` tells of failure, for
        which :func:`.point_walk.walk` has smaller steps.
    """

    def onward(before: Point, asked: Instant) -> tuple[Point, Point]:
        after = step(law, control, before, asked)
        return after, after

    first = jax.tree.map(lambda column: column[0], instants)
    return jax.lax.scan(onward, virgin(law, first), instants)[1]


def _cauchy(law: EnergyMaterial, F: Array, state: State) -> Array:
    """The law's own Cauchy stress at a held history (3, 3) [kPa]."""
    return law.stress(F, state) @ F.T / det(F)


def _conditions(law: EnergyMaterial, control: Control, before: Point, asked: Instant, u: Array) -> Array:
    """What must vanish (4,): per axis stretch [1] or Cauchy stress [kPa], then the volume [1] or the pressure [kPa]."""
    F = deformation(u, asked.shear)
    state = law.advance(F, before.state, asked.time - before.time)
    stress = jnp.diagonal(_cauchy(law, F, state)) - u[3]
    axes = jnp.where(control.by_stress, stress, u[:3]) - asked.value
    volume = det(F) / det(law.growth_tensor(state)) - 1.0
    return jnp.append(axes, jnp.where(control.incompressible, volume, u[3]))


class _Search(NamedTuple):
    """Where Newton's method stands: the next trial is u + share du."""

    u: Array
    J: Array
    du: Array
    length: Array
    share: Array
    accepted: Array
    iterations: Array


def _newton(law: EnergyMaterial, control: Control, before: Point, asked: Instant, start: Array):
    """Solve the conditions: (u (4,), their Jacobian there (4, 4), whether it converged); not to be differentiated.

    A step is shortened until the next one, with the same Jacobian, would be shorter: the natural monotonicity test (P.
    Deuflhard, Newton Methods for Nonlinear Problems, section 3.3), in which units do not matter.
    """

    def linearised(u: Array) -> tuple[Array, Array]:
        r, along = jax.linearize(lambda v: _conditions(law, control, before, asked, v), u)
        return r, jax.vmap(along, out_axes=-1)(jnp.eye(4))

    def goes_on(s: _Search) -> Array:
        return ~(s.accepted & (s.length <= TOLERANCE)) & (s.iterations < MAX_ITERATIONS) & (s.share > SHORTEST)

    def further(s: _Search) -> _Search:
        trial = s.u + s.share * s.du
        r, J = linearised(trial)
        descends = _length(control, s.J, solve(s.J, -r)) <= (1.0 - 0.25 * s.share) * s.length  # false for NaN
        du = solve(J, -r)
        bold = jnp.minimum(1.0, BOLDEST / jnp.max(-du[:3] / trial[:3], initial=1e-300))
        fresh = _Search(
            trial, J, du, _length(control, J, du), jnp.minimum(2.0 * s.share, bold), descends, s.iterations + 1
        )
        shorter = s._replace(share=0.5 * s.share, accepted=descends, iterations=s.iterations + 1)
        return jax.tree.map(lambda new, old: jnp.where(descends, new, old), fresh, shorter)

    none = _Search(start, jnp.eye(4), jnp.zeros(4), jnp.array(jnp.inf), jnp.ones(()), jnp.array(False), jnp.array(0))
    s = jax.lax.while_loop(goes_on, further, none)
    return s.u, s.J, s.accepted & (s.length <= TOLERANCE)


def _length(control: Control, J: Array, du: Array) -> Array:
    """Length of a Newton step [1], the pressure measured by the stiffness against stretch."""
    stiffness = jnp.max(jnp.where(control.by_stress[:, None], jnp.abs(J[:3, :3]), 0.0))
    p = du[3] / jnp.where(stiffness > 0.0, stiffness, 1.0)
    return jnp.sqrt(jnp.sum(du[:3] ** 2) + p**2)
