"""Outlines and wounds of known shape; every expected number is by hand."""

import numpy as np
import pytest

from cicatrix.geometry.hexgrid import Lattice
from cicatrix.outcome import closure
from cicatrix.outcome.shape import area, compare, dent_depth, signed_distance_to

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])


def circle(radius, n=720):
    angle = 2 * np.pi * np.arange(n) / n
    return radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])


def test_area():
    assert area(SQUARE) == 100
    assert area(SQUARE[::-1]) == 100
    assert area(circle(10.0)[:, :2]) == pytest.approx(np.pi * 100, rel=1e-4)


def test_signed_distance():
    points = np.array([[5.0, 5.0], [1.0, 5.0], [5.0, 12.0], [13.0, 14.0], [5.0, 0.0]])
    np.testing.assert_allclose(signed_distance_to(SQUARE, points), [5, 1, -2, -5, 0], atol=1e-12)


def test_dent_depth():
    """One side of a square is pushed in by 3 at its middle."""
    dented = np.insert(SQUARE, 3, [5.0, 7.0], axis=0)
    assert dent_depth(dented) == pytest.approx(3)
    assert dent_depth(SQUARE) == pytest.approx(0, abs=1e-12)


def test_a_circle_that_shrinks():
    """A radius of 30 shrinks by 2: the skin is 2 inside everywhere, the area ratio is (28/30)^2, the nipple has moved by 2."""
    before, after = circle(30.0), circle(28.0)
    change = compare(before, after, np.ones(len(before), bool), 0)
    assert change.surface_retraction_max_mm == pytest.approx(2, abs=2e-3)
    assert change.surface_retraction_rms_mm == pytest.approx(2, abs=2e-3)
    assert change.volume_change_percent == pytest.approx(100 * (28**2 / 30**2 - 1))
    assert change.nipple_displacement_mm == pytest.approx(2)
    assert change.concavity_depth_mm == pytest.approx(0, abs=1e-9)


def test_a_circle_that_swells_retracts_nowhere():
    change = compare(circle(30.0), circle(31.0), np.ones(720, bool), 0)
    assert change.surface_retraction_max_mm == 0
    assert change.surface_retraction_rms_mm == pytest.approx(1, abs=2e-3)


def test_nothing_has_changed():
    change = compare(circle(30.0), circle(30.0), np.ones(720, bool), 7)
    np.testing.assert_allclose([getattr(change, name) for name in vars(change)], 0.0, atol=1e-9)


def test_a_shift_along_the_normal_counts_for_the_nipple_only():
    after = circle(30.0) + np.array([0.0, 0.0, 4.0])
    change = compare(circle(30.0), after, np.ones(720, bool), 0)
    assert change.nipple_displacement_mm == pytest.approx(4)
    assert change.surface_retraction_max_mm == pytest.approx(0, abs=1e-9)


def test_the_chest_wall_does_not_count_as_skin():
    """One half moves inward by 2: no retraction if it is wall; if it is skin, maximum 2 and rms over all sqrt(1/2) 2."""
    before = circle(30.0)
    left = before[:, 0] < 0
    after = np.where(left[:, None], before * 28 / 30, before)
    assert compare(before, after, ~left, 0).surface_retraction_rms_mm == pytest.approx(0, abs=1e-9)
    both = compare(before, after, np.ones(720, bool), 0)
    assert both.surface_retraction_max_mm == pytest.approx(2, abs=2e-3)
    assert both.surface_retraction_rms_mm == pytest.approx(np.sqrt(2), rel=0.01)


# wounds on the lattice -----------------------------------------------------------------------------------------------

LATTICE = Lattice.covering((-3.0, -3.0), (3.0, 3.0), 0.05)
POINTS = LATTICE.positions()
CENTRE = LATTICE.nearest(np.zeros(2))
ORIGIN = LATTICE.position(CENTRE)
FROM = POINTS - ORIGIN
DISC = (FROM**2).sum(axis=-1) < 4.001  # no site lies on the border


