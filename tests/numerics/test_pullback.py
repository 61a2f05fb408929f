"""Tangents pulled back to the shape of the mesh, compared with what objectivity requires."""

import numpy as np
import pytest
import skfem

from cicatrix.geometry.tetrahedra import oriented, used_only
from cicatrix.mechanics.equilibrium import Equilibrium
from cicatrix.mechanics.pullback import Pullback, nodal_deformation
from cicatrix.mechanics.solids import solid_body
from cicatrix.numerics.linear import conjugate_gradients

TURN = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])  # by 107 degrees
SIDEWAYS = np.array([0.0, -9810.0, 0.0])


@pytest.fixture(scope="module")
def body():
    """Return half a ball of 50 mm of soft and stiff tissue, fixed at its flat side."""
    ball = skfem.MeshTet.init_ball(2)
    upper = ball.t.T[ball.p[2][ball.t].mean(axis=0) > 0]
    points, tetrahedra = used_only(50.0 * ball.p.T, upper)
    same = np.ones(len(tetrahedra))
    E = np.where(points[tetrahedra].mean(axis=1)[:, 0] > 0, 6.0, 1.0)
    held = np.abs(points[:, 2]) < 1e-9
    return solid_body(points, oriented(points, tetrahedra), held, E, 0.49 * same, 1e-6 * same)


def tangent(body, X, x):
    matrix, _ = body.linearised(X, x, body.volume_ratio(X, x), in_plane=False)
    return matrix


def test_turned_bodies_have_one_tangent(body):
    """K(R X) = R K(X) R^T for every rotation R (objectivity), and the pull-back undoes this."""
    X, nodes = body.discretization.space.positions, body.discretization.free_nodes
    x = X @ TURN.T
    rest, turned = tangent(body, X, X), tangent(body, X, x)
    assert np.abs(turned.data - rest.data).max() > 0.1 * np.abs(rest.data).max()
    pulled = Pullback.loaded(body, x).matrix(turned, nodes)
    np.testing.assert_allclose(pulled.data, rest.data, rtol=0, atol=1e-10 * np.abs(rest.data).max())


def test_moving_the_unloaded_shape_of_a_turned_body_is_moving_the_loaded_one_back(body):
    """Without load and stress the derivative by X is that by x times -F (theory), so both have the same pulled-back tangent."""
    X, nodes, none = body.discretization.space.positions, body.discretization.free_nodes, np.zeros(3)
    x = X @ TURN.T
    matrix, _ = body.linearised_reference(X, x, body.volume_ratio(X, x), none, in_plane=False)
    pulled = Pullback.unloaded(body, X, x).matrix(matrix, nodes)
    rest = tangent(body, X, X)
    np.testing.assert_allclose(pulled.data, rest.data, rtol=0, atol=1e-10 * np.abs(rest.data).max())


def test_deformation_about_nodes_is_that_of_a_homogeneous_one(body):
    X = body.discretization.space.positions
    F = np.array([[1.2, 0.3, 0.0], [0.0, 0.9, -0.2], [0.1, 0.0, 1.0]])
    np.testing.assert_allclose(nodal_deformation(body, X, X @ F.T), np.broadcast_to(F, (len(X), 3, 3)), atol=1e-12)
    flat = X * np.array([1.0, 1.0, 0.1])  # a useless shape
    np.testing.assert_array_equal(nodal_deformation(body, X, flat), np.broadcast_to(np.eye(3), (len(X), 3, 3)))


def test_a_factor_at_rest_serves_a_body_that_hangs(body):
    """A body that hangs by more than 8 mm needs at most a third of the iterations that the unmodified tangent takes."""
    X, nodes = body.discretization.space.positions, body.discretization.free_nodes
    x, _ = Equilibrium(1e-6).loaded(body, X, 1.5 * SIDEWAYS)
    assert np.abs(x - X).max() > 8.0
    rest, rhs = np.linalg.inv(tangent(body, X, X).toarray()), np.random.default_rng(0).standard_normal(3 * len(nodes))

    def steps(matrix):
        return conjugate_gradients(matrix, rhs, lambda r: rest @ r, 1e-6, 500)[1]

    pulled = Pullback.loaded(body, x).matrix(tangent(body, X, x), nodes)
    assert steps(pulled) < 0.34 * steps(tangent(body, X, x))
