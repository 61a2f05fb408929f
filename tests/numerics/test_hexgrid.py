"""Root lattices A2 and A3: metric, neighbours, and conversion between indices and positions."""

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.geometry.hexgrid import Lattice, hops

LATTICES = [Lattice((7, 9), 0.05, (1.0, -2.0)), Lattice((5, 6, 7), 0.03, (0.2, 0.4, -3.0))]
IDS = ["A2", "A3"]


@pytest.mark.parametrize("lattice", LATTICES, ids=IDS)
def test_neighbours_lie_at_the_pitch(lattice):
    n = {2: 6, 3: 12}[lattice.ndim]
    assert lattice.neighbours.shape == (n, lattice.ndim)
    assert len(np.unique(lattice.neighbours, axis=0)) == n
    length = np.linalg.norm(lattice.neighbours @ lattice.basis_mm, axis=1)
    np.testing.assert_allclose(length, lattice.pitch_mm, rtol=1e-14)
    others = lattice.ball(3)
    others = others[hops(others) > 1]
    assert (np.linalg.norm(others @ lattice.basis_mm, axis=1) > 1.4 * lattice.pitch_mm).all()


def test_site_measure():
    # hexagon of inradius p/2: sqrt(3)/2 p^2; fcc: one site per (a^3 / 4), a = sqrt(2) p, so p^3 / sqrt(2)
    np.testing.assert_allclose(LATTICES[0].site_measure, np.sqrt(3) / 2 * 0.05**2)
    np.testing.assert_allclose(LATTICES[1].site_measure, 0.03**3 / np.sqrt(2))


@pytest.mark.parametrize("lattice", LATTICES, ids=IDS)
def test_positions_round_trip(lattice):
    points = lattice.positions()
    assert points.shape == (*lattice.shape, lattice.ndim)
    np.testing.assert_allclose(points[(0,) * lattice.ndim], lattice.origin_mm)
    index = np.stack(np.indices(lattice.shape), axis=-1)
    np.testing.assert_array_equal(lattice.nearest(points), index)
    assert lattice.contains(index).all()
    assert not lattice.contains(index + np.array(lattice.shape)).any()


@pytest.mark.parametrize("lattice", LATTICES, ids=IDS)
def test_nearest_is_nearest(lattice):
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (300, lattice.ndim)) + lattice.origin_mm
    near = lattice.nearest(points)
    wide = lattice.position(np.rint(lattice.index(points))[:, None] + lattice.ball(4))  # brute force
    best = np.linalg.norm(wide - points[:, None], axis=-1).min(axis=1)
    np.testing.assert_allclose(np.linalg.norm(lattice.position(near) - points, axis=-1), best, atol=1e-12)


def test_ball_counts_hops():
    # hexagon of side r: 1 + 3 r (r + 1); cuboctahedron: 1, 13, 55, 147 (centred cuboctahedral numbers)
    assert [len(LATTICES[0].ball(r)) for r in range(4)] == [1, 7, 19, 37]
    assert [len(LATTICES[1].ball(r)) for r in range(4)] == [1, 13, 55, 147]


@pytest.mark.parametrize("lattice", LATTICES, ids=IDS)
def test_hops_are_steps(lattice):
    reached = np.zeros((1, lattice.ndim), int)
    for r in range(1, 4):
        reached = np.unique(
            (reached[:, None] + np.vstack([lattice.neighbours, 0 * reached[:1]])).reshape(-1, lattice.ndim), axis=0
        )
        np.testing.assert_array_equal(reached, np.unique(lattice.ball(r), axis=0))


@pytest.mark.parametrize("size", [[0.3, 0.5], [0.3, 0.2, 0.4]])
def test_covering_covers(size):
    low = np.array([-1.0, 2.0, 0.3])[: len(size)]
    lattice = Lattice.covering(low, low + size, 0.04)
    points = low + np.random.default_rng(1).uniform(0, 1, (2000, len(size))) * size
    assert lattice.contains(lattice.nearest(points)).all()
    assert lattice.contains(np.floor(lattice.index(points)).astype(int)).all()
    assert lattice.contains(np.ceil(lattice.index(points)).astype(int)).all()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (((0, 4), 1.0, (0.0, 0.0)), "shape"),
        (((4,), 1.0, (0.0,)), "shape"),
        (((4, -4), 1.0, (0.0, 0.0)), "shape"),
        (((2**21, 2**21), 1.0, (0.0, 0.0)), "shape"),
        (((4, 4), 0.0, (0.0, 0.0)), "pitch"),
        (((4, 4), float("nan"), (0.0, 0.0)), "pitch"),
        (((4, 4), 1.0, (0.0, 0.0, 0.0)), "origin"),
    ],
)
def test_bad_lattices_are_refused(arguments, word):
    with pytest.raises(InputError, match=word):
        Lattice(*arguments)


def test_bad_boxes_are_refused():
    with pytest.raises(InputError, match="low < high"):
        Lattice.covering([0, 0], [1, 0], 0.1)
    with pytest.raises(InputError, match="corners"):
        Lattice.covering([0, 0], [1, 0, 2], 0.1)


def test_lists_and_numpy_numbers_are_taken():
    lattice = Lattice([4, np.int64(5)], 1.0, np.zeros(2))
    assert lattice == Lattice((4, 5), 1.0, (0.0, 0.0))
    assert hash(lattice) == hash(Lattice((4, 5), 1.0, (0.0, 0.0)))
