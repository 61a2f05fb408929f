"""Transfer between tetrahedra and a lattice: every site in one element, linear fields exact, means preserved."""

import numpy as np
import pytest

from cicatrix.geometry.bcc import bcc_lattice
from cicatrix.geometry.hexgrid import Lattice
from cicatrix.geometry.tetrahedra import boundary, with_middles
from cicatrix.geometry.transfer import EIGHTHS, LOCAL_SOLID, OUTSIDE, linear_fit, locate_lattice
from cicatrix.mechanics.body import measures
from cicatrix.mechanics.space import SolidSpace

PITCH = 0.17
BOX = np.array([[-0.4, -0.5, -0.6], [3.1, 3.2, 2.9]])


@pytest.fixture(scope="module")
def space():
    """Return a block of irregular tetrahedra with edges of about 1 mm."""
    nodes, tetrahedra = bcc_lattice(np.zeros(3), np.full(3, 3.0), 1.0)
    inner = np.setdiff1d(np.arange(len(nodes)), boundary(tetrahedra))
    nodes[inner] += np.random.default_rng(1).uniform(-0.1, 0.1, (len(inner), 3))
    return SolidSpace(*with_middles(nodes, tetrahedra))


@pytest.fixture(scope="module")
def lattice():
    return Lattice.covering(*BOX, PITCH)


@pytest.fixture(scope="module")
def points(lattice):
    return lattice.positions().reshape(-1, 3)


@pytest.fixture(scope="module")
def sites(space, lattice):
    return locate_lattice(space.positions[space.element_nodes], lattice, BOX)


def within(points, low, high):
    return ((points > low) & (points < high)).all(axis=1)


def bounds(space):
    return space.positions.min(axis=0), space.positions.max(axis=0)


def test_eight_pieces_fill_the_tetrahedron():
    """The reference tetrahedron has a volume of 1/6, each of its pieces an eighth of that."""
    corners = LOCAL_SOLID[EIGHTHS]
    sizes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    np.testing.assert_allclose(sizes, 1 / 48, atol=1e-15)


def test_every_site_inside_has_one_element(space, sites, points):
    """Sites are inside the block exactly where their coordinates are, and none lies outside the box."""
    low, high = bounds(space)
    in_box = within(points, *BOX)
    assert (sites.element[in_box & within(points, low + 1e-9, high - 1e-9)] != OUTSIDE).all()
    assert (sites.element[~(in_box & within(points, low - 1e-6, high + 1e-6))] == OUTSIDE).all()
    assert (sites.inside == np.flatnonzero(sites.element != OUTSIDE)).all()
    assert 5_000 < len(sites.inside) < len(points)


def test_local_coordinates_lead_back(space, sites, points):
    corners = space.positions[space.element_nodes[sites.element[sites.inside], :4]]
    weights = np.column_stack([1 - sites.local.sum(axis=1), sites.local])
    np.testing.assert_allclose(np.einsum("na,nai->ni", weights, corners), points[sites.inside], atol=1e-6)
    assert weights.min() > -1e-6


def test_a_linear_field_is_exact(space, sites, points):
    """The field 2 + 3 x - y + z / 2, fitted at quadrature points, is evaluated exactly at sites."""
    at_qp = np.einsum("qa,eai->eqi", space.table.value, space.positions[space.element_nodes])
    field = np.array([3.0, -1.0, 0.5])
    fitted = linear_fit(2 + at_qp @ field, measures(space, space.positions), space.table.points)
    found = sites.evaluate(fitted)
    np.testing.assert_allclose(found[sites.inside], 2 + points[sites.inside] @ field, atol=1e-5)
    assert (np.delete(found, sites.inside) == 0).all()


def test_sites_measure_volume(space, sites, lattice, points):
    """The sites in all elements measure their volume, except for those on the surface."""
    low, high = bounds(space)
    cut = (np.minimum(high, BOX[1]) - np.maximum(low, BOX[0])).prod()
    counts = sites.count(np.ones(lattice.n_sites, bool))
    assert counts.sum() * lattice.site_measure == pytest.approx(cut, rel=0.03)
    whole = (space.positions[space.element_nodes] < BOX[1]).all(axis=(1, 2))
    volumes = measures(space, space.positions).sum(axis=1)
    assert np.std((counts * lattice.site_measure / volumes)[whole]) < 0.2


def test_bent_elements_share_their_faces(space, lattice, points):
    """With the midpoints of inner edges moved, the elements still cover all sites exactly once."""
    X = space.positions.copy()
    middles = np.setdiff1d(space.element_nodes[:, 4:], space.boundary)
    X[middles] += np.random.default_rng(3).uniform(-0.04, 0.04, (len(middles), 3))
    bent = locate_lattice(X[space.element_nodes], lattice, BOX)
    straight = locate_lattice(space.positions[space.element_nodes], lattice, BOX)
    low, high = bounds(space)
    assert (bent.element[within(points, low + 1e-6, high - 1e-6) & within(points, *BOX)] != OUTSIDE).all()
    assert (bent.element != straight.element).any()
    assert abs(len(bent.inside) - len(straight.inside)) < 20


def test_neighbours_share_a_face(space):
    one, other = space.neighbours
    shared = [len(np.intersect1d(space.element_nodes[a, :4], space.element_nodes[b, :4])) for a, b in zip(one, other)]
    assert set(shared) == {3}
    assert 4 * space.n_elements == 2 * len(one) + len(space.boundary)
