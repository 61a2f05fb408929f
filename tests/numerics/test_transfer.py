"""Transfer between mesh and lattice: every site in one element, linear fields exact, means preserved."""

import numpy as np
import pytest

from cicatrix.geometry.hexgrid import Lattice
from cicatrix.geometry.transfer import OUTSIDE, linear_fit, locate_sites
from cicatrix.mechanics.body import measures
from cicatrix.mechanics.space import Space

SIDE, PITCH = 6.0, 0.05


@pytest.fixture(scope="module")
def space(rectangle):
    return Space(rectangle(SIDE, SIDE, 3, 3))


@pytest.fixture(scope="module")
def lattice():
    return Lattice.covering((-1.0, -1.0), (SIDE + 1, SIDE + 1), PITCH)


@pytest.fixture(scope="module")
def points(lattice):
    return lattice.positions().reshape(-1, 2)


@pytest.fixture(scope="module")
def sites(space, points):
    return locate_sites(space.positions[space.element_nodes[:, :6], :2], points)


def test_every_site_inside_has_one_element(space, sites, points):
    """Sites are inside the square exactly where their coordinates are, and the element agrees with that of the mesh library."""
    inside = ((points > 1e-9) & (points < SIDE - 1e-9)).all(axis=1)
    outside = ((points < -1e-9) | (points > SIDE + 1e-9)).any(axis=1)
    assert (sites.element[inside] != OUTSIDE).all()
    assert (sites.element[outside] == OUTSIDE).all()
    some = np.flatnonzero(inside)[::37]
    finder = space.mesh.element_finder()(*points[some].T)
    assert np.mean(finder == sites.element[some]) > 0.999


def test_local_coordinates_lead_back(space, sites, points):
    corners = space.mesh.p[:, space.mesh.t].transpose(2, 1, 0)
    held = sites.element != OUTSIDE
    c, (xi, eta) = corners[sites.element[held]], sites.local.T[..., None]
    back = (1 - xi - eta) * c[:, 0] + xi * c[:, 1] + eta * c[:, 2]
    np.testing.assert_allclose(back, points[held], atol=1e-12)


def test_sites_measure_area(space, sites, lattice, points):
    """The sites of an element measure its area to within its perimeter; their total is exact."""
    counts = sites.count(np.ones(len(points), bool))
    areas = measures(space, space.positions).sum(axis=1)
    np.testing.assert_allclose(counts * lattice.site_measure, areas, atol=0.5 * PITCH * 8.0)
    assert counts.sum() == np.count_nonzero(sites.element != OUTSIDE)


def test_counting_loses_nothing(sites, points):
    """For any choice of sites, the sum over elements is the number of sites inside."""
    chosen = np.random.default_rng(0).random(len(points)) < 0.3
    assert sites.count(chosen).sum() == np.count_nonzero(chosen & (sites.element != OUTSIDE))


def test_linear_field_is_exact(space, sites, points):
    """The field 2 + 3 x - y, fitted at quadrature points, is evaluated exactly at sites."""
    at_qp = np.einsum("qa,eai->eqi", space.table.value, space.positions[space.element_nodes])
    values = 2 + 3 * at_qp[..., 0] - at_qp[..., 1]
    fitted = linear_fit(values, measures(space, space.positions), space.table.points)
    found = sites.evaluate(fitted)
    held = sites.element != OUTSIDE
    np.testing.assert_allclose(found[held], 2 + 3 * points[held, 0] - points[held, 1], atol=1e-11)
    assert (found[~held] == 0).all()


def test_fit_keeps_the_weighted_mean(space):
    rng = np.random.default_rng(2)
    weights = measures(space, space.positions) * rng.uniform(0.2, 1, (space.n_elements, space.table.weight.size))
    values = rng.standard_normal(weights.shape)
    c = linear_fit(values, weights, space.table.points)
    at_qp = c[:, :1] + c[:, 1:] @ (space.table.points - 1 / 3).T
    np.testing.assert_allclose(np.sum(weights * at_qp, axis=1), np.sum(weights * values, axis=1), atol=1e-12)


def test_there_and_back_keeps_element_means(space, sites, points):
    """Mean of W over the sites of each element, interpolated from the mesh: the error is that of quadrature by sites, O(h).

    A line of sites on a side belongs to either element, depending on round-off: half a pitch along a perimeter of 7 mm, of an
    area of 2 mm^2, times the difference of W there from its mean.
    """
    at_qp = np.einsum("qa,eai->eqi", space.table.value, space.positions[space.element_nodes])
    W = 1 + np.sin(at_qp[..., 0]) * np.cos(at_qp[..., 1] / 2) ** 2
    areas = measures(space, space.positions)
    at_sites = sites.evaluate(linear_fit(W, areas, space.table.points))
    held = sites.element != OUTSIDE
    counts = sites.count(np.ones(len(points), bool))
    back = np.bincount(sites.element[held], at_sites[held], space.n_elements) / counts
    np.testing.assert_allclose(back, np.sum(W * areas, axis=1) / areas.sum(axis=1), atol=0.5 * PITCH * 7.0 / 2.0 * 0.3)


def test_a_bent_edge_is_shared(space, points):
    """Elements with curved edges still cover all sites exactly once: midpoints inside the square are moved."""
    X = space.positions.copy()
    facets = np.setdiff1d(np.arange(space.mesh.nfacets), space.mesh.boundary_facets())
    X[space.facet_nodes(facets)[:, 2], :2] += 0.05
    bent = locate_sites(X[space.element_nodes[:, :6], :2], points)
    inside = ((points > 1e-9) & (points < SIDE - 1e-9)).all(axis=1)
    assert (bent.element[inside] != OUTSIDE).all()
