"""Surfaces of known shape; every expected number is by hand."""

import numpy as np
import pytest

from cicatrix.geometry.bcc import bcc_lattice
from cicatrix.geometry.surface import Surface
from cicatrix.geometry.tetrahedra import boundary
from cicatrix.outcome.surface import compare_surfaces

CUBE = np.array([[x, y, z] for x in (0.0, 10.0) for y in (0.0, 10.0) for z in (0.0, 10.0)])
SIDES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE_TRIANGLES = np.array([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))])


@pytest.fixture(scope="module")
def ball():
    """Return points on a sphere of radius 30 and outward triangles."""
    nodes, tetrahedra = bcc_lattice(np.full(3, -1.0), np.full(3, 1.0), 0.2)
    faces = boundary(tetrahedra)
    used, faces = np.unique(faces, return_inverse=True)
    points = nodes[used]
    return 30.0 * points / np.linalg.norm(points, axis=1, keepdims=True), faces.reshape(-1, 3)


def brute_force(points, surface):
    """Return the smallest distance to a dense sample of the triangles."""
    i, j = np.mgrid[:21, :21]
    keep = i + j <= 20
    w = np.stack([i[keep], j[keep], 20 - i[keep] - j[keep]], axis=-1) / 20
    sample = np.einsum("wc,kci->kwi", w, surface.points[surface.triangles]).reshape(-1, 3)
    return np.array([np.linalg.norm(sample - p, axis=1).min() for p in points])


def test_a_cube():
    cube = Surface(CUBE, CUBE_TRIANGLES)
    assert cube.volume == pytest.approx(1000)
    points = np.array([[5, 5, 5], [5, 5, 1], [5, 5, -2], [13, 14, 5], [-3, -4, -12], [9, 9, 9], [5, 5, 10]], float)
    np.testing.assert_allclose(cube.inward(points), [5, 1, -2, -5, -13, 1, 0], atol=1e-12)
    np.testing.assert_allclose(cube.depth_below_hull(points[:2]), [5, 1], atol=1e-12)
    assert cube.node_areas(np.ones(12, bool)).sum() == pytest.approx(600)


def test_the_nearest_place_is_the_nearest(ball):
    """Compare with a dense sample of the triangles, some of which are ten times larger than others."""
    points, triangles = ball
    surface = Surface(points * np.array([1.0, 0.2, 3.0]), triangles)
    some = np.random.default_rng(0).uniform(-1, 1, (60, 3)) * np.array([40.0, 10.0, 110.0])
    found = np.abs(surface.inward(some))
    dense = brute_force(some, surface)
    assert (found <= dense + 1e-9).all()
    np.testing.assert_allclose(found, dense, atol=0.5)


def test_the_side_is_right(ball):
    """Inside an ellipsoid x^2 / a^2 + ... < 1, for points away from the surface."""
    points, triangles = ball
    axes = np.array([1.0, 0.2, 3.0])
    some = np.random.default_rng(1).uniform(-1, 1, (2000, 3)) * 30.0 * axes * 1.3
    level = np.linalg.norm(some / (30.0 * axes), axis=1)
    clear = abs(level - 1.0) > 0.05
    assert ((Surface(points * axes, triangles).inward(some) > 0) == (level < 1))[clear].all()


def test_a_ball_that_shrinks(ball):
    points, triangles = ball
    change = compare_surfaces(points, points * 28 / 30, triangles, np.ones(len(triangles), bool), 0)
    assert change.surface_retraction_max_mm == pytest.approx(2, rel=0.02)
    assert change.surface_retraction_rms_mm == pytest.approx(2, rel=0.02)
    assert change.volume_change_percent == pytest.approx(100 * (28**3 / 30**3 - 1))
    assert change.nipple_displacement_mm == pytest.approx(2)
    assert change.concavity_depth_mm == pytest.approx(0, abs=1e-9)


def test_a_ball_that_swells_retracts_nowhere(ball):
    points, triangles = ball
    change = compare_surfaces(points, points * 31 / 30, triangles, np.ones(len(triangles), bool), 0)
    assert change.surface_retraction_max_mm == 0
    assert change.surface_retraction_rms_mm == pytest.approx(1, rel=0.02)


def test_a_dimple(ball):
    """The top is pushed in by 4 at its middle: that depth below the hull, and 0 elsewhere."""
    points, triangles = ball
    off = np.degrees(np.arccos(points[:, 2] / 30.0))
    top = int(np.argmin(off))
    after = points * (1 - 4 / 30 * np.exp(-((off / 10.0) ** 2)))[:, None]
    change = compare_surfaces(points, after, triangles, np.ones(len(triangles), bool), top)
    assert change.nipple_displacement_mm == pytest.approx(4, rel=0.01)
    assert change.surface_retraction_max_mm == pytest.approx(4, rel=0.02)
    assert 2.5 < change.concavity_depth_mm < 4


def test_nothing_has_changed(ball):
    points, triangles = ball
    change = compare_surfaces(points, points, triangles, np.ones(len(triangles), bool), 7)
    np.testing.assert_allclose([getattr(change, name) for name in vars(change)], 0.0, atol=1e-9)


def test_only_the_skin_retracts(ball):
    points, triangles = ball
    upper = (points[triangles][..., 2] > 0).all(axis=1)
    after = np.where(points[:, 2:] > 0, points, 0.8 * points)
    change = compare_surfaces(points, after, triangles, upper, 0)
    assert change.surface_retraction_max_mm == pytest.approx(0, abs=1e-9)
