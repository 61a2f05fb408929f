r"""Homogeneous deformation of one material point under prescribed stretches and stresses, without a mesh.

.. math:: F = \begin{pmatrix} \lambda_x & \gamma & 0 \\ 0 & \lambda_y & 0 \\ 0 & 0 & \lambda_z \end{pmatrix}, \qquad
          \sigma = J^{-1} P_{law} F^T - p I

The unknowns are :math:`u = (\lambda_x, \lambda_y, \lambda_z, p)`. The four equations prescribe a stretch or a Cauchy stress for
each axis, and :math:`\det F = \det F_g` if the tissue is incompressible (growth adds volume) or :math:`p = 0` if not.
The law's history is updated within these equations, so growth and viscous flow are implicit too.

Derivatives of a whole history with respect to the law's parameters follow from the implicit function theorem: JAX differentiates
one more Newton step from the converged unknowns, with unknowns and Jacobian held constant. Only first derivatives of the law
are needed.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from ..materials.material import Material, State
from ..numerics.small import solve
from ..numerics.tensors import det

TOLERANCE = 1e-9  # Newton step in the stretches that ends the iteration; one more step follows, which squares the error
MAX_ITERATIONS = 40
MIN_STEP_FRACTION = 1e-3  # smallest fraction of a Newton step that is tried
MAX_STRETCH_REDUCTION = 0.7  # largest fraction by which one Newton step may reduce a stretch


class Control(NamedTuple):
    """Type of boundary condition on each axis, and whether volume is constrained."""

    by_stress: Array
    """True for axes x, y, z with prescribed Cauchy stress, False for prescribed stretch (3,) bool."""
    incompressible: Array
    """True to impose J = det F_g () bool."""


class Instant(NamedTuple):
    """Prescribed stretches, stresses and shear at an instant; with a leading axis (n, ...) at a sequence of n instants."""

    time: Array
    """Time () [s]."""
    value: Array
    """Stretch [1] or Cauchy stress [kPa] along x, y, z (3,)."""
    shear: Array
    """Shear F_xy () [1]."""


class Point(NamedTuple):
    """State of a material point at an instant; with a leading axis (n, ...) at a sequence of n instants."""

    time: Array
    """Time () [s]."""
    unknowns: Array
    """lambda_x, lambda_y, lambda_z [1] and the pressure p [kPa] that enforces incompressibility (4,)."""
    shear: Array
    """Shear F_xy () [1]."""
    state: State
    """History variables of the law, leading shape ()."""
    stress: Array
    """Cauchy stress (3, 3) [kPa]."""
    energy: Array
    """Strain energy per reference volume () [kPa]."""
    dissipation: Array
    """Dissipated energy per reference volume since the start () [kPa]."""
    growth: Array
    """Growth tensor F_g (3, 3) [1]."""
    converged: Array
    """True if Newton's method converged () bool; otherwise no other value may be used."""

    @property
    def stretch(self) -> Array:
        """Stretches lambda_x, lambda_y, lambda_z (..., 3) [1]."""
        return self.unknowns[..., :3]


def control(x: str = "stretch", y: str = "stretch", z: str = "stress", incompressible: bool = True) -> Control:
    """Return the boundary conditions of a point: "stretch" or "stress" prescribed along each axis, and incompressibility.

    By default stretches are prescribed along x and y, and the stress along z, the thickness of a sheet.
    """
    return Control(jnp.array([axis == "stress" for axis in (x, y, z)]), jnp.array(incompressible))


def initial_state(law: Material, start: Instant) -> Point:
    """Return the initial state of a point: stress-free volume, initial history, no dissipation."""
    state = law.initial_state(())
    growth = law.growth_tensor(state) + jnp.zeros((3, 3))
    length = jnp.cbrt(law.volume_at_rest(state))
    unknowns = jnp.append(length * jnp.ones(3), 0.0)
    zero = jnp.zeros(())
    yes = jnp.array(True)
    return Point(start.time + zero, unknowns, zero, state, jnp.zeros((3, 3)), zero, zero, growth, yes)


def deformation(unknowns: Array, shear: Array) -> Array:
    """Return the deformation gradient F (3, 3) with diagonal ``unknowns[:3]`` (the stretches) and F_xy = ``shear`` () [1]."""
    return jnp.diag(unknowns[:3]).at[0, 1].set(shear)


