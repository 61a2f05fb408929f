"""Bodies between rigid plates: a block against its closed form, a sphere against Hertz, complementarity."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import skfem

from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.geometry.tetrahedra import oriented, with_middles
from cicatrix.materials.neo_hookean import NeoHookean, moduli_from_young
from cicatrix.mechanics.body import Body, Frame
from cicatrix.mechanics.contact import Contact, Plate
from cicatrix.mechanics.space import SolidSpace

E, NU = 3.0, 0.49  # kPa
MU, KAPPA = moduli_from_young(E, NU)
NONE = np.zeros(3)


def body_on_planes(points, tetrahedra, axes, density=1e-12, nu=NU):
    """A body of quadratic tetrahedra that slides on the coordinate planes through 0 across these axes."""
    space = SolidSpace(*with_middles(points, oriented(points, tetrahedra)))
    held = [(np.flatnonzero(np.abs(space.positions[:, i]) < 1e-9), np.eye(3)[i]) for i in axes]
    nodes = np.concatenate([n for n, _ in held])
    normals = np.concatenate([np.tile(normal, (len(n), 1)) for n, normal in held])
    return Body(
        Frame(space, np.zeros(0, int), np.zeros(0, int), nodes, normals),
        NeoHookean(*moduli_from_young(E, nu)),
        np.full((space.n_elements, space.table.weight.size), density),
        np.ones(space.n_elements),
        NeoHookean(1.0, 1.0),
        np.zeros(0),
    )


def block(n=2):
    """10 x 10 x 10 mm."""
    mesh = skfem.MeshTet.init_tensor(*3 * [np.linspace(0.0, 10.0, n + 1)])
    return mesh.p.T, mesh.t.T


def eighth_of_a_ball(radius, n):
    ball = skfem.MeshTet.init_ball(n)
    inside = (ball.p[:, ball.t].mean(axis=1) > 0).all(axis=0)
    used, numbers = np.unique(ball.t.T[inside], return_inverse=True)
    return radius * ball.p.T[used], numbers.reshape(-1, 4)


def uniaxial(stretch):
    """Stretch across and force per area along [kPa] of a bar that is free across."""
    law = NeoHookean(MU, KAPPA)

    def stress(across):
        P = law.response(jnp.diag(jnp.array([across, stretch, across]))).P
        return float(P[0, 0]), float(P[1, 1])

    across = scipy.optimize.brentq(lambda a: stress(a)[0], 0.8, 1.5, xtol=1e-14)
    return across, stress(across)[1]


def complementary(pressed, plates, body):
    """Nothing is in a plate, no plate pulls, and no plate pushes from afar."""
    gaps = np.stack([plate.at(1.0).gap(pressed.x) for plate in plates])
    assert gaps.min() > -1e-7
    assert pressed.push.min() > -1e-5 * pressed.push.max()
    assert np.abs(gaps[pressed.push != 0]).max() < 1e-7
    assert body.inside_out(body.frame.space.positions, pressed.x).size == 0


def test_a_block_between_two_plates_is_a_bar_in_compression():
    """30 % from both sides together, in one direction the plates' own; the closed form is a scalar equation."""
    body = body_on_planes(*block(), axes=(0, 2))
    X = body.frame.space.positions
    up = np.array([0.0, 1.0, 0.0])
    plates = [Plate(0.0 * up, up, 1.0 * up), Plate(10.0 * up, -up, -2.0 * up)]
    pressed = Contact().pressed(body, X, NONE, plates)
    complementary(pressed, plates, body)
    across, stress = uniaxial(0.7)
    np.testing.assert_allclose(pressed.x, X * [across, 0.7, across] + [0.0, 1.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(pressed.push.sum(axis=1), [-stress * 100.0] * 2, rtol=1e-7)


def test_a_plate_that_is_never_reached_does_nothing():
    body = body_on_planes(*block(), axes=(0, 1, 2))
    X = body.frame.space.positions
    up = np.array([0.0, 1.0, 0.0])
    pressed = Contact().pressed(body, X, NONE, [Plate(12.0 * up, -up, -1.0 * up)])
    np.testing.assert_allclose(pressed.x, X, atol=1e-9)
    assert not pressed.push.any()


def test_a_block_at_rest_on_a_plate_is_pushed_by_its_weight_and_lifts_where_it_is_let_go():
    """On an edge of the plate: a plate below that leans by 0.1 rad and gravity straight down onto it."""
    body = body_on_planes(*block(3), axes=(0, 2), density=1e-6)
    X = body.frame.space.positions
    up = np.array([0.0, 1.0, 0.0])
    pressed = Contact().pressed(body, X, -9810.0 * up, [Plate(1e-3 * up, up, NONE)])
    np.testing.assert_allclose(pressed.push.sum(), 1000.0 * 1e-6 * 9810.0, rtol=1e-6)
    complementary(pressed, [Plate(1e-3 * up, up, NONE)], body)


def test_a_ball_is_pushed_as_hertz_says():
    """Radius 10 mm, nu 0.3, against a plate: 4/3 E / (1 - nu^2) sqrt(R) d^1.5, a quarter of it by symmetry.

    The mesh is coarse (13 nodes touch); 6 % are measured.
    """
    depth = 1.0
    body = body_on_planes(*eighth_of_a_ball(10.0, 3), axes=(0, 1, 2), nu=0.3)
    up = np.array([0.0, 0.0, 1.0])
    plates = [Plate(10.0 * up, -up, -depth * up)]
    pressed = Contact().pressed(body, body.frame.space.positions, NONE, plates)
    complementary(pressed, plates, body)
    hertz = 4 / 3 * E / (1 - 0.3**2) * np.sqrt(10.0) * depth**1.5 / 4
    assert abs(pressed.push.sum() / hertz - 1) < 0.1


def test_a_start_nearby_leads_to_the_same_shape():
    """From a plate that stands 0.2 mm higher, at once."""
    body = body_on_planes(*eighth_of_a_ball(10.0, 2), axes=(0, 1, 2))
    X, up = body.frame.space.positions, np.array([0.0, 0.0, 1.0])
    far, near = (Contact().pressed(body, X, NONE, [Plate(10.0 * up, -up, -d * up)]) for d in (2.0, 1.8))
    again = Contact().pressed(body, X, NONE, [Plate(10.0 * up, -up, -2.0 * up)], near.x)
    np.testing.assert_allclose(again.x, far.x, atol=1e-5)
    assert again.report.iterations < far.report.iterations


def test_what_it_cannot_do_is_said():
    body = body_on_planes(*block(1), axes=(0, 1, 2))
    X = body.frame.space.positions
    up = np.array([0.0, 1.0, 0.0])
    with pytest.raises(ConvergenceError, match="load factor"):
        Contact().pressed(body, X, NONE, [Plate(10.0 * up, -up, -10.5 * up)])
    with pytest.raises(InputError, match="no pressure"):
        Contact().pressed(replace(body, pressure=np.zeros(0)), X, NONE, [])
