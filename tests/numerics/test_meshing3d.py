"""Meshing a body: closed-form volumes, a conforming cavity, markers, reproducible bytes, the quality check, refusals."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.files.images import read_image
from cicatrix.files.segmentations import read_labels
from cicatrix.geometry import meshing3d
from cicatrix.geometry.bcc import bcc_lattice
from cicatrix.geometry.isosurface import isosurface, segmented_body
from cicatrix.geometry.labels import Label
from cicatrix.geometry.mesh_quality import is_manifold, n_pieces
from cicatrix.geometry.meshing3d import Attempt, Border, Region, mesh_body
from cicatrix.geometry.tetrahedra import area_vectors, boundary, dihedral_angles, volumes
from cicatrix.geometry.volume import Volume
from cicatrix.image.phantom import phantom
from cicatrix.image.segment import segment

DATA = Path(os.environ.get("CICATRIX_DATA", Path(__file__).parents[3] / "shared" / "data"))
RADIUS, CENTRE = 16.2, np.array([1.3, -2.1, 0.7])  # mm, off the voxel grid
CAVITY, CAVITY_CENTRE = 5.0, np.array([2.0, -6.0, 0.0])
HALF_AXES = np.array([18.0, 22.0, 15.0])


def grid(low, high, spacing):
    """Return voxel centres (nz, ny, nx, 3) and an empty volume."""
    low, spacing = np.asarray(low, float), np.asarray(spacing, float)
    n = np.round((np.asarray(high) - low) / spacing).astype(int) + 1
    volume = Volume(np.zeros(n[::-1], np.uint8), tuple(spacing.tolist()), tuple(low.tolist()))
    return volume.position(np.stack(np.indices(volume.shape), axis=-1)), volume


def ball_labels(spacing=(1.0, 1.0, 1.0), radius=RADIUS):
    """Return labels of a ball of fat on a chest that starts 8 mm behind its centre."""
    x, volume = grid([-20, -22, -20], [21, 21, 21], spacing)
    fat = np.linalg.norm(x - CENTRE, axis=-1) < radius
    return volume.with_values(np.where(fat, Label.FAT, np.where(x[..., 1] > 6.0, Label.CHEST, Label.AIR)))


def half_ellipsoid_labels():
    """Return labels of half an ellipsoid (y < 0) that the image cuts off at y = 0."""
    x, volume = grid([-22, -25.5, -19], [22, -0.5, 19], [1.0, 1.0, 1.0])
    return volume.with_values(np.where(np.sum((x / HALF_AXES) ** 2, axis=-1) < 1, Label.FAT, Label.AIR))


def cavity(points):
    return np.linalg.norm(points - CAVITY_CENTRE, axis=-1) - CAVITY


@pytest.fixture(scope="module")
def ball():
    return mesh_body(ball_labels(), 5.0, cavity=cavity, cavity_edge_mm=1.6)


@pytest.fixture(scope="module")
def half_ellipsoid():
    return mesh_body(half_ellipsoid_labels(), 5.0)


def area(mesh, marker):
    return np.linalg.norm(area_vectors(mesh.nodes, mesh.faces[mesh.marker == marker]), axis=1).sum()


def test_lattice_fills_its_box():
    """Twelve tetrahedra per cube (the four of each common face are shared, outer faces have two), angles 45 to 120 degrees."""
    points, tetrahedra = bcc_lattice(np.zeros(3), np.array([4.0, 6.0, 2.0]), 2.0)
    size = volumes(points, tetrahedra)
    assert size.sum() == pytest.approx(48.0, rel=1e-14)
    assert size.min() > 0
    angles = dihedral_angles(points, tetrahedra)
    assert angles.min() == pytest.approx(45.0)
    assert angles.max() == pytest.approx(120.0)
    outer = boundary(tetrahedra)
    assert area_vectors(points, outer).sum(axis=0) == pytest.approx([0, 0, 0], abs=1e-12)
    assert np.linalg.norm(area_vectors(points, outer), axis=1).sum() == pytest.approx(88.0)  # 2 (24 + 12 + 8)


def test_surface_lies_between_voxels():
    """A ball of 16.2 mm in voxels of 1 mm: within 0.5 mm everywhere, 0.1 mm on average; distance and sign also far away."""
    surface = isosurface(segmented_body(ball_labels()).share, 0.8)
    off = np.linalg.norm(surface.points - CENTRE, axis=1) - RADIUS
    assert np.abs(off).max() < 0.5
    assert abs(off.mean()) < 0.1
    x = CENTRE + np.random.default_rng(1).uniform(-15, 15, (400, 3))
    np.testing.assert_allclose(surface.distance(x), np.linalg.norm(x - CENTRE, axis=1) - RADIUS, atol=0.5)
    assert np.abs(surface.distance(x, reach_mm=3.0)).max() <= 3.0


def test_ball_has_its_volume_and_surface(ball):
    """The volume is 4/3 pi r^3 within 1 %, and each skin node is within half a voxel of the sphere."""
    assert volumes(ball.nodes, ball.tetrahedra).sum() == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.01)
    outer = np.unique(ball.faces)
    assert np.abs(np.linalg.norm(ball.nodes[outer] - CENTRE, axis=1) - RADIUS).max() < 0.5
    np.testing.assert_array_equal(np.sort(boundary(ball.tetrahedra), axis=None), np.sort(ball.faces, axis=None))
    assert np.sum((ball.nodes[ball.faces].mean(axis=1) - CENTRE) * area_vectors(ball.nodes, ball.faces)) > 0


def test_cavity_lies_on_faces(ball):
    """No element crosses the sphere, and the volume of the cavity is 4/3 pi 5^3 within 1 %."""
    inside = ball.region == Region.CAVITY
    corners = cavity(ball.nodes)[ball.tetrahedra]
    assert corners[inside].max() < 0.15
    assert corners[~inside].min() > -0.15
    assert volumes(ball.nodes, ball.tetrahedra[inside]).sum() == pytest.approx(4 / 3 * np.pi * CAVITY**3, rel=0.01)
    wall = boundary(ball.tetrahedra[inside])
    assert is_manifold(wall)
    assert n_pieces(wall) == 1
    np.testing.assert_array_equal(np.isin(np.unique(wall), np.unique(ball.tetrahedra[~inside])), True)
    edges = np.linalg.norm(ball.nodes[wall] - ball.nodes[np.roll(wall, 1, axis=1)], axis=-1)
    assert edges.mean() == pytest.approx(1.6, rel=0.25)


def test_chest_wall_is_marked(ball):
    """The chest wall is the part of the sphere with y > 6.5 mm (between last voxel of air and first of chest): 2 pi r h."""
    assert area(ball, Border.WALL) == pytest.approx(2 * np.pi * RADIUS * (RADIUS - (6.5 - CENTRE[1])), rel=0.1)
    assert ball.nodes[ball.constrained_nodes, 1].min() > 3.0
    assert not (ball.marker == Border.CUT).any()


def test_half_ellipsoid_ends_flat_where_the_image_ends(half_ellipsoid):
    """The volume is 2/3 pi abc; the cut is the plane y = 0 with area pi ac, and the wall."""
    a, b, c = HALF_AXES
    mesh = half_ellipsoid
    assert volumes(mesh.nodes, mesh.tetrahedra).sum() == pytest.approx(2 / 3 * np.pi * a * b * c, rel=0.01)
    assert area(mesh, Border.WALL) == pytest.approx(np.pi * a * c, rel=0.02)  # of 20 sides
    np.testing.assert_array_equal(mesh.nodes[mesh.constrained_nodes, 1], 0.0)
    p = 1.6075  # Thomsen's formula for the area, within 1.1 %
    ab, ac, bc = (a * b) ** p, (a * c) ** p, (b * c) ** p
    assert area(mesh, Border.SKIN) == pytest.approx(2 * np.pi * ((ab + ac + bc) / 3) ** (1 / p), rel=0.02)


@pytest.mark.parametrize("name", ["ball", "half_ellipsoid"])
def test_quality_is_measured(name, request):
    mesh = request.getfixturevalue(name)
    assert mesh.quality.faults() == []
    assert mesh.quality.least_dihedral_deg == dihedral_angles(mesh.nodes, mesh.tetrahedra).min() >= 8
    assert mesh.quality.volume == volumes(mesh.nodes, mesh.tetrahedra).sum()
    assert mesh.quality.skin_distance <= mesh.quality.voxel == 1.0


def test_same_bytes_twice(ball):
    again = mesh_body(ball_labels(), 5.0, cavity=cavity, cavity_edge_mm=1.6)
    for field in ("nodes", "tetrahedra", "region", "faces", "marker"):
        assert getattr(again, field).tobytes() == getattr(ball, field).tobytes()
    assert again.quality == ball.quality


def test_partial_voxels_are_used():
    """Tissue fractions in 3 mm voxels locate the surface between voxels: the volume of the ball is correct within 0.5 %."""
    x, _ = grid([-21, -21, -21], [23, 23, 23], [1.0, 1.0, 1.0])
    inside = (np.linalg.norm(x - CENTRE, axis=-1) < RADIUS).astype(float)
    share = inside.reshape(15, 3, 15, 3, 15, 3).mean(axis=(1, 3, 5))
    tissue = Volume(share, (3.0, 3.0, 3.0), (-20.0, -20.0, -20.0))
    labels = tissue.with_values(np.where(share > 0.5, Label.FAT, Label.CHEST))
    body = segmented_body(labels, tissue)
    assert body.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.005)
    off = np.linalg.norm(isosurface(body.share).points - CENTRE, axis=1) - RADIUS
    assert np.abs(off).max() < 0.5


def test_pieces_and_holes_are_noted():
    labels = ball_labels()
    labels.values[1:3, 1:3, 1:3] = Label.SKIN
    labels.values[20, 20, 20] = Label.AIR
    notes = segmented_body(labels).notes
    assert any("the largest of 2 pieces kept; 8 of" in note for note in notes)
    assert any("holes of 1 voxels" in note for note in notes)


def test_thin_parts_are_left_out_and_fine_voxels_averaged():
    labels = ball_labels()
    labels.values[20, 20, 1:] = Label.FAT  # a rod one voxel thick
    thick, coarse = segmented_body(labels, thin_mm=4.0), segmented_body(labels, finest_mm=2.1)
    assert "parts thinner than 4.0 mm left out" in thick.notes[0]
    assert "averaged by 2 x 2 x 2, to 2.00 mm" in coarse.notes[0]
    assert coarse.share.spacing_mm == (2.0, 2.0, 2.0)
    for body in (thick, coarse):
        x = isosurface(body.share, 0.8 * body.share.spacing_mm[0]).points
        assert np.abs(np.linalg.norm(x - CENTRE, axis=1) - RADIUS).max() < body.share.spacing_mm[0]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"edge_mm": 0.0}, "mesh.edge_mm must be above 0 mm; got 0"),
        ({"edge_mm": np.nan}, "mesh.edge_mm must be above 0 mm; got nan"),
        ({"edge_mm": 0.3}, "mesh.edge_mm must be at least 0.49"),
        ({"edge_mm": 25.0}, "mesh.edge_mm must be smaller for this body"),
        ({"cavity": lambda p: np.linalg.norm(p - 90.0, axis=-1) - 5.0}, "cavity lies outside the body"),
        ({"cavity": lambda p: np.linalg.norm(p - CENTRE, axis=-1) - 30.0}, "cavity reaches the surface"),
    ],
)
def test_what_cannot_be_meshed_is_refused(change, sentence):
    with pytest.raises(InputError, match=sentence):
        mesh_body(ball_labels(), **{"edge_mm": 6.0, **change})


def test_labels_that_cannot_be_a_body_are_refused():
    x, empty = grid([-20, -20, -20], [20, 20, 20], [1.0, 1.0, 1.0])
    with pytest.raises(InputError, match="no voxel of the breast"):
        mesh_body(empty, 5.0)
    sheet = empty.with_values(np.where(np.abs(x[..., 0]) < 0.6, Label.FAT, Label.AIR))
    with pytest.raises(InputError, match="thinner than three voxels"):
        mesh_body(sheet, 5.0)
    floating = empty.with_values(np.where(np.linalg.norm(x, axis=-1) < 12, Label.FAT, Label.AIR))
    with pytest.raises(InputError, match=r"neither chest wall .* nor the image's edge"):
        mesh_body(floating, 5.0)
    with pytest.raises(InputError, match="grid of the labels"):
        mesh_body(floating, 5.0, tissue=ball_labels())


def test_gate_refuses_with_its_measures(ball, monkeypatch):
    """Smoothed over 8 mm, the edge of the half-ellipsoid's tip moves by more than a voxel."""
    monkeypatch.setattr(meshing3d, "ATTEMPTS", (Attempt(9.0, 1.0, 2, 0.0), Attempt(8.0, 1.0, 2, 0.0)))
    with pytest.raises(InputError, match=r"tried 2 times, the last with .*skin .* mm off \(at most one voxel, 1.00\)"):
        mesh_body(half_ellipsoid_labels(), 6.0)
    bad = replace(ball.quality, least_volume=-1.0, least_dihedral_deg=3.0, n_pieces=2, is_manifold=False)
    assert len(bad.faults()) == 4


