"""A phantom with trunk around its breast, against the surfaces that define it; margins, walls and label maps that cannot be."""

import numpy as np
import pytest
from pydantic import ValidationError

from cicatrix.core.errors import InputError
from cicatrix.files.images import write_volume
from cicatrix.geometry.borders import Border
from cicatrix.geometry.labels import Label
from cicatrix.geometry.meshing3d import mesh_body
from cicatrix.geometry.tetrahedra import area_vectors, volumes
from cicatrix.geometry.volume import Volume
from cicatrix.image import segment as segmentation
from cicatrix.image.anatomy import MIDLINE_MM, SUBCUTANEOUS_MM, WALL_RADIUS_MM
from cicatrix.image.phantom import phantom, phantom_grid
from cicatrix.image.segment import segment
from cicatrix.image.trunk import LEAST_MM, Trunk, around, extent, moved_back, shortfall
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.lumpectomy.body import Anatomy, supported
from cicatrix.kinds.lumpectomy.build import breast_model
from cicatrix.kinds.lumpectomy.case import FasciaTable, ImageTable, LumpectomyCase, MeshTable, ResectionTable
from cicatrix.kinds.lumpectomy.section import section_from_arrays
from cicatrix.kinds.registry import load_case

pytestmark = pytest.mark.xdist_group("trunk")  # segmented once

SPACING = 4.0
TRUNK = Trunk(medial_mm=40.0, lateral_mm=50.0, above_mm=25.0, below_mm=40.0)


def wall_y(points):
    """Return the y of the phantom's chest wall at points (..., 3) of a left breast [mm], from its radii of curvature."""
    across, along = WALL_RADIUS_MM
    return (points[..., 0] ** 2 - MIDLINE_MM**2) / (2 * across) + points[..., 2] ** 2 / (2 * along)


@pytest.fixture(scope="module")
def scan():
    return phantom(spacing_mm=SPACING, seed=1, trunk=TRUNK, bias=0.0)[0]


@pytest.fixture(scope="module")
def found(scan):
    """Return the segmentation with trunk and without; the image has no bias field to remove."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(segmentation, "remove_bias", lambda image, body: image)
        return [segment(scan, weighting="t1", side="left", trunk=trunk) for trunk in (TRUNK, Trunk())]


@pytest.fixture(scope="module")
def anatomy(scan, found):
    return Anatomy.of(scan, found[0])


@pytest.fixture(scope="module")
def mesh(anatomy):
    return mesh_body(anatomy.domain, 16.0, tissue=anatomy.body, wall_mm=anatomy.wall_mm, has_trunk=True)


def test_the_breast_is_the_same_with_trunk_and_without(found):
    """Labels hold the breast alone, so that no volume of the breast counts the trunk."""
    assert found[0].labels.values.tobytes() == found[1].labels.values.tobytes()
    breast = np.isin(found[0].labels.values, (1, 2, 3, 4))
    inner = found[0].probabilities.values[:, breast]
    np.testing.assert_array_equal(inner, found[1].probabilities.values[:, breast])
    assert not found[1].probabilities.values[:, ~breast].any()
    assert any("ml of trunk around the breast" in note for note in found[0].notes)
    assert not any("trunk" in note for note in found[1].notes)


def test_the_trunk_is_skin_and_fat_of_the_volume_in_front_of_the_wall(anatomy):
    """Away from the breast skin and fat are 11 mm thick along y, by definition of the phantom; there is no gland."""
    trunk = (anatomy.domain.values != anatomy.labels.values).any(axis=1)
    base = np.isin(anatomy.labels.values, (1, 2, 3, 4)).any(axis=1)
    x, z = anatomy.labels.axis(2)[None, :], anatomy.labels.axis(0)[:, None]
    far = ((x - MIDLINE_MM) / 74) ** 2 + (z / 69) ** 2 > 1  # beyond the fillet between breast and torso
    columns = trunk & ~base & far
    inside = anatomy.body.values.sum(axis=1)[columns] * SPACING
    rim = anatomy.body.values.max(axis=1)[columns] < 0.99  # columns that the outline cuts
    assert inside[~rim].mean() == pytest.approx(SUBCUTANEOUS_MM, abs=1.0)
    gland, tumour = (anatomy.probabilities.values[k][(anatomy.domain.values != anatomy.labels.values)] for k in (1, 3))
    assert not gland.any()
    assert not tumour.any()


def test_the_trunk_reaches_its_margins(anatomy):
    """The margins count from the breast's base, which the fillet widens beyond the ellipse of 120 by 110 mm."""
    voxel = anatomy.labels.spacing_mm[2], anatomy.labels.spacing_mm[0]
    base = np.isin(anatomy.labels.values, (1, 2, 3, 4)).any(axis=1)
    have = extent(base, base | (anatomy.domain.values != anatomy.labels.values).any(axis=1), "left", voxel)
    for name in ("medial_mm", "lateral_mm", "above_mm", "below_mm"):
        assert getattr(have, name) == pytest.approx(getattr(TRUNK, name), abs=1.5 * SPACING), name


