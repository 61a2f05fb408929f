"""Volumes with axes in other directions than LPS."""

import numpy as np
import pytest

from cicatrix.geometry.volume import AXES, Volume

SOME = Volume(np.arange(24).reshape(2, 3, 4), (1.0, 2.0, 3.0), (10.0, 20.0, 30.0))


def test_there_are_24_ways_to_turn_a_cube():
    assert len(set(AXES)) == 24
    assert {"LPS", "RIA", "RAS"} <= set(AXES)
    assert "LPI" not in AXES  # a mirror image


def test_lps_stays():
    same = SOME.from_axes("LPS")
    np.testing.assert_array_equal(same.values, SOME.values)
    assert (same.spacing_mm, same.origin_mm) == (SOME.spacing_mm, SOME.origin_mm)


@pytest.mark.parametrize("axes", AXES)
def test_a_value_is_found_where_its_point_went(axes):
    """A voxel at x, y, z of the file has the components that the letters name; R, A and I are negative."""
    turned = SOME.from_axes(axes)
    x, y, z = SOME.position(np.array([1, 2, 1]))
    place = np.zeros(3)
    for letter, value in zip(axes, (x, y, z)):
        place["LPS".index({"R": "L", "A": "P", "I": "S"}.get(letter, letter))] = -value if letter in "RAI" else value
    assert turned.nearest(place) == SOME.values[1, 2, 1]
    np.testing.assert_allclose(turned.voxel(place), np.rint(turned.voxel(place)), atol=1e-9)