def test_a_second_attempt_is_noted(monkeypatch):
    monkeypatch.setattr(meshing3d, "ATTEMPTS", (Attempt(8.0, 1.0, 2, 0.0), Attempt(0.0, 1.0, 2, 0.0)))
    assert "mm off" in mesh_body(half_ellipsoid_labels(), 6.0).notes[-1]


def test_manifold_means_no_touching():
    """Two tetrahedra that share only a node or an edge are not manifold; separate ones are."""
    first, apart = np.array([[0, 1, 2, 3]]), np.array([[4, 5, 6, 7]])
    for second, answer in ((apart, True), ([[3, 4, 5, 6]], False), ([[2, 3, 4, 5]], False)):
        assert is_manifold(boundary(np.concatenate([first, second]))) is answer
    assert n_pieces(np.concatenate([first, apart])) == 2
    assert n_pieces(np.array([[0, 1, 2, 3], [1, 2, 3, 4]])) == 1


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_the_phantom_with_its_tumour_taken_out(side):
    labels = phantom(spacing_mm=1.5, side=side)[1]
    centre = labels.position(np.argwhere(labels.values == Label.TUMOUR).mean(axis=0))
    mesh = mesh_body(labels, 5.0, cavity=lambda p: np.linalg.norm(p - centre, axis=-1) - 10.0)
    removed = volumes(mesh.nodes, mesh.tetrahedra[mesh.region == Region.CAVITY]).sum()
    assert removed == pytest.approx(4 / 3 * np.pi * 1000, rel=0.01)
    assert set(np.unique(mesh.marker)) == {Border.SKIN, Border.WALL}


