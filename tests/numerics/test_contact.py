"""Bodies between rigid plates: a block in closed form, a sphere compared with Hertz, complementarity."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import skfem

from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.geometry.tetrahedra import oriented, with_middles
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.body import Body, Discretization
from cicatrix.mechanics.contact import Contact, Plate
from cicatrix.mechanics.space import SolidSpace

E, NU = 3.0, 0.49  # kPa
MU, KAPPA = moduli_from_young(E, NU)
NONE = np.zeros(3)


def body_on_planes(points, tetrahedra, axes, density=1e-12, nu=NU):
    """Return a body of quadratic tetrahedra that slides on the coordinate planes through 0 normal to these axes."""
    space = SolidSpace(*with_middles(points, oriented(points, tetrahedra)))
    held = [(np.flatnonzero(np.abs(space.positions[:, i]) < 1e-9), np.eye(3)[i]) for i in axes]
    nodes = np.concatenate([n for n, _ in held])
    normals = np.concatenate([np.tile(normal, (len(n), 1)) for n, normal in held])
    return Body(
        Discretization(space, np.zeros(0, int), np.zeros(0, int), nodes, normals),
        NeoHookean(*moduli_from_young(E, nu)),
        np.full((space.n_elements, space.table.weight.size), density),
        np.ones(space.n_elements),
        NeoHookean(1.0, 1.0),
        np.zeros(0),
    )


def block(n=2):
    """Return a block of 10 x 10 x 10 mm."""
    mesh = skfem.MeshTet.init_tensor(*3 * [np.linspace(0.0, 10.0, n + 1)])
    return mesh.p.T, mesh.t.T


def eighth_of_a_ball(radius, n):
    ball = skfem.MeshTet.init_ball(n)
    inside = (ball.p[:, ball.t].mean(axis=1) > 0).all(axis=0)
    used, numbers = np.unique(ball.t.T[inside], return_inverse=True)
    return radius * ball.p.T[used], numbers.reshape(-1, 4)


def uniaxial(stretch):
    """Return the lateral stretch and the force per area [kPa] of a bar that is free laterally."""
    law = NeoHookean(MU, KAPPA)

    def stress(across):
        P = law.response(jnp.diag(jnp.array([across, stretch, across]))).P
        return float(P[0, 0]), float(P[1, 1])

    across = scipy.optimize.brentq(lambda a: stress(a)[0], 0.8, 1.5, xtol=1e-14)
    return across, stress(across)[1]


def complementary(solution, plates, body):
    """Check that no node is inside a plate, no contact force is tensile, and forces act only at nodes in contact."""
    gaps = np.stack([plate.at(1.0).gap(solution.x) for plate in plates])
    assert gaps.min() > -1e-7
    assert solution.contact_forces.min() > -1e-5 * solution.contact_forces.max()
    assert np.abs(gaps[solution.contact_forces != 0]).max() < 1e-7
    assert body.inverted_elements(body.discretization.space.positions, solution.x).size == 0


def test_a_block_between_two_plates_is_a_bar_in_compression():
    """Plates that move by 1 and 2 mm compress it by 30 % in total; the closed form is a scalar equation."""
    body = body_on_planes(*block(), axes=(0, 2))
    X = body.discretization.space.positions
    up = np.array([0.0, 1.0, 0.0])
    plates = [Plate(0.0 * up, up, 1.0 * up), Plate(10.0 * up, -up, -2.0 * up)]
    solution = Contact().solve(body, X, NONE, plates)
    complementary(solution, plates, body)
    across, stress = uniaxial(0.7)
    np.testing.assert_allclose(solution.x, X * [across, 0.7, across] + [0.0, 1.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(solution.contact_forces.sum(axis=1), [-stress * 100.0] * 2, rtol=1e-7)


def test_a_plate_that_is_never_reached_does_nothing():
    body = body_on_planes(*block(), axes=(0, 1, 2))
    X = body.discretization.space.positions
    up = np.array([0.0, 1.0, 0.0])
    solution = Contact().solve(body, X, NONE, [Plate(12.0 * up, -up, -1.0 * up)])
    np.testing.assert_allclose(solution.x, X, atol=1e-9)
    assert not solution.contact_forces.any()


def test_a_block_at_rest_on_a_plate_is_pushed_by_its_weight_and_lifts_where_it_is_let_go():
    """The contact force of a plate below a block equals the weight of the block."""
    body = body_on_planes(*block(3), axes=(0, 2), density=1e-6)
    X = body.discretization.space.positions
    up = np.array([0.0, 1.0, 0.0])
    solution = Contact().solve(body, X, -9810.0 * up, [Plate(1e-3 * up, up, NONE)])
    np.testing.assert_allclose(solution.contact_forces.sum(), 1000.0 * 1e-6 * 9810.0, rtol=1e-6)
    complementary(solution, [Plate(1e-3 * up, up, NONE)], body)


def test_a_ball_is_pushed_as_hertz_says():
    """Radius 10 mm, nu 0.3, pressed on a plate: 4/3 E / (1 - nu^2) sqrt(R) d^1.5, a quarter of it by symmetry.

    The mesh is coarse (13 nodes in contact); the measured difference is 6 %.
    """
    depth = 1.0
    body = body_on_planes(*eighth_of_a_ball(10.0, 3), axes=(0, 1, 2), nu=0.3)
    up = np.array([0.0, 0.0, 1.0])
    plates = [Plate(10.0 * up, -up, -depth * up)]
    solution = Contact().solve(body, body.discretization.space.positions, NONE, plates)
    complementary(solution, plates, body)
    hertz = 4 / 3 * E / (1 - 0.3**2) * np.sqrt(10.0) * depth**1.5 / 4
    assert abs(solution.contact_forces.sum() / hertz - 1) < 0.1


def test_a_start_nearby_leads_to_the_same_shape():
    """The initial shape is that for a plate 0.2 mm higher; the new plate is applied in one step."""
    body = body_on_planes(*eighth_of_a_ball(10.0, 2), axes=(0, 1, 2))
    X, up = body.discretization.space.positions, np.array([0.0, 0.0, 1.0])
    far, near = (Contact().solve(body, X, NONE, [Plate(10.0 * up, -up, -d * up)]) for d in (2.0, 1.8))
    again = Contact().solve(body, X, NONE, [Plate(10.0 * up, -up, -2.0 * up)], near.x)
    np.testing.assert_allclose(again.x, far.x, atol=1e-5)
    assert again.report.iterations < far.report.iterations


def test_what_it_cannot_do_is_said():
    body = body_on_planes(*block(1), axes=(0, 1, 2))
    X = body.discretization.space.positions
    up = np.array([0.0, 1.0, 0.0])
    with pytest.raises(ConvergenceError, match="load factor"):
        Contact().solve(body, X, NONE, [Plate(10.0 * up, -up, -10.5 * up)])
    with pytest.raises(InputError, match="without pressure"):
        Contact().solve(replace(body, pressure=np.zeros(0)), X, NONE, [])
