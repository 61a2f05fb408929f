"""Trunk around the breast: against the phantom's own anatomy, whose wall, skin and base are known in closed form."""

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.geometry.borders import Border, wall_heights
from cicatrix.geometry.chest_wall import inframammary_fold, wall_distance
from cicatrix.geometry.labels import TISSUES, Label
from cicatrix.geometry.meshing3d import mesh_body
from cicatrix.geometry.tetrahedra import area_vectors
from cicatrix.geometry.volume import Volume
from cicatrix.image.anatomy import MIDLINE_MM, WALL_RADIUS_MM, draw
from cicatrix.image.chest import find_chest
from cicatrix.image.phantom import phantom
from cicatrix.image.segment import segment
from cicatrix.image.trunk import LEAST_MM, Trunk, around, moved_back, shortfall
from cicatrix.kinds.lumpectomy.body import Anatomy

TRUNK = Trunk(40.0, 50.0, 30.0, 40.0)
HALF_AXES = np.array([60.0, 75.0, 55.0])  # of the phantom's breast
SHIFT = np.array([MIDLINE_MM, 0.0, 0.0])


def wall_y(x, z):
    """Return y of the phantom's wall at x, z [mm]."""
    across, along = WALL_RADIUS_MM
    return (x**2 - MIDLINE_MM**2) / (2 * across) + z**2 / (2 * along)


@pytest.fixture(scope="module")
def image():
    return phantom(spacing_mm=4.0, seed=5, trunk=TRUNK)[0]


@pytest.fixture(scope="module")
def found(image):
    return segment(image, weighting="t1", side="left", trunk=TRUNK)


@pytest.fixture(scope="module")
def mesh(found):
    anatomy = Anatomy.of(None, found)
    return mesh_body(anatomy.domain, 14.0, tissue=anatomy.body, wall_mm=anatomy.wall_mm, has_trunk=True)


def middles(mesh, border):
    return mesh.nodes[mesh.faces[mesh.marker == border]].mean(axis=1)


def test_the_breast_is_the_same_with_and_without_a_trunk(image, found):
    alone = segment(image, weighting="t1", side="left")
    assert alone.labels.values.tobytes() == found.labels.values.tobytes()
    breast = np.isin(alone.labels.values, TISSUES)
    np.testing.assert_array_equal(alone.probabilities.values[:, breast], found.probabilities.values[:, breast])
    assert not alone.body.values[~breast].any()
    trunk = found.probabilities.values[:, ~breast].sum(axis=1)
    assert trunk[[0, 2]].min() > 0  # fat and skin
    assert not trunk[[1, 3]].any()  # neither gland nor tumour


def test_the_trunk_has_its_margins_and_lies_on_the_wall(image, found):
    """The columns reach the margins within two voxels, and the wall is less than 1 mm from the parabola on average."""
    columns = (found.body.values > 0.5).any(axis=1)
    z, x = image.axis(0), image.axis(2)
    ends = np.array([x[columns.any(axis=0)][[0, -1]], z[columns.any(axis=1)][[0, -1]]])
    asked = np.array([[MIDLINE_MM - 60 - 40, MIDLINE_MM + 60 + 50], [-55 - 40, 55 + 30]])
    assert np.abs(ends - asked).max() < 6.5
    off = found.wall_mm - wall_y(x[None, :], z[:, None])
    assert np.abs(off[columns]).mean() < 1.0