@pytest.mark.slow
def test_the_breast_ct_labels():
    path = DATA / "sarno_breastct3_labels_0273.nrrd"
    if not path.exists():
        pytest.skip("the shared image data is not beside the project; set CICATRIX_DATA to its folder")
    mesh = mesh_body(read_labels(path), 4.0)
    print(len(mesh.tetrahedra), mesh.quality, mesh.notes)
    assert mesh.quality.volume == pytest.approx(602.8e3, rel=0.01)  # 465 + 95 + 43 ml
    low = mesh.nodes[mesh.constrained_nodes, 2]
    np.testing.assert_array_equal(low, low[0])  # the cut at the chest is flat


@pytest.mark.slow
def test_a_segmented_mri():
    path = DATA / "mimbcd_A13_t1tse.nii.gz"
    if not path.exists():
        pytest.skip("the shared image data is not beside the project; set CICATRIX_DATA to its folder")
    labels = segment(read_image(path), weighting="t1", side="left").labels
    centre = np.array([72.0, 20.0, -17.6])
    mesh = mesh_body(labels, 5.0, cavity=lambda p: np.linalg.norm(p - centre, axis=-1) - 12.0)
    print(len(mesh.tetrahedra), mesh.quality, mesh.notes)
    assert mesh.quality.faults() == []
    assert (mesh.marker == Border.WALL).mean() > 0.1
