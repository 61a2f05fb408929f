"""A complete lumpectomy run in 3-D on a coarse half ball of fat: to closure, and resumed half-way.

The healing position is that of the image, so that only the unloading has large displacements; the slow test also uses
standing and lying positions.
"""

import json
import shutil

import meshio
import numpy as np
import pytest
from coarse_lumpectomy import STIFF_TISSUE

import cicatrix
from cicatrix.core.errors import InputError
from cicatrix.files.images import write_volume
from cicatrix.geometry.labels import Label
from cicatrix.geometry.volume import Volume
from cicatrix.kinds.lumpectomy import body
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.lumpectomy.build import breast_model
from cicatrix.runs.progress import Progress
from cicatrix.runs.results import open_run

pytestmark = pytest.mark.xdist_group("solid road")  # healed once

CASE = f"""
kind = "lumpectomy"
dimension = 3
[image]
labels = "labels.nii.gz"
[resection]
radius_mm = 8.0
[healing]
pitch_um = 500.0
p_layer = 0.02
[mesh]
edge_mm = 12.0
cavity_edge_mm = 5.0
[coupling]
days_per_cycle = 63.0
healing_position = "prone"
[solver]
relative_tolerance = 1e-6
[outcome]
positions = ["prone"]
visits_weeks = []
{STIFF_TISSUE}
"""
RADIUS, VOXEL = 30.0, 2.0  # mm


def half_ball(tumour=True, apart=False, radius=RADIUS):
    """Return a breast of fat in front of the last plane of the image, with a tumour of 4 mm."""
    n = int(np.ceil((radius + 6) / VOXEL))
    across, depth = VOXEL * (np.arange(2 * n + 1) - n), VOXEL * (np.arange(n) - n + 0.5)
    z, y, x = np.meshgrid(across, depth, across, indexing="ij")
    labels = np.where(x**2 + y**2 + z**2 < radius**2, Label.FAT, Label.AIR).astype(np.uint8)
    if tumour:
        labels[x**2 + (y + 13.5) ** 2 + z**2 < 4.0**2] = Label.TUMOUR
    if apart:
        labels[:, -4:] = Label.AIR
    return Volume(labels, (VOXEL,) * 3, (across[0], depth[0], across[0]))


def case_in(folder, labels, *overrides):
    write_volume(folder / "labels.nii.gz", labels)
    (folder / "case.toml").write_text(CASE)
    return cicatrix.load_case(folder / "case.toml", overrides)


