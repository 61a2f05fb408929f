"""Contact of skin with skin: forces of the barrier, and bodies whose skin touches, in sections and solids."""

from types import SimpleNamespace

import numpy as np
import pytest
import skfem

from cicatrix.core.errors import InputError
from cicatrix.mechanics.self_contact import SkinContact
from cicatrix.mechanics.solids import solid_space
from cicatrix.mechanics.space import Space

WIDE, HIGH, GAP = 20.0, 8.0, 2.0


def _section_of_two(gap=GAP, n=4):
    """Return the space of two blocks, one above the other with a gap, and the facets of their outlines."""
    block = skfem.MeshTri.init_tensor(np.linspace(0, WIDE, n + 1), np.linspace(0, HIGH, 3))
    mesh = block + block.translated((0.0, HIGH + gap))
    return Space(mesh), mesh.boundary_facets()


def _solid_of_two(gap=GAP, n=2):
    block = skfem.MeshTet.init_tensor(*(np.linspace(0, width, n + 1) for width in (WIDE, WIDE, HIGH)))
    mesh = block + block.translated((0.0, 0.0, HIGH + gap))
    space, _ = solid_space(mesh.p.T, mesh.t.T, np.zeros(mesh.p.shape[1], bool))
    return space, np.arange(len(space.boundary))


@pytest.fixture(scope="module", params=[_section_of_two, _solid_of_two], ids=["section", "solid"])
def two(request):
    """Return two blocks, and a shape in which their skins are as near as 0.3 mm, unevenly."""
    space, facets = request.param()
    contact, across = SkinContact(space, facets), space.n_axes - 1
    x = space.positions.copy()
    upper = x[:, across] > HIGH + 0.5 * GAP
    x[upper, across] -= GAP - 0.3 - 0.02 * x[upper, 0] + 3e-4 * x[upper, 0] ** 2
    x[upper, 0] += 0.37  # no node lies just above an edge
    if across == 2:
        x[upper, 1] += 0.23 + 0.05 * x[upper, 0]
    return SimpleNamespace(space=space, contact=contact, x=x, upper=upper, across=across)


def test_skin_at_a_distance_bears_nothing(two):
    """No force and no energy at the distance of the barrier and beyond it."""
    x = two.space.positions
    assert not two.contact.is_touching(x)
    assert two.contact.energy(x) == 0.0
    assert not two.contact.force(x).any()
    assert two.contact.tangent(x).nnz == 0
    assert len(two.contact.touching(x)) == 0


def test_forces_and_tangents_are_derivatives(two):
    """Along a random direction central differences of the energy and of the forces agree with both."""
    direction = np.random.default_rng(3).standard_normal(two.x.shape)
    h = 1e-5
    there, back = two.x + h * direction, two.x - h * direction
    contact = two.contact
    assert contact.energy(two.x) > 0.0
    slope = (contact.energy(there) - contact.energy(back)) / (2 * h)
    assert np.vdot(contact.force(two.x), direction) == pytest.approx(slope, rel=1e-6)
    rate = (contact.force(there) - contact.force(back)).ravel() / (2 * h)
    matrix = contact.tangent(two.x).tocsr()
    np.testing.assert_allclose(matrix @ direction.ravel(), rate, rtol=0, atol=1e-5 * np.abs(rate).max())
    assert abs(matrix - matrix.T).max() < 1e-12 * abs(matrix).max()


def test_action_is_reaction(two):
    """Forces and their moments sum to zero; each block bears the opposite of the other."""
    force = two.contact.force(two.x)
    size = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-12 * size
    assert np.abs(np.cross(two.x, force).sum(axis=0)).max() < 1e-10 * size
    assert force[two.upper, two.across].sum() < 0.0  # energy falls as the upper block rises


def test_the_barrier_does_not_know_where_it_is(two):
    """Turned and moved, the energy is the same and the forces turn with the skin."""
    angle, axes = 0.7, [0, 1]
    turn = np.eye(3)
    turn[np.ix_(axes, axes)] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    there = two.x @ turn.T + np.array([3.0, -5.0, 0.0])
    assert two.contact.energy(there) == pytest.approx(two.contact.energy(two.x), rel=1e-10)
    force = two.contact.force(two.x)
    np.testing.assert_allclose(two.contact.force(there), force @ turn.T, rtol=0, atol=1e-9 * np.abs(force).max())


@pytest.mark.parametrize("gap", [0.15, 0.3, 0.45])
def test_parallel_surfaces_bear_the_pressure(gap):
    """The node in the middle of a side bears the pressure of the gap on its two half segments (by hand)."""
    space, facets = _section_of_two()
    x = space.positions.copy()
    upper = x[:, 1] > HIGH + 0.5 * GAP
    x[upper, 1] -= GAP - gap
    contact = SkinContact(space, facets)
    middle = (np.abs(x[:, 0] - 0.5 * WIDE) < 1e-9) & (np.abs(x[:, 1] - HIGH - gap) < 1e-9)
    force, s2 = contact.force(x), (gap / 0.5) ** 2
    pressure = 4.0 * (gap / 0.5) * (s2 - 1.0) * np.log(s2) + 2.0 * (s2 - 1.0) ** 2 / (gap / 0.5)
    np.testing.assert_allclose(force[middle], [[0.0, -pressure * WIDE / 8, 0.0]], rtol=1e-9, atol=1e-9)
    assert contact.pressure(gap) == pytest.approx(pressure, rel=1e-12)


def test_a_step_stops_before_skin_meets_skin(two):
    """The upper block falls through the lower one: the step ends above it, and a step aside is free."""
    down = np.zeros((len(two.x), 3))
    down[two.upper, two.across] = -1.0
    x = two.space.positions
    share = two.contact.largest_step(x, x + 5.0 * GAP * down)
    assert 0.15 < share < 0.2  # the gap is a fifth of the way
    assert two.contact.largest_step(x, x + 0.9 * GAP * down) == 1.0
    assert two.contact.largest_step(x, x - 20.0 * down) == 1.0
    assert len(two.contact.crossings(x + share * 5.0 * GAP * down)) == 0


def test_crossings_are_where_skin_crosses(two):
    x = two.space.positions.copy()
    assert two.contact.crossings(x).shape == (0, 3)
    x[two.upper, two.across] -= GAP + 1.0  # the upper block is 1 mm in the lower one
    x[two.upper, 0] += 5.3
    found = two.contact.crossings(x)
    assert len(found)
    assert np.all(np.abs(found[:, two.across] - HIGH) < 0.6 * HIGH)
    assert two.contact.is_touching(x)


@pytest.mark.parametrize("make", [_section_of_two, _solid_of_two])
def test_skin_that_is_near_at_rest_starts_without_force(make):
    """A gap of 0.2 mm in the reference: the barrier begins at half of it."""
    space, facets = make(gap=0.2)
    contact = SkinContact(space, facets)
    assert contact.reach == pytest.approx(0.1, rel=1e-9)
    assert contact.energy(space.positions) == 0.0


def test_bad_contact_is_refused():
    space, facets = _section_of_two(gap=-1.3)
    with pytest.raises(InputError, match="crosses itself at"):
        SkinContact(space, facets).is_touching(space.positions)
    with pytest.raises(InputError, match="distance of the contact of skin with skin must be above zero; got -1 mm"):
        SkinContact(space, facets, distance=-1.0)
