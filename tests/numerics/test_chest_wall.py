"""The chest wall: its smooth signed distance, beyond the body too, the fold below the breast, and the springs on it."""

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.geometry.borders import Border, behind_wall, border_at, extended, flat_border, wall_heights
from cicatrix.geometry.chest_wall import inframammary_fold, wall_distance
from cicatrix.geometry.labels import Label
from cicatrix.geometry.section import Section
from cicatrix.geometry.volume import Volume
from cicatrix.kinds.lumpectomy.fascia import Wall, distance_in_section, distance_in_solid, in_fold

VOXEL = 2.5
RADIUS, APEX = 150.0, -5.0  # of a round wall, whose foremost point lies at x = z = 0


def labels_before(height, half_width=40.0):
    """Return labels of a slab of fat, 20 mm thick, in front of a wall y = height(x, z) and chest behind it, and the wall."""
    across = np.arange(-60.0, 61.0, VOXEL)
    z, y, x = np.meshgrid(across, np.arange(-40.0, 60.0, VOXEL), across, indexing="ij")
    wall = height(x[:, 0], z[:, 0])
    ahead = wall[:, None] - y
    within = (np.abs(x) < half_width) & (np.abs(z) < half_width)
    values = np.where(ahead < 0, Label.CHEST, np.where((ahead < 20) & within, Label.FAT, Label.AIR))
    return Volume(values.astype(np.uint8), (VOXEL,) * 3, (-60.0, -40.0, -60.0)), wall


def points_of(volume):
    return volume.position(np.moveaxis(np.indices(volume.shape), 0, -1))


def test_distance_to_an_oblique_plane_is_exact():
    """A plane has no bending, so that its extension beyond the body and its distance are exact."""
    slope = np.array([0.3, -1.0, 0.2])
    labels, wall = labels_before(lambda x, z: 3.0 + 0.3 * x + 0.2 * z)
    field = wall_distance(labels, wall)
    truth = (points_of(field) @ slope + 3.0) / np.linalg.norm(slope)
    np.testing.assert_allclose(field.values, truth, atol=1e-6)
    assert field.spacing_mm == (3.0, 3.0, 3.0)
    rows = np.argwhere(labels.values == Label.FAT)
    assert np.all(labels.position(rows.min(axis=0)) - field.position(np.zeros(3)) >= 19.9)


def test_distance_to_a_round_wall():
    """The distance to a sphere of 150 mm: within 0.1 mm in the body, of slope 1 everywhere; steps of voxels are smoothed."""
    centre = np.array([0.0, APEX + RADIUS, 0.0])

    def height(x, z):
        return centre[1] - np.sqrt(RADIUS**2 - x**2 - z**2)

    labels, wall = labels_before(height)
    field = wall_distance(labels, wall)
    points = points_of(field)
    off = field.values - (np.linalg.norm(points - centre, axis=-1) - RADIUS)
    inner = np.all(np.abs(points[..., [0, 2]]) < 30, axis=-1) & (np.abs(points[..., 1]) < 30)
    assert np.abs(off[inner]).max() < 0.1
    slope = np.linalg.norm(np.asarray(np.gradient(field.values, 3.0)), axis=0)
    np.testing.assert_allclose(slope, 1.0, atol=0.003)
    rough = wall_distance(labels, wall_heights(labels))
    assert np.abs(rough.values - field.values)[inner].mean() < 0.35  # steps of 2.5 mm are 0.6 mm off in the mean


def test_columns_without_a_wall_take_the_nearest_one_and_a_body_without_wall_is_refused():
    np.testing.assert_array_equal(extended(np.array([[1.0, np.nan, np.nan, 4.0]])), [[1.0, 1.0, 4.0, 4.0]])
    labels, wall = labels_before(lambda x, z: 0.0 * x)
    with pytest.raises(InputError, match="no chest wall is found behind the breast"):
        wall_distance(labels, np.full_like(wall, np.nan))