def test_faces_lie_where_their_borders_say(mesh):
    """Wall faces lie on the parabola, skin faces on the phantom's surface, rim faces are vertical; there are no others."""
    assert mesh.quality.faults() == []
    assert set(np.unique(mesh.marker)) == {Border.SKIN, Border.WALL, Border.RIM}
    wall, skin, rim = (middles(mesh, border) for border in (Border.WALL, Border.SKIN, Border.RIM))
    assert np.abs(wall[:, 1] - wall_y(wall[:, 0], wall[:, 2])).mean() < 1.0
    anatomy = draw(np.random.default_rng(0), HALF_AXES, -1.0, 0.2, None, 0.0)
    local = (skin - SHIFT).T
    outside = anatomy.outside(np.stack([local[0], anatomy.height(local), local[2]]))
    assert np.abs(outside).mean() < 1.0
    normals = area_vectors(mesh.nodes, mesh.faces[mesh.marker == Border.RIM])
    flat = np.abs(normals[:, 1]) / np.linalg.norm(normals, axis=1)
    assert np.average(flat, weights=np.linalg.norm(normals, axis=1)) < 0.35  # rounded over a few mm of 11
    base = ((rim[:, 0] - MIDLINE_MM) / 60) ** 2 + (rim[:, 2] / 55) ** 2
    assert base.min() > 1.5  # no face beside the breast is held


def test_margins_are_quarter_ellipses():
    """One column of 1 mm grows to an ellipse of four quarters: area pi/4 (a + b)(c + d), and a reach of each margin."""
    base = np.zeros((121, 141), bool)
    base[60, 70] = True
    wide = around(base, Trunk(20.0, 40.0, 10.0, 30.0), "left", (1.0, 1.0))
    assert wide.sum() == pytest.approx(np.pi / 4 * (20 + 40) * (10 + 30), rel=0.05)
    rows, columns = np.flatnonzero(wide.any(axis=1)), np.flatnonzero(wide.any(axis=0))
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (30, 70, 50, 110)
    mirrored = around(base[:, ::-1], Trunk(20.0, 40.0, 10.0, 30.0), "right", (1.0, 1.0))
    np.testing.assert_array_equal(mirrored[:, ::-1], wide)
    lateral = around(base, Trunk(lateral_mm=5.0), "left", (1.0, 1.0))
    np.testing.assert_array_equal(np.argwhere(lateral), [[60, x] for x in range(70, 76)])


def test_the_trunk_ends_at_the_midline_between_two_breasts():
    (right, _), (left, labels) = (phantom(spacing_mm=5.0, seed=5, side=side) for side in ("right", "left"))
    n = int(np.ceil((0.0 - left.origin_mm[0]) / 5.0))  # voxels of the left image on the other side of the midline
    both = np.concatenate([right.values[..., : right.shape[2] - n], left.values[..., n:]], axis=2)
    image = Volume(both, left.spacing_mm, right.origin_mm)
    body = np.concatenate([labels.values[..., : n - 1 : -1], labels.values[..., n:]], axis=2) > 0
    chest = find_chest(image, body[..., -image.shape[2] :], True, "left", None, Trunk(medial_mm=60.0))
    assert chest.shows_both
    x = image.axis(2)[chest.beside.any(axis=0)]
    assert abs(x[0]) < 23.0  # the phantom's skin is deepest at the foot of either breast, 18 mm from the midline
    assert "sternum" in shortfall(Trunk(medial_mm=60.0), Trunk(medial_mm=20.0), chest.shows_both)[0]
    assert "the image shows no more" in shortfall(Trunk(0, 80, 0, 0), Trunk(0, 35, 0, 0), True)[0]


def test_a_wall_that_the_skin_crosses_is_refused():
    image, labels = phantom(spacing_mm=5.0, seed=5, trunk=TRUNK)
    plane = {"point_mm": (MIDLINE_MM, -15.0, 0.0), "normal": (0.0, -1.0, 0.0)}
    with pytest.raises(
        InputError, match=r"image.chest_wall: the skin crosses this wall in .* most at \(.*\) mm \(LPS\)"
    ):
        find_chest(image, labels.values > 0, True, "left", plane, TRUNK)