class Snapshot(Progress):
    """Progress that copies the run's folder when the wound is half closed."""

    def __init__(self, folder, copy):
        super().__init__()
        self.folder, self.copy = folder, copy

    def update(self, fraction, text=""):
        if text.startswith("day") and fraction > 0.5 and not self.copy.exists():
            shutil.copytree(self.folder, self.copy)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Return the folder of a run and its copy from half-way."""
    folder = tmp_path_factory.mktemp("solid")
    case = case_in(folder, half_ball())
    cicatrix.simulate(case, folder / "run", progress=Snapshot(folder / "run", folder / "half"))
    return case, folder / "run", folder / "half"


@pytest.fixture(scope="module")
def results(folders):
    return open_run(folders[1])


def products(out):
    files = [out / "history.csv", out / "outcome.json", *sorted((out / "fields").iterdir())]
    files += sorted((out / "surfaces").iterdir())
    return {f.name: f.read_bytes() for f in files}


def test_the_wound_closes(results):
    history = results.history
    assert history["closed_fraction"][-1] == 1.0
    assert (np.diff(history["closed_fraction"]) > 0).all()
    assert history["open_volume_mm3"][0] == pytest.approx(4 / 3 * np.pi * 8.0**3, rel=0.02)
    assert history["wound_area_mm2"][0] == pytest.approx(4 * np.pi * 8.0**2, rel=0.03)
    assert history["open_volume_mm3"][-1] == history["wound_area_mm2"][-1] == 0
    assert results.outcome["time_to_closure_days"].value < 200
    assert results.outcome["surface_retraction_max_mm"].value < 1


def test_the_healed_body_weighs_what_it_weighed(results):
    """Tissue and open sites together have the volume of the body, 2/3 pi 30^3 by hand, to the resolution of the voxels."""
    assert results.history["tissue_volume_mm3"][-1] == pytest.approx(2 / 3 * np.pi * RADIUS**3, rel=0.015)


def test_resumed_is_uninterrupted(folders):
    case, whole, half = folders
    assert not (half / "outcome.json").exists()
    cicatrix.simulate(case, half, resume=True)
    assert products(half) == products(whole)


def test_surfaces_open_elsewhere(folders):
    """STL and VTU of the skin have the same closed shape with outward normals."""
    _, run, _ = folders
    flat, curved = (meshio.read(run / "surfaces" / f"prone-healed.{kind}") for kind in ("stl", "vtu"))
    corners = flat.points[flat.cells_dict["triangle"]]
    volume = np.einsum("ki,ki->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume == pytest.approx(2 / 3 * np.pi * RADIUS**3, rel=0.02)
    assert 4 * len(curved.cells_dict["triangle6"]) == len(corners)
    assert np.abs(curved.point_data["retraction_mm"]).max() < 1
    held = np.abs(curved.points[:, 1]) < 1e-6
    np.testing.assert_array_equal(curved.point_data["displacement"][held], 0)


def test_fields_and_pictures_are_there(folders):
    _, run, _ = folders
    mesh = meshio.read(run / "fields" / "body-0000.vtu")
    assert set(mesh.cells_dict) == {"tetra10"}
    assert np.ptp(mesh.cell_data_dict["filled_fraction"]["tetra10"]) == 1
    for name in ("section", "closure", "surface", "energy"):
        assert (run / "figures" / f"{name}.png").stat().st_size > 20_000
    notes = json.loads((run / "manifest.json").read_text())["notes"]
    assert any("tetrahedra, least angle" in note for note in notes)


@pytest.mark.parametrize(
    ("at", "words"),
    [((0, -40, 0), r"it lies (9|10)\."), ((22, -22, 0), None)],
    ids=["off the skin", "beside the foremost point"],
)
def test_a_nipple_can_be_given(tmp_path, at, words, monkeypatch):
    """The nearest node of the skin is used; a point off the skin is refused before anything is solved."""
    monkeypatch.setattr(body, "MAX_NIPPLE_DISTANCE_MM", 5.0)
    case = case_in(tmp_path, half_ball(), f"outcome.nipple_mm={list(at)}")
    anatomy, _ = anatomy_of(case)
    if words:
        with pytest.raises(InputError, match=words):
            breast_model(case, anatomy)
    else:
        model = breast_model(case, anatomy)
        np.testing.assert_allclose(model.x_imaged[model.nipple], (21.2, -21.2, 0), atol=4)


@pytest.mark.slow
def test_standing_and_lying_down(tmp_path):
    """With two positions and a visit, the breast hangs down and sinks back, and the wound closes."""
    overrides = [
        'coupling.healing_position="upright"',
        'outcome.positions=["upright", "supine"]',
        "coupling.days_per_cycle=31.5",
    ]
    case = case_in(tmp_path, half_ball(), *overrides, "outcome.visits_weeks=[5]")
    results = cicatrix.simulate(case, tmp_path / "run")
    assert results.history["closed_fraction"][-1] == 1.0
    surfaces = {p: meshio.read(tmp_path / "run" / "surfaces" / f"{p}-before.vtu").points for p in ("upright", "supine")}
    assert (surfaces["upright"] - surfaces["supine"])[:, 2].mean() < -0.2  # down
    foremost = {position: points[:, 1].min() for position, points in surfaces.items()}
    assert foremost["upright"] < foremost["supine"] - 0.2  # and anterior
    assert abs(results.outcome["upright.week_5.volume_change_percent"].value) < 1
    for position in ("upright", "supine"):
        assert 0 <= results.outcome[f"{position}.healed.surface_retraction_max_mm"].value < 1


FAULTS = {
    "nothing supports it": (half_ball(apart=True, radius=40.0), ["mesh.edge_mm=6.0"], "nothing supports it"),
    "no tumour": (half_ball(tumour=False), [], "resection.centre_mm is missing"),
    "outside": (
        half_ball(),
        ["resection.centre_mm=[0, -50, 0]"],
        "must lie inside the breast; (0.0, -50.0, 0.0) mm does not",
    ),
    "at the skin": (half_ball(), ["resection.centre_mm=[0, -28.5, 0]"], "must lie at least 3 mm inside the breast"),
    "too large": (half_ball(), ["resection.radius_mm=33.0"], "where the largest ball has a radius of"),
    "no breast": (half_ball().with_values(np.full(half_ball().shape, 5, np.uint8)), [], "no voxel of the breast"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_one_fault_one_sentence_and_no_folder(name, tmp_path):
    labels, overrides, words = FAULTS[name]
    with pytest.raises(InputError) as error:
        cicatrix.simulate(case_in(tmp_path, labels, *overrides), tmp_path / "run")
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "run").exists()