def test_borders_of_the_mesh_lie_on_the_surfaces_of_the_phantom(mesh):
    """Faces on wall and skin against the analytic surfaces; the rim stands upright at the margins, and closes the body."""
    assert mesh.quality.faults() == []
    assert set(np.unique(mesh.marker)) == {Border.SKIN, Border.WALL, Border.RIM}
    middles, areas = mesh.nodes[mesh.faces].mean(axis=1), area_vectors(mesh.nodes, mesh.faces)
    size = np.linalg.norm(areas, axis=1)
    kinds = {kind: mesh.marker == kind for kind in Border}
    wall = kinds[Border.WALL]
    assert np.average(np.abs(middles[wall, 1] - wall_y(middles[wall])), weights=size[wall]) < 1.0
    assert (areas[wall, 1] > 0).mean() > 0.98  # seen from behind
    skin = kinds[Border.SKIN]
    far = ((middles[:, 0] - MIDLINE_MM) / 74) ** 2 + (middles[:, 2] / 69) ** 2 > 1
    torso = wall_y(middles) - SUBCUTANEOUS_MM
    flat = skin & far & (np.abs(middles[:, 1] - torso) < 8)
    assert np.average(np.abs(middles[flat, 1] - torso[flat]), weights=size[flat]) < 1.0
    front = skin & ~far & (middles[:, 1] < -30)
    half_axes = np.array([60.0, 75.0, 55.0])
    q = np.stack([middles[:, 0] - MIDLINE_MM, wall_y(middles) - middles[:, 1], middles[:, 2]], axis=-1)[front]
    level = np.linalg.norm(q / half_axes, axis=1)
    off = level * (level - 1) / np.linalg.norm(q / half_axes**2, axis=1)  # first-order distance to the ellipsoid
    assert np.average(np.abs(off), weights=size[front]) < 1.5  # the nipple stands out
    rim = kinds[Border.RIM]
    upright = np.abs(areas[rim, 1]) / size[rim]
    assert np.average(upright, weights=size[rim]) < 0.5
    base = ((middles[rim, 0] - MIDLINE_MM) / 62) ** 2 + (middles[rim, 2] / 57) ** 2
    assert base.min() > 1  # none at the breast
    np.testing.assert_allclose(areas.sum(axis=0), 0, atol=1e-6 * size.sum())


def test_volume_of_the_mesh_is_that_of_breast_and_trunk(anatomy, mesh):
    voxels = float(anatomy.body.values.sum(dtype=float) * SPACING**3)
    assert volumes(mesh.nodes, mesh.tetrahedra).sum() == pytest.approx(voxels, rel=0.03)  # the rim may be rounded
    assert abs(mesh.quality.volume_error) < 0.01


def test_distance_to_the_wall_of_the_phantom(anatomy):
    """Against the distance to the analytic wall, to first order, in the body."""
    field = anatomy.wall_distance
    points = anatomy.body.position(np.argwhere(anatomy.body.values > 0.5))
    ahead = wall_y(points) - points[:, 1]
    near = (ahead < 30) & (ahead > -5)
    across, along = WALL_RADIUS_MM
    slope = np.sqrt(1 + (points[:, 0] / across) ** 2 + (points[:, 2] / along) ** 2)
    assert np.abs(field.sample(points[near]) - (ahead / slope)[near]).mean() < 1.0


def test_the_fold_is_the_lower_border_of_the_breast(anatomy):
    x, z = anatomy.fold
    middle = np.abs(x - MIDLINE_MM) < 20
    assert np.isfinite(z[middle]).all()
    np.testing.assert_allclose(z[middle], -55 * np.sqrt(1 - ((x[middle] - MIDLINE_MM) / 60) ** 2), atol=8)  # and fillet