def step(law: Material, control: Control, before: Point, asked: Instant) -> Point:
    """Return the state of a point at the instant ``asked``, one time step after the state ``before``.

    The law's history is updated implicitly, and the result is once differentiable in all arguments. The caller should compile
    this function with ``jax.jit``. On failure, ``converged`` of the result is False.
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


def history(law: Material, control: Control, instants: Instant) -> Point:
    """Compute the states of a point at a sequence of instants, one implicit time step each, from its initial state.

    Parameters
    ----------
    law : Material
        Material law, with numbers as parameters (under ``jax.vmap``: arrays with one number per point).
    instants : Instant
        Prescribed values, stacked (n, ...); the first instant is a step of zero duration.

    Returns
    -------
    Point
        States, stacked (n, ...), differentiable by ``jax.grad`` with respect to the law's parameters. Where ``converged`` is
        False, use :func:`.point_integration.integrate`, which takes smaller steps.
    """

    def advance(before: Point, asked: Instant) -> tuple[Point, Point]:
        after = step(law, control, before, asked)
        return after, after

    first = jax.tree.map(lambda column: column[0], instants)
    return jax.lax.scan(advance, initial_state(law, first), instants)[1]


def _cauchy(law: Material, F: Array, state: State) -> Array:
    """Return the Cauchy stress of the law, without the pressure p, at F and a fixed history: (3, 3) -> (3, 3) [kPa]."""
    return law.stress(F, state) @ F.T / det(F)


def _conditions(law: Material, control: Control, before: Point, asked: Instant, u: Array) -> Array:
    """Return the residual (4,) of the equations at unknowns u (4,), for a step from ``before`` to ``asked``.

    Its entries are the errors of the prescribed stretch [1] or Cauchy stress [kPa] along x, y and z, then that of the volume [1]
    or of the pressure [kPa].
    """
    F = deformation(u, asked.shear)
    P, state = law.end_of_step(F, before.state, asked.time - before.time)
    stress = jnp.diagonal(P @ F.T / det(F)) - u[3]
    axes = jnp.where(control.by_stress, stress, u[:3]) - asked.value
    volume = det(F) / det(law.growth_tensor(state)) - 1.0
    return jnp.append(axes, jnp.where(control.incompressible, volume, u[3]))


class _Search(NamedTuple):
    """Iterate of Newton's method: unknowns u, Jacobian J, step du and its length; the next trial is u + share * du."""

    u: Array
    J: Array
    du: Array
    length: Array
    share: Array
    accepted: Array
    iterations: Array


def _newton(law: Material, control: Control, before: Point, asked: Instant, start: Array):
    """Solve the equations of a step by Newton's method from unknowns ``start`` (4,), without derivatives.

    Return the solution u (4,), the Jacobian of the residual (4, 4), and whether the iteration converged.

    A step is halved until the next step, computed with the same Jacobian, is shorter: the natural monotonicity test (P.
    Deuflhard, Newton Methods for Nonlinear Problems, section 3.3), which does not depend on units.
    """

    def linearised(u: Array) -> tuple[Array, Array]:
        r, along = jax.linearize(lambda v: _conditions(law, control, before, asked, v), u)
        return r, jax.vmap(along, out_axes=-1)(jnp.eye(4))

    def goes_on(s: _Search) -> Array:
        return ~(s.accepted & (s.length <= TOLERANCE)) & (s.iterations < MAX_ITERATIONS) & (s.share > MIN_STEP_FRACTION)

    def further(s: _Search) -> _Search:
        trial = s.u + s.share * s.du
        r, J = linearised(trial)
        descends = _length(control, s.J, solve(s.J, -r)) <= (1.0 - 0.25 * s.share) * s.length  # False for NaN
        du = solve(J, -r)
        bold = jnp.minimum(1.0, MAX_STRETCH_REDUCTION / jnp.max(-du[:3] / trial[:3], initial=1e-300))
        fresh = _Search(
            trial, J, du, _length(control, J, du), jnp.minimum(2.0 * s.share, bold), descends, s.iterations + 1
        )
        shorter = s._replace(share=0.5 * s.share, accepted=descends, iterations=s.iterations + 1)
        return jax.tree.map(lambda new, old: jnp.where(descends, new, old), fresh, shorter)

    none = _Search(start, jnp.eye(4), jnp.zeros(4), jnp.array(jnp.inf), jnp.ones(()), jnp.array(False), jnp.array(0))
    s = jax.lax.while_loop(goes_on, further, none)
    return s.u, s.J, s.accepted & (s.length <= TOLERANCE)


def _length(control: Control, J: Array, du: Array) -> Array:
    """Return the length of a Newton step du (4,) [1], with its pressure divided by the largest stiffness in the Jacobian J."""
    stiffness = jnp.max(jnp.where(control.by_stress[:, None], jnp.abs(J[:3, :3]), 0.0))
    p = du[3] / jnp.where(stiffness > 0.0, stiffness, 1.0)
    return jnp.sqrt(jnp.sum(du[:3] ** 2) + p**2)
