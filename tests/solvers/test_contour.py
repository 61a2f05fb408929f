"""Localized contours against known shapes, where one global pair of means fails."""

import numpy as np
import pytest

from cicatrix.image.contour import ball, band_sites, evolve, heaviside, local_means, signed_distance


def scene(dimension: int, n: int, radius: float, seed: int):
    """A ball 0.5 brighter than a ramp that runs over 3, with noise."""
    grid = np.indices((n,) * dimension) - (n - 1) / 2
    inside = np.sqrt((grid**2).sum(axis=0)) < radius
    noise = np.random.default_rng(seed).normal(0, 0.05, inside.shape)
    return 0.5 * inside + 3.0 * grid[-1] / n + noise, inside


def dice(a, b):
    return 2 * (a & b).sum() / (a.sum() + b.sum())


@pytest.mark.parametrize("force", ["uniform", "separation"])
@pytest.mark.parametrize(("dimension", "n", "radius", "excess"), [(2, 80, 22, 3), (3, 26, 8, 2)])
def test_finds_a_ball_on_a_ramp_where_a_global_threshold_fails(force, dimension, n, radius, excess):
    image, truth = scene(dimension, n, radius, seed=31)
    best_global = max(dice(image > t, truth) for t in np.linspace(-2, 2, 41))
    start = signed_distance(truth) < excess  # voxels too large
    found = evolve(image, start, radius=5 if dimension == 2 else 4, force=force, n_iterations=120)
    assert best_global < 0.75
    assert dice(found.inside, truth) > 0.94


def test_ball_means_on_the_band_equal_those_of_the_whole_grid():
    image, truth = scene(2, 40, 10, seed=5)
    phi, offsets = signed_distance(truth), ball(4, 2)
    h = heaviside(-phi, 1.5)
    pad = [np.pad(a, 4, mode="edge") for a in (h * image, h)]
    total = [sum(a[4 + i : 44 + i, 4 + j : 44 + j] for i, j in offsets) for a in pad]
    sites = band_sites(phi, 1.5)
    u = local_means(image, phi, sites, offsets, 1.5)[0]
    np.testing.assert_allclose(u, (total[0] / np.maximum(total[1], 1e-6))[tuple(sites.T)], rtol=1e-10)


def test_curvature_flow_shrinks_a_circle_at_its_rate():
    """DR/dt = -lambda/R, so the area falls by 2 pi lambda per unit time, whatever the radius."""
    _, inside = scene(2, 72, 24, seed=1)
    steps, weight, dt = 300, 1.0, 0.2  # the step is below the limit of 0.25 for explicit curvature flow
    found = evolve(
        np.zeros(inside.shape), inside, radius=2, curvature=weight, n_iterations=steps, step=dt, tolerance=0.0
    )
    lost = heaviside(-signed_distance(inside), 1.0).sum() - heaviside(-found.phi, 1.0).sum()
    assert lost == pytest.approx(2 * np.pi * weight * dt * steps, rel=0.15)