def test_a_wall_too_near_to_the_skin_is_moved_back():
    """A wall 2 mm behind flat skin at y = -10 mm is moved to 6 mm behind it; one 12 mm behind it stays."""
    grid = Volume(np.zeros((30, 40, 30), np.float32), (2.0, 2.0, 2.0), (0.0, -40.0, 0.0))
    body = np.broadcast_to(grid.axis(1)[None, :, None] > -10.0, grid.shape)
    skin = grid.axis(1)[body[0, :, 0]][0] - 1.0
    everywhere = np.ones((30, 30), bool)
    near, notes = moved_back(np.full((30, 30), skin + 2.0), body, everywhere, grid, is_given=False)
    np.testing.assert_allclose(near, skin + LEAST_MM, atol=1e-9)
    assert notes == ("in 100 % of the trunk the wall is moved back to 6 mm below the skin",)
    far, notes = moved_back(np.full((30, 30), skin + 12.0), body, everywhere, grid, is_given=False)
    np.testing.assert_array_equal(far, skin + 12.0)
    assert notes == ()


def slab(y_of):
    """Return labels of fat of 20 mm in front of a chest whose wall is at y_of(x, z), in voxels of 2 mm."""
    grid = Volume(np.zeros((21, 40, 31), np.uint8), (2.0, 2.0, 2.0), (-30.0, -40.0, -20.0))
    x, y, z = np.moveaxis(grid.position(np.moveaxis(np.indices(grid.shape), 0, -1)), -1, 0)
    body = np.where(y > y_of(x, z), Label.CHEST, np.where(y > y_of(x, z) - 20, Label.FAT, Label.AIR))
    return grid.with_values(body.astype(np.uint8)), y_of(x, z)[:, 0]


def test_distance_to_a_tilted_plane_is_exact_beyond_the_body():
    labels, heights = slab(lambda x, z: 5.0 + 0.3 * x - 0.2 * z)
    field = wall_distance(labels, heights)
    x, y, z = np.moveaxis(field.position(np.moveaxis(np.indices(field.shape), 0, -1)), -1, 0)
    exact = (5.0 + 0.3 * x - 0.2 * z - y) / np.sqrt(1 + 0.3**2 + 0.2**2)
    np.testing.assert_allclose(field.values, exact, atol=1e-6)
    assert x.min() <= -48.0 <= 48.0 <= x.max()


def test_distance_to_a_cylinder_is_radial():
    """A thorax of radius 120 mm: the distance is r - 120 where the perpendicular meets the wall that is known, within 0.3 mm."""
    labels, heights = slab(lambda x, z: 120.0 - np.sqrt(120.0**2 - x**2) + 0 * z)
    field = wall_distance(labels, heights)
    points = np.random.default_rng(3).uniform([-20, -25, -15], [20, 20, 15], (200, 3))
    exact = np.hypot(points[:, 0], points[:, 1] - 120.0) - 120.0
    np.testing.assert_allclose(field.sample(points, order=3), exact, atol=0.3)


def test_the_wall_of_a_label_map():
    labels, _ = slab(lambda x, z: 7.0 + 0 * x)
    np.testing.assert_allclose(wall_heights(labels), 7.0, atol=1.0)
    cut = labels.with_values(np.where(labels.values == Label.CHEST, Label.FAT, labels.values))
    np.testing.assert_allclose(wall_heights(cut), cut.axis(1)[-1] + 1.0)
    floating = labels.with_values(np.where(labels.values == Label.CHEST, Label.AIR, labels.values))
    assert np.isnan(wall_heights(floating)).all()
    with pytest.raises(InputError, match="no chest wall is found behind the breast"):
        wall_distance(floating, wall_heights(floating))


def test_the_fold_is_the_lower_border_of_the_base():
    _, labels = phantom(spacing_mm=3.0, seed=5)
    x, z = inframammary_fold(labels)
    inner = np.abs(x - MIDLINE_MM) < 50
    exact = -55 * np.sqrt(1 - ((x[inner] - MIDLINE_MM) / 60) ** 2)
    np.testing.assert_allclose(z[inner], exact, atol=3.5)
    assert np.isnan(z[np.abs(x - MIDLINE_MM) > 64]).all()
