"""A plane through tetrahedra: areas and positions by hand."""

import numpy as np
import pytest

from cicatrix.geometry.bcc import bcc_lattice
from cicatrix.geometry.cuts import plane_cut


def areas(polygons):
    """Return the areas of plane quadrangles (k, 4, 3) from their diagonals."""
    diagonals = polygons[:, 2] - polygons[:, 0], polygons[:, 3] - polygons[:, 1]
    return 0.5 * np.linalg.norm(np.cross(*diagonals), axis=1)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_block_is_cut_without_gap_or_overlap(axis):
    nodes, tetrahedra = bcc_lattice(np.zeros(3), np.array([3.0, 4.0, 5.0]), 0.9)
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    middle = 0.5 * (low + high)
    polygons, owner = plane_cut(nodes, tetrahedra, axis, middle[axis] + 0.05)
    np.testing.assert_allclose(polygons[..., axis], middle[axis] + 0.05, atol=1e-12)
    shown = np.delete(high - low, axis).prod()
    ragged = 2 * 0.9 * np.delete(high - low, axis).sum()  # the lattice's own sides are not flat
    assert shown - ragged < areas(polygons).sum() <= shown
    assert len(np.unique(owner)) == len(owner)


def test_one_tetrahedron():
    """The unit corner: a triangle of area (1 - z)^2 / 2 at height z, and a quadrangle between two opposite edges."""
    nodes, one = np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]])
    polygons, _ = plane_cut(nodes, one, 2, 0.4)
    assert areas(polygons) == pytest.approx(0.18)
    turned = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 1, 1]], float)
    polygons, _ = plane_cut(turned, one, 2, 0.5)
    assert areas(polygons) == pytest.approx(0.25)  # a square between the edges along x and along y
    assert len(plane_cut(nodes, one, 2, 1.5)[0]) == 0