def test_margins_widen_the_base_by_quarter_ellipses():
    base = np.zeros((41, 41), bool)
    base[20, 20] = True
    wide = around(base, Trunk(medial_mm=6, lateral_mm=12, above_mm=8, below_mm=4), "left", (2.0, 2.0))
    z, x = np.meshgrid(2.0 * (np.arange(41) - 20), 2.0 * (np.arange(41) - 20), indexing="ij")
    truth = (z / np.where(z < 0, 4, 8)) ** 2 + (x / np.where(x < 0, 6, 12)) ** 2 <= 1  # left: lateral is +x
    np.testing.assert_array_equal(wide, truth)
    mirrored = around(base, Trunk(medial_mm=6, lateral_mm=12, above_mm=8, below_mm=4), "right", (2.0, 2.0))
    np.testing.assert_array_equal(mirrored, truth[:, ::-1])
    np.testing.assert_array_equal(
        around(base, Trunk(lateral_mm=4), "left", (2.0, 2.0)), base | (truth & (z == 0) & (x > 0) & (x <= 4))
    )


def test_what_the_image_does_not_show_is_noted():
    asked = Trunk(60, 80, 40, 60)
    notes = shortfall(asked, Trunk(30, 78, 10, 60), at_midline=True)
    assert notes == (
        "trunk medially: 30 of 60 mm, to the midline, where the skin is held by the sternum",
        "trunk above: 10 of 40 mm, the image shows no more",
    )
    assert shortfall(asked, asked, at_midline=False) == ()


@pytest.fixture
def slab():
    """Return a body y > 0 in an image, and its columns."""
    grid = Volume(np.zeros((12, 20, 12)), (2.0, 2.0, 2.0), (0.0, -19.0, 0.0))
    return grid, np.broadcast_to(grid.axis(1)[None, :, None] > 0, grid.shape).copy(), np.ones((12, 12), bool)


def test_a_wall_near_the_skin_is_moved_back(slab):
    grid, body, domain = slab
    wall, notes = moved_back(np.full((12, 12), 2.0), body, domain, grid, is_given=False)
    np.testing.assert_allclose(wall, LEAST_MM)  # the skin is at y = 0
    assert notes == ("in 100 % of the trunk the wall is moved back to 6 mm below the skin",)
    deep = np.full((12, 12), 11.0)
    kept, notes = moved_back(deep, body, domain, grid, is_given=False)
    np.testing.assert_array_equal(kept, deep)
    assert notes == ()


def test_a_wall_that_the_skin_crosses(slab):
    """A given wall 9 mm in front of the skin is refused with the place; a found one is moved back and noted."""
    grid, body, domain = slab
    wall = np.full((12, 12), -9.0)
    with pytest.raises(
        InputError,
        match=r"image.chest_wall: the skin crosses this wall in 100 % .* \(0, 0, 0\) mm \(LPS\), by 9 mm; give",
    ):
        moved_back(wall, body, domain, grid, is_given=True)
    moved, notes = moved_back(wall, body, domain, grid, is_given=False)
    np.testing.assert_allclose(moved, LEAST_MM)
    assert any("crosses the skin, most at (0, 0, 0) mm" in note for note in notes)


def case_with(folder, text):
    (folder / "case.toml").write_text(f'kind = "lumpectomy"\ndimension = 2\n{text}')
    return load_case(folder / "case.toml")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('[image]\nphantom = "half-ellipsoid"\n[trunk]\nmedial_mm = -5', "trunk.medial_mm"),
        ('[image]\npath = "x.nii"\nphantom_size_mm = [100, 60, 90]', "phantom_size_mm"),
    ],
)
def test_bad_margins_and_sizes_are_refused(text, sentence, tmp_path):
    with pytest.raises((InputError, ValidationError), match=sentence):
        case_with(tmp_path, text)


def test_the_phantom_shows_the_trunk_that_is_asked_for():
    """Without trunk the field of view is as it was; with trunk it goes on by the margins, and the breast has its size."""
    plain, wide = phantom_grid(spacing_mm=2.0), phantom_grid(spacing_mm=2.0, trunk=TRUNK)
    assert plain.shape == (73, 68, 96)  # 146 by 136 by 192 mm
    ends = np.stack([[v.axis(a)[0] - 1, v.axis(a)[-1] + 1] for v in (wide,) for a in (2, 0)])
    assert ends[0, 0] <= MIDLINE_MM - 60 - TRUNK.medial_mm
    assert ends[0, 1] >= MIDLINE_MM + 60 + TRUNK.lateral_mm
    assert ends[1, 0] <= -55 - TRUNK.below_mm
    assert ends[1, 1] >= 55 + TRUNK.above_mm
    _, labels = phantom(spacing_mm=SPACING, seed=1, size_mm=(90.0, 100.0, 80.0))
    breast = np.isin(labels.values, (1, 2, 3, 4))
    half_ellipsoid = 2 / 3 * np.pi * 45 * 100 * 40
    assert breast.sum() * SPACING**3 == pytest.approx(half_ellipsoid, rel=0.05)