def test_disc():
    """A disc of radius 2: area 4 pi, perimeter 4 pi, point-symmetric, round."""
    assert closure.open_size(LATTICE, DISC) == pytest.approx(4 * np.pi, rel=0.01)
    assert closure.front_size(LATTICE, DISC, ~DISC) == pytest.approx(4 * np.pi, rel=0.02)
    assert (closure.wound_centre(DISC) == CENTRE).all()
    assert closure.asymmetry(DISC, CENTRE) == 0
    assert closure.roundness(LATTICE, DISC) == pytest.approx(1, abs=1e-3)


def test_half_disc():
    """A half-disc on one side of its centre does not overlap with its mirror image; its centroid is at 4 R / (3 pi)."""
    half = DISC & (FROM[..., 0] > 0.01)
    assert closure.asymmetry(half, CENTRE) == 1
    np.testing.assert_allclose(closure.centroid_shift(LATTICE, half, DISC), [8 / (3 * np.pi), 0.0], atol=0.03)


def test_a_disc_beside_its_centre():
    """A disc shifted by R and its mirror image (shifted by -R) overlap in the lens of two discs 2 R apart, which is empty."""
    beside = ((FROM - [1.5, 0.0]) ** 2).sum(axis=-1) < 1.0
    assert closure.asymmetry(beside, CENTRE) == 1
    # radius 1 shifted by 0.25: lens of two discs 0.5 apart, 2 acos(1/4) - sqrt(15)/8 over pi
    shifted = ((FROM - [0.25, 0.0]) ** 2).sum(axis=-1) < 1.0
    covered = (2 * np.arccos(0.25) - np.sqrt(15) / 8) / np.pi
    assert closure.asymmetry(shifted, CENTRE) == pytest.approx(1 - covered, abs=0.01)


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2])
def test_ellipse(angle):
    """Half-axes 2 and 1 in any direction: the radii of gyration are a / 2 and b / 2; Ramanujan's perimeter 9.688."""
    along = FROM @ np.array([np.cos(angle), np.sin(angle)])
    across = FROM @ np.array([-np.sin(angle), np.cos(angle)])
    ellipse = (along / 2) ** 2 + across**2 < 1.001
    assert closure.roundness(LATTICE, ellipse) == pytest.approx(0.5, abs=0.01)
    assert closure.asymmetry(ellipse, CENTRE) == 0
    assert closure.front_size(LATTICE, ellipse, ~ellipse) == pytest.approx(9.688, rel=0.05)


def test_a_closed_wound():
    nothing = np.zeros(LATTICE.shape, bool)
    assert closure.open_size(LATTICE, nothing) == 0
    assert closure.front_size(LATTICE, nothing, ~nothing) == 0
    assert closure.asymmetry(nothing, CENTRE) == 0
    assert (closure.centroid_shift(LATTICE, nothing, DISC) == 0).all()
    assert np.isnan(closure.roundness(LATTICE, nothing))


# a wound in three dimensions ---------------------------------------------------------------------------------------------

BLOCK = Lattice.covering((-2.4, -2.4, -2.4), (2.4, 2.4, 2.4), 0.08)


def test_a_ball():
    """A ball of radius 2: volume and surface by hand, the surface as the mean over all directions."""
    centre = BLOCK.nearest(np.zeros(3))
    ball = np.linalg.norm(BLOCK.positions() - BLOCK.position(centre), axis=-1) < 2.0 - 1e-9
    assert closure.open_size(BLOCK, ball) == pytest.approx(4 / 3 * np.pi * 8, rel=0.005)
    assert closure.front_size(BLOCK, ball, ~ball) == pytest.approx(16 * np.pi, rel=0.01)
    assert closure.roundness(BLOCK, ball) == pytest.approx(1, abs=1e-3)
    assert (closure.wound_centre(ball) == centre).all()
    assert closure.asymmetry(ball, centre) == 0


def test_a_slab_in_the_densest_plane():
    """Normal to the first index, each site has three of its twelve neighbours across: by hand sqrt(2/3) of the mean."""
    lattice = Lattice((40, 40, 40), 0.1, (0.0, 0.0, 0.0))
    below, above = np.zeros((2, *lattice.shape), bool)
    below[10:20, 5:35, 5:35] = above[20:, 5:35, 5:35] = True
    area = 900 * np.sqrt(3) / 2 * 0.1**2
    assert closure.front_size(lattice, below, above) == pytest.approx(np.sqrt(2 / 3) * area, rel=0.03)