def test_fold_is_the_lower_border_of_the_base():
    """The base is |x|, |z| < 40 mm in voxels of 2.5 mm, whose lowest centre lies at -37.5 mm: the fold is at -38.75 mm."""
    labels, _ = labels_before(lambda x, z: 0.0 * x)
    x, z = inframammary_fold(labels)
    np.testing.assert_array_equal(np.isfinite(z), np.abs(x) < 40)
    np.testing.assert_allclose(z[np.abs(x) < 40], -38.75)
    centres = np.array([[0.0, 3.0, -33.0], [0.0, 3.0, -30.0], [10.0, -9.0, -44.0], [58.0, 0.0, -38.0]])
    np.testing.assert_array_equal(in_fold(np.stack([x, z]), centres), [True, False, True, False])
    cut = labels.with_values(labels.values[12:])  # the image ends within the breast
    assert np.isnan(inframammary_fold(cut)[1]).all()
    assert not in_fold(inframammary_fold(cut), centres).any()


def test_borders_of_a_slab():
    """Air lies in front of the slab and beside it; behind it lies the wall; chest in front of the wall is the rim."""
    labels, wall = labels_before(lambda x, z: 0.0 * x)
    beside = (labels.values == Label.AIR) & (labels.axis(1) > -20)[None, :, None] & (labels.axis(2) > 0)
    labels.values[beside] = Label.CHEST
    border = border_at(labels, wall)
    ends = np.array([[0.0, -20, 0], [0, 0, 10], [-40, -10, 0], [40, -10, 0]])
    np.testing.assert_array_equal(border(ends), [Border.SKIN, Border.WALL, Border.SKIN, Border.RIM])
    behind = behind_wall(labels, wall)
    assert (labels.axis(1)[np.argwhere(behind)[:, 1]] > 0).all()
    heights = wall_heights(labels)
    np.testing.assert_allclose(heights[np.isfinite(heights)], 1.25)  # halfway between the last fat and the first chest
    on_edge = flat_border(labels, wall, 2.0)
    np.testing.assert_array_equal(on_edge(np.array([[0.0, -1, 60], [0, -9, 60]])), [Border.WALL, Border.CUT])


def test_without_chest_the_cut_behind_the_breast_is_its_wall():
    labels, _ = labels_before(lambda x, z: 0.0 * x)
    cut = labels.with_values(np.where(labels.values == Label.CHEST, 0, labels.values)[:, :17])
    heights = wall_heights(cut)
    across = np.abs(cut.axis(2)) < 40
    np.testing.assert_array_equal(np.isfinite(heights), across & across[:, None])
    np.testing.assert_allclose(heights[np.isfinite(heights)], cut.axis(1)[-1] + 1.25)
    np.testing.assert_allclose(wall_distance(cut, heights).sample(np.array([[3.0, -17.0, 9.0]])), 18.25, atol=1e-6)


def test_springs_see_the_same_distance_in_space_and_in_a_section_and_come_back_to_the_bit():
    labels, wall = labels_before(lambda x, z: 3.0 + 0.3 * x + 0.2 * z)
    field = wall_distance(labels, wall)
    section = Section("axial", 4.0)
    plane, space = distance_in_section(field, section), distance_in_solid(field)
    points = np.random.default_rng(1).uniform([-30, -25, 0], [30, 20, 0], (9, 3))
    there = section.to_patient(points[:, :2])
    np.testing.assert_allclose(np.asarray(plane.at(points)), np.asarray(space.at(there)), atol=1e-6)
    kept = Wall(plane, np.array([True, False])).arrays()
    again = Wall.from_arrays(kept)
    assert again is not None
    for name, values in again.arrays().items():
        assert np.asarray(values).tobytes() == np.asarray(kept[name]).tobytes()
    assert np.asarray(again.distance.at(points)).tobytes() == np.asarray(plane.at(points)).tobytes()
    assert Wall.from_arrays({"in_plane": np.zeros(1)}) is None