def test_a_label_map_has_no_trunk_and_says_so(tmp_path, found):
    write_volume(tmp_path / "labels.nii.gz", found[1].labels)
    anatomy, notes = anatomy_of(case_with(tmp_path, '[image]\nlabels = "labels.nii.gz"\n'))
    assert "a label map has no trunk: the body ends beside the breast, and is held there" in notes
    assert not anatomy.has_trunk
    np.testing.assert_array_equal(anatomy.domain.values, anatomy.labels.values)
    assert (anatomy.domain.values == Label.CHEST).any()


def small_case(**fascia):
    return LumpectomyCase(
        image=ImageTable(labels="not-read.nii"),
        resection=ResectionTable(centre_mm=(80.0, -35.0, 5.0), radius_mm=10.0),
        mesh=MeshTable(edge_mm=12.0, cavity_edge_mm=5.0),
        fascia=FasciaTable(**fascia),
    )


def test_the_rim_is_held_and_the_wall_slides(anatomy):
    case = small_case()
    model = breast_model(case, anatomy)
    found, space = model.intact.discretization, model.intact.discretization.space
    skin, wall, rim = (model.mesh.boundaries[name] for name in ("skin", "wall", "rim"))
    assert min(len(skin), len(wall), len(rim)) > 0
    assert len(skin) + len(wall) + len(rim) == len(model.mesh.boundary_facets())
    np.testing.assert_array_equal(found.fixed_nodes, np.unique(space.facet_nodes(rim)))
    np.testing.assert_array_equal(found.wall_facets, wall)
    x = space.positions[found.fixed_nodes]
    assert (np.abs(x[:, 0] - MIDLINE_MM) > 60).all()  # held on both sides of the breast, and not behind it
    assert x[:, 0].min() < MIDLINE_MM < x[:, 0].max()
    held = supported(small_case(slides=False), space, skin, wall, rim)
    np.testing.assert_array_equal(held.fixed_nodes, np.unique(space.facet_nodes(np.concatenate([wall, rim]))))
    assert not len(held.wall_facets)
    bare = supported(case, space, skin, wall, np.zeros(0, int))
    ends = np.intersect1d(space.facet_nodes(skin), space.facet_nodes(wall))
    np.testing.assert_array_equal(bare.fixed_nodes, ends)


def test_a_model_on_a_wall_comes_back_from_its_arrays(anatomy):
    case = small_case()
    model = breast_model(case, anatomy)
    again = section_from_arrays(case, model.arrays())
    for name, values in model.arrays().items():
        assert np.asarray(values).tobytes() == np.asarray(again.arrays()[name]).tobytes(), name
    x = model.x_imaged + 0.3 * np.sin(model.x_imaged[:, [1, 2, 0]] / 9.0)
    distances = [np.asarray(m.wall.distance.at(x)).tobytes() for m in (model, again)]
    assert distances[0] == distances[1]


def test_a_change_of_volume_is_relative_to_the_breast(anatomy):
    """A body that grows by 1 % in both directions has 2.01 % more area; related to the breast alone, that is more."""
    model = breast_model(small_case(), anatomy)
    body = model.intact.volumes(model.x_imaged).sum()
    share = model.breast_share
    plane = anatomy.labels.nearest(model.section.to_patient(model.section.raster(anatomy.labels, 1.0).points))
    assert share * body == pytest.approx(np.isin(plane, (1, 2, 3, 4)).sum(), rel=0.05)
    assert share < 0.95
    grown = model.change(model.x_imaged, 1.01 * model.x_imaged).volume_change_percent
    assert grown == pytest.approx(2.01 / share, rel=1e-3)
    bare = Anatomy(
        None,
        anatomy.labels,
        anatomy.probabilities.with_values(anatomy.probabilities.values * np.isin(anatomy.labels.values, (1, 2, 3, 4))),
    )
    assert breast_model(small_case(), bare).breast_share == 1.0
