"""Cutting and meshing a section: axes, conversion of positions, a conforming cavity, named borders, refusals."""

import signal

import numpy as np
import pytest

from cicatrix.core.errors import InputError
from cicatrix.core.posix_signals import TAKEN
from cicatrix.geometry.borders import Border
from cicatrix.geometry.labels import TISSUES, Label
from cicatrix.geometry.meshing import label_borders, mesh_section
from cicatrix.geometry.section import Section
from cicatrix.geometry.volume import Volume
from cicatrix.kinds.lumpectomy.build import breast_model
from cicatrix.kinds.lumpectomy.case import ImageTable, LumpectomyCase, MeshTable, OutcomeTable, ResectionTable

RADIUS, CAVITY, CENTRE = 20.0, 8.0, np.array([0.0, -10.0])


def half(p):
    """Return the signed distance of a half-disc y < 0."""
    return np.maximum(np.hypot(*p.T) - RADIUS, p[:, 1])


def disc(p):
    return np.hypot(*(p - CENTRE).T) - CAVITY


@pytest.fixture(scope="module")
def mesh():
    box = np.array([-RADIUS, -RADIUS]), np.array([RADIUS, 0.0])
    return mesh_section(half, disc, *box, edge_mm=5.0, cavity_edge_mm=1.0)


def areas(mesh):
    a, b, c = mesh.p[:, mesh.t].transpose(1, 2, 0)
    return 0.5 * np.abs(np.cross(np.pad(b - a, ((0, 0), (0, 1))), np.pad(c - a, ((0, 0), (0, 1))))[:, 2])


@pytest.mark.parametrize("plane", ["axial", "sagittal"])
def test_axes_are_right_handed(plane):
    section = Section(plane, 3.0)
    first, second, normal = np.eye(3)[list(section.axes)]
    np.testing.assert_array_equal(np.cross(first, second), normal)
    points = np.random.default_rng(0).standard_normal((5, 2))
    there = section.to_patient(points)
    np.testing.assert_array_equal(section.from_patient(there), np.column_stack([points, np.full(5, 3.0)]))


def test_pixels_lie_where_they_say():
    volume = Volume(np.zeros((4, 6, 8)), (1.0, 2.0, 3.0), (10.0, -20.0, 5.0))
    raster = Section("axial", 6.0).raster(volume, 0.5)
    assert raster.points[0, 0].tolist() == [10.0, -20.0]
    np.testing.assert_allclose(raster.index(raster.points[3, 5]), [3, 5])
    with pytest.raises(InputError, match="slice_mm must lie inside the image"):
        Section("axial", 60.0).raster(volume, 0.5)
    with pytest.raises(InputError, match="plane must be one of axial, sagittal; got frontal"):
        Section("frontal", 0.0)


def test_cavity_conforms(mesh):
    """No element crosses the border; the areas of cavity and body are pi 8^2 and pi 20^2 / 2, each within 1 %."""
    inside = np.zeros(mesh.nelements, bool)
    inside[mesh.subdomains["cavity"]] = True
    corners = disc(mesh.p.T)[mesh.t]
    assert corners[:, inside].max() < 0.1
    assert corners[:, ~inside].min() > -0.1
    assert areas(mesh)[inside].sum() == pytest.approx(np.pi * CAVITY**2, rel=0.01)
    assert areas(mesh).sum() == pytest.approx(np.pi * RADIUS**2 / 2, rel=0.01)


def test_borders_have_names(mesh):
    """The flat side is wall and the round one skin, 40 mm and pi 20 mm long."""
    named = label_borders(mesh, lambda p: np.where(p[:, 1] > 0.0, Border.WALL, Border.SKIN))

    def length(name):
        ends = mesh.p[:, mesh.facets[:, named.boundaries[name]]]
        return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=0).sum()

    assert length("wall") == pytest.approx(2 * RADIUS, rel=0.03)
    assert length("skin") == pytest.approx(np.pi * RADIUS, rel=0.03)


def test_same_bytes_twice(mesh):
    box = np.array([-RADIUS, -RADIUS]), np.array([RADIUS, 0.0])
    again = mesh_section(half, disc, *box, edge_mm=5.0, cavity_edge_mm=1.0)
    assert again.p.tobytes() == mesh.p.tobytes()
    assert again.t.tobytes() == mesh.t.tobytes()


def test_an_empty_section_is_refused():
    box = np.array([-5.0, -5.0]), np.array([5.0, 5.0])
    with pytest.raises(InputError, match="holds no breast"):
        mesh_section(lambda p: np.ones(len(p)), None, *box, edge_mm=5.0, cavity_edge_mm=1.5)


