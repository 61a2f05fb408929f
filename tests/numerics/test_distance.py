"""Smooth distances: a spline through values on a grid, its derivatives and its continuation."""

import jax
import numpy as np
import pytest

from cicatrix.geometry.distance import GridDistance, PlaneDistance, SphereDistance

ORIGIN, SPACING = np.array([-20.0, 3.0, 5.0]), np.array([3.0, 2.5, 2.0])


def grid(n_axes, extent=(72.0, 60.0, 60.0)):
    """Return grid points (..., n_axes) [mm], stored with x last."""
    lines = [ORIGIN[a] + np.arange(0.0, extent[a], SPACING[a]) for a in range(n_axes)]
    return np.stack(np.meshgrid(*lines[::-1], indexing="ij")[::-1], axis=-1)


def inner(n_axes, n=200):
    return ORIGIN[:n_axes] + np.random.default_rng(1).uniform(26.0, 34.0, (n, n_axes))


@pytest.mark.parametrize("n_axes", [2, 3])
def test_a_sphere_through_a_grid(n_axes):
    """Value, gradient and second derivatives of the spline are those of the distance to a sphere of 60 mm (closed form)."""
    sphere = SphereDistance(np.array([5.0, 75.0, 10.0]), 60.0, n_axes)
    points = np.pad(grid(n_axes), [(0, 0)] * n_axes + [(0, 3 - n_axes)])
    spline = GridDistance.through(np.asarray(sphere.at(points)), ORIGIN[:n_axes], SPACING[:n_axes])
    x = inner(n_axes)
    exact = np.pad(x, ((0, 0), (0, 3 - n_axes)))
    np.testing.assert_allclose(spline.at(x), sphere.at(exact), atol=2e-5)
    gradient = np.asarray(jax.jit(jax.vmap(jax.grad(spline.at)))(x))
    np.testing.assert_allclose(gradient, jax.vmap(jax.grad(sphere.at))(exact)[:, :n_axes], atol=2e-5)
    bent = np.asarray(jax.jit(jax.vmap(jax.hessian(spline.at)))(x))
    np.testing.assert_allclose(bent, jax.jit(jax.vmap(jax.hessian(sphere.at)))(exact)[:, :n_axes, :n_axes], atol=2e-4)


def test_a_plane_goes_on_beyond_its_grid():
    """A linear field is exact everywhere, also far outside of the grid."""
    plane = PlaneDistance(np.array([1.0, 2.0, 3.0]), np.array([0.6, 0.0, 0.8]))
    spline = GridDistance.through(np.asarray(plane.at(grid(3))), ORIGIN, SPACING)
    x = inner(3) + np.random.default_rng(2).uniform(-100.0, 100.0, (200, 3))
    np.testing.assert_allclose(spline.at(x), plane.at(x), atol=1e-5)


def test_the_continuation_has_no_kink():
    values = np.random.default_rng(3).standard_normal((8, 9, 10))
    spline = GridDistance.through(values, np.zeros(3), np.ones(3))
    edge = np.array([9.0, 3.3, 4.4])
    slope = jax.grad(spline.at)
    step = np.array([1e-7, 0.0, 0.0])
    np.testing.assert_allclose(slope(edge - step)[0], slope(edge + step)[0], atol=1e-5)
    assert float(spline.at(np.array([3.0, 2.0, 5.0]))) == pytest.approx(values[5, 2, 3], abs=1e-9)
