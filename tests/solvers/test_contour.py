"""Localized contours on known shapes, where one global pair of means fails."""

import numpy as np
import pytest

from cicatrix.image.contour import ball, evolve, heaviside, local_means, signed_distance


def scene(dimension: int, n: int, radius: float, seed: int):
    """Return a ball that is 0.5 brighter than a ramp with a rise of 3, with noise."""
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
    found = evolve(image, start, radius=5 if dimension == 2 else 4, force=force, n_iterations=300)
    assert best_global < 0.75
    assert dice(found.inside, truth) > 0.94
    assert found.converged


def test_ball_means_on_the_band_equal_those_of_the_whole_grid():
    image, truth = scene(2, 40, 10, seed=5)
    phi, offsets = signed_distance(truth), ball(4, 2)
    h = heaviside(-phi, 1.5)
    pad = [np.pad(a, 4, mode="edge") for a in (h * image, h)]
    total = [sum(a[4 + i : 44 + i, 4 + j : 44 + j] for i, j in offsets) for a in pad]
    padded = [np.pad(a, 4, mode="edge") for a in (image, h)]
    inner = np.pad(np.ones(phi.shape, bool), 4)
    sites = np.flatnonzero(inner & np.pad(np.abs(phi) <= 1.5, 4))
    steps = offsets @ [padded[0].shape[1], 1]
    u = local_means(padded[0].ravel(), padded[1].ravel(), sites, steps)[0]
    whole = np.pad(total[0] / np.maximum(total[1], 1e-6), 4)
    np.testing.assert_allclose(u, whole.ravel()[sites], rtol=1e-10)


@pytest.mark.parametrize("step", [0.05, 0.2, 0.45])
def test_curvature_flow_shrinks_a_circle_at_its_rate(step):
    """DR/dt = -lambda/R, so the area falls by 2 pi lambda per unit time, whatever the radius and the step."""
    _, inside = scene(2, 72, 24, seed=1)
    time = 60.0
    found = evolve(
        np.zeros(inside.shape), inside, radius=1, curvature=1.0, n_iterations=int(time / step), step=step, tolerance=0.0
    )
    lost = heaviside(-signed_distance(inside), 1.0).sum() - heaviside(-found.phi, 1.0).sum()
    assert lost == pytest.approx(2 * np.pi * time, rel=0.03)


def test_curvature_flow_shrinks_a_sphere_at_its_rate():
    """DR/dt = -2 lambda/R with the sum of the principal curvatures."""
    _, inside = scene(3, 40, 14, seed=1)
    found = evolve(np.zeros(inside.shape), inside, radius=1, curvature=1.0, n_iterations=100, step=0.2, tolerance=0.0)
    volumes = [heaviside(-phi, 1.0).sum() for phi in (signed_distance(inside), found.phi)]
    first, last = ((v / (4 / 3 * np.pi)) ** (2 / 3) for v in volumes)
    assert first - last == pytest.approx(4 * 20.0, rel=0.05)


def test_work_grows_with_the_contour_and_not_with_the_grid():
    touched = []
    for n in (60, 180):
        image, truth = scene(2, n, 15, seed=2)
        touched.append(evolve(image, truth, radius=3, n_iterations=20, tolerance=0.0).touched)
    assert touched[1] < 1.1 * touched[0]


def test_sites_left_out_keep_their_side():
    image, truth = scene(2, 60, 15, seed=3)
    start = signed_distance(truth) < 3
    left = np.indices(truth.shape)[1] < 30
    found = evolve(image, start, radius=5, where=left)
    assert (found.inside == start)[~left].mean() > 0.995
    assert dice(found.inside & left, truth & left) > 0.94