def case_of(slice_mm=None, nipple_mm=None, **resection):
    return LumpectomyCase(
        image=ImageTable(labels="not-read.nii", slice_mm=slice_mm),
        outcome=OutcomeTable(nipple_mm=nipple_mm),
        resection=ResectionTable(**resection),
        mesh=MeshTable(edge_mm=8.0, cavity_edge_mm=4.0),
    )


@pytest.mark.parametrize(
    ("phantom", "case", "sentence"),
    [
        ({}, case_of(centre_mm=(60.0, -10.0, 0.0), radius_mm=5.0), "resection.centre_mm must lie inside the breast"),
        ({}, case_of(centre_mm=(0.0, -29.0, 0.0), radius_mm=5.0), "at least 3 mm inside the breast"),
        ({}, case_of(radius_mm=28.0), "resection.radius_mm must be smaller than the breast"),
        ({}, case_of(slice_mm=4.0, centre_mm=(0.0, -13.0, -2.0), radius_mm=5.0), "does not cut the cavity"),
        ({}, case_of(radius_mm=5.0, nipple_mm=(0.0, -50.0, 0.0)), r"outcome.nipple_mm .* it lies 20\.\d mm from it"),
        ({"tumour": False}, case_of(radius_mm=5.0), "resection.centre_mm is missing and the labels have no tumour"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(half_disc, phantom, case, sentence):
    with pytest.raises(InputError, match=sentence):
        breast_model(case, half_disc(**phantom))


def test_a_breast_without_a_chest_wall_is_refused(half_disc):
    """The image has chest elsewhere, but none behind this breast."""
    anatomy = half_disc(chest=False)
    anatomy.labels.values[0, -1, 0] = Label.CHEST
    with pytest.raises(InputError, match="touches no chest wall"):
        breast_model(case_of(radius_mm=5.0), anatomy)


def test_the_plan_of_a_half_disc(half_disc):
    """The wall is flat and the skin round; the cavity lies around the tumour; the nipple is the most anterior point."""
    model = breast_model(case_of(radius_mm=7.0), half_disc())
    np.testing.assert_allclose(model.centre_mm, [0.0, -13.0, 0.0], atol=0.5)
    inside = areas(model.mesh)[model.cavity].sum()
    assert model.margin_mm(half_disc()) == pytest.approx(3.5, abs=1.5)  # 7 mm around a ball of 3.5 mm in 2 mm voxels
    assert model.margin_mm(half_disc(tumour=False)) == np.inf
    assert inside == pytest.approx(np.pi * 49, rel=0.03)  # of eleven sides
    X = model.x_imaged
    assert np.abs(X[model.intact.discretization.fixed_nodes, 1]).max() < 2.0
    assert X[model.outline[model.nipple], 1] == pytest.approx(-30.0, abs=1.0)
    assert abs(X[model.outline[model.nipple], 0]) < 4.0
    assert len(set(model.outline.tolist())) == len(model.outline)


def test_a_nipple_that_is_given_is_the_nearest_point_of_the_skin(half_disc):
    """A nipple given at 45 degrees beside the most anterior point, 3 mm in front of the skin and off the section."""
    model = breast_model(case_of(radius_mm=7.0, nipple_mm=(23.3, -23.3, 2.0)), half_disc())
    X = model.x_imaged[model.outline[model.nipple], :2]
    np.testing.assert_allclose(X, [21.2, -21.2], atol=2.5)  # points lie 4 mm apart


def test_skin_weighs_and_bears_no_load_in_the_bulk(half_disc):
    """Where a voxel is half skin, density is the mean of both tissues, and stiffness is that of the rest."""
    anatomy = half_disc(tumour=False)
    inside = anatomy.labels.values == Label.FAT
    anatomy.probabilities.values[TISSUES.index(Label.FAT)][inside] = 0.5
    anatomy.probabilities.values[TISSUES.index(Label.SKIN)][inside] = 0.5
    tissue = breast_model(case_of(centre_mm=(0.0, -13.0, 0.0), radius_mm=7.0), anatomy).tissue
    deep = np.abs(tissue.density - tissue.density.max()) < 1e-12
    assert deep.mean() > 0.5
    assert tissue.density.max() == pytest.approx(0.5 * (930 + 1090) * 1e-9, rel=1e-3)
    np.testing.assert_allclose(tissue.mu, 0.3 / (2 * 1.495), rtol=1e-6)


def test_signals_are_heard_after_meshing():
    """MMG installs its own signal handlers, which would end the process here."""
    heard, box = [], (np.array([-RADIUS, -RADIUS]), np.array([RADIUS, 0.0]))
    before = {number: signal.signal(number, lambda n, _: heard.append(n)) for number in TAKEN}
    try:
        mesh_section(half, None, *box, edge_mm=8.0, cavity_edge_mm=4.0)
        for number in TAKEN:
            signal.raise_signal(number)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert heard == list(TAKEN)
