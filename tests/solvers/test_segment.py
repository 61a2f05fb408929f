"""Segmentation, scored on images with known labels."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage as ndi

from cicatrix.cli import segment as verb
from cicatrix.cli.arguments import build_parser
from cicatrix.core.errors import InputError
from cicatrix.files.images import read_image, write_volume
from cicatrix.files.segmentations import read_labels
from cicatrix.geometry.volume import Volume
from cicatrix.image import wall
from cicatrix.image.classify import gland_probability
from cicatrix.image.phantom import phantom
from cicatrix.image.segment import from_labels, segment
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.registry import load_case

DATA = Path(os.environ.get("CICATRIX_DATA", Path(__file__).parents[3] / "shared" / "data"))


def dice(a, b):
    return 2 * (a & b).sum() / (a.sum() + b.sum())


def is_breast(labels):
    return (labels > 0) & (labels < 5)


def is_dense(labels):
    """Return gland and tumour, which are one class without a label map."""
    return (labels == 2) | (labels == 4)


CASES = [
    ("t1", "left", 2.0, 7),
    ("t1-fatsat", "right", 2.0, 8),
    pytest.param("t1", "right", (0.9, 0.9, 2.4), 9, marks=pytest.mark.slow),
    pytest.param("t1-fatsat", "left", (1.0, 1.0, 1.2), 10, marks=pytest.mark.slow),
    pytest.param("t1", "left", 1.5, 11, marks=pytest.mark.slow),
    pytest.param("t1-fatsat", "right", 1.5, 12, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("weighting", "side", "spacing", "seed"), CASES)
def test_phantom_is_found(weighting, side, spacing, seed):
    image, truth = phantom(spacing_mm=spacing, seed=seed, weighting=weighting, side=side)
    found = segment(image, weighting=weighting, side=side)
    labels = found.labels.values
    scores = dice(is_breast(labels), is_breast(truth.values)), dice(is_dense(labels), is_dense(truth.values))
    print(f"{weighting} {spacing} mm seed {seed}: body {scores[0]:.3f}, gland {scores[1]:.3f}")
    assert scores[0] >= 0.98
    assert scores[1] >= 0.9
    assert (labels > 0).sum() == pytest.approx(
        (truth.values > 0).sum(), rel=0.01
    )  # also checks the position of the skin
    total = found.probabilities.values.sum(axis=0)
    np.testing.assert_allclose(total[is_breast(labels)], 1, atol=1e-5)
    assert not total[~is_breast(labels)].any()


def wall_of(labels: Volume) -> np.ndarray:
    """Return the last breast voxel of each column, (nz, nx) [mm]; NaN if there is none."""
    breast = is_breast(labels.values)
    last = labels.shape[1] - 1 - breast[:, ::-1].argmax(axis=1)
    return np.where(breast.any(axis=1), labels.origin_mm[1] + last * labels.spacing_mm[1], np.nan)


@pytest.mark.parametrize(("weighting", "seed"), [("t1", 7), ("t1-fatsat", 8)])
def test_the_contour_settles_nearer_to_the_wall_than_the_search_put_it(weighting, seed, monkeypatch):
    image, truth = phantom(spacing_mm=2.0, seed=seed, weighting=weighting)
    errors, notes = [], []
    for follow in (lambda grid, body, surface, *rest: (surface, False), wall.follow_contour):
        monkeypatch.setattr(wall, "follow_contour", follow)
        found = segment(image, weighting=weighting, side="left")
        errors.append(np.nanmean(np.abs(wall_of(found.labels) - wall_of(truth))))
        notes.append(found.notes[1])
    assert errors[1] < 0.8 * errors[0]
    assert errors[1] < 1.0
    assert "did not converge" in notes[0]
    assert "refined by a localized contour" in notes[1]


def test_same_seed_same_phantom():
    one, two, other = (phantom(spacing_mm=5.0, seed=s) for s in (4, 4, 5))
    assert one[0].values.tobytes() == two[0].values.tobytes()
    assert one[1].values.tobytes() == two[1].values.tobytes()
    assert (one[1].values != other[1].values).any()


def test_phantom_holds_what_it_promises():
    _, labels = phantom(spacing_mm=2.0, seed=6, tumour_diameter_mm=14.0)
    ml = np.bincount(labels.values.ravel(), minlength=6) * 8 / 1000
    assert 0.13 < (ml[2] + ml[4]) / ml[1:5].sum() < 0.27
    assert ml[4] == pytest.approx(4 / 3 * np.pi * 7**3 / 1000, rel=0.25)


@pytest.mark.parametrize("kind", ["noise", "constant", "zero"])
def test_an_image_without_a_breast_is_refused(kind):
    noise = np.random.default_rng(2).rayleigh(5, (40, 50, 60)).astype(np.float32)
    values = {"noise": noise, "constant": np.full_like(noise, 7), "zero": np.zeros_like(noise)}[kind]
    with pytest.raises(InputError, match="no breast found"):
        segment(Volume(values, (3.0, 3.0, 3.0), (0.0, 0.0, 0.0)), weighting="t1", side="left")


def test_given_wall_takes_the_place_of_the_automatic_one():
    image, _ = phantom(spacing_mm=3.0, seed=3)
    plane = {"point_mm": (78.0, -20.0, 0.0), "normal": (0.0, -1.0, 0.0)}
    found = segment(image, weighting="t1", side="left", chest_wall=plane)
    rows = np.flatnonzero(is_breast(found.labels.values).any(axis=(0, 2)))
    assert image.origin_mm[1] + rows[-1] * 3.0 == pytest.approx(-20, abs=3)
    points = [(x, -20.0, z) for x in (20, 140) for z in (-50, 50)]
    same = segment(image, weighting="t1", side="left", chest_wall=points)
    assert dice(is_breast(same.labels.values), is_breast(found.labels.values)) > 0.99


@pytest.mark.parametrize(
    "wall",
    [
        "point_mm = [78.0, -20.0, 0.0]\nnormal = [0.0, -1.0, 0.0]",
        "points_mm = [[20, -20, -50], [140, -20, -50], [20, -20, 50], [140, -20, 50]]",
    ],
)
def test_a_case_hands_its_wall_on(wall, tmp_path):
    (tmp_path / "case.toml").write_text(
        'kind = "lumpectomy"\ndimension = 2\n[image]\nphantom = "half-ellipsoid"\nvoxel_mm = 3.0\n'
        f"[image.chest_wall]\n{wall}\n[trunk]\nmedial_mm = 0\nlateral_mm = 0\nabove_mm = 0\nbelow_mm = 0\n"
    )
    anatomy, notes = anatomy_of(load_case(tmp_path / "case.toml"))
    rows = np.flatnonzero(is_breast(anatomy.labels.values).any(axis=(0, 2)))
    assert anatomy.labels.origin_mm[1] + rows[-1] * 3.0 == pytest.approx(-20, abs=3)
    assert any("given" in note for note in notes)


def test_imported_labels_are_kept_and_a_missing_chest_is_noted():
    _, labels = phantom(spacing_mm=4.0, seed=3)
    cut = labels.with_values(np.where(labels.values == 5, 0, labels.values).astype(np.uint8)[:, :20])
    found = from_labels(cut)
    np.testing.assert_array_equal(found.labels.values, cut.values)
    assert any("no chest label" in note for note in found.notes)


def test_segment_verb_writes_a_whole_folder_or_none(tmp_path):
    image, _ = phantom(spacing_mm=4.0, seed=2)
    write_volume(tmp_path / "image.nii.gz", image)
    parser = build_parser()
    out = tmp_path / "out"
    args = parser.parse_args(["segment", str(tmp_path / "image.nii.gz"), "--out", str(out)])
    assert verb.run(args) == 0
    assert sorted(p.name for p in out.iterdir()) == ["labels.nii.gz", "preview.png", "probabilities.nii.gz"]
    assert read_labels(out / "labels.nii.gz").shape == image.shape
    with pytest.raises(InputError, match="is not empty"):
        verb.run(args)
    write_volume(tmp_path / "empty.nii.gz", image.with_values(np.zeros_like(image.values)))
    args = parser.parse_args(["segment", str(tmp_path / "empty.nii.gz"), "--out", str(tmp_path / "none")])
    with pytest.raises(InputError, match="no breast"):
        verb.run(args)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty.nii.gz", "image.nii.gz", "out"]


@pytest.mark.slow
@pytest.mark.parametrize("weighting", ["t1", "t1-fatsat"])
def test_classes_on_the_breast_ct_labels(weighting):
    """MRI-like image of 1.1 mm from the 0.273 mm labels: partial volume, bias field, Rician noise."""
    path = DATA / "sarno_breastct3_labels_0273.nrrd"
    if not path.exists():
        pytest.skip("the shared image data is not beside the project; set CICATRIX_DATA to its folder")
    fine = read_image(path)
    n = [4 * (k // 4) for k in fine.shape]
    values = fine.values[: n[0], : n[1], : n[2]]
    shape = (n[0] // 4, 4, n[1] // 4, 4, n[2] // 4, 4)
    part = np.stack([(values == k).reshape(shape).mean(axis=(1, 3, 5)) for k in range(4)])
    brightness = {"t1": (0, 900, 300, 360), "t1-fatsat": (0, 50, 150, 190)}[weighting]
    clean = np.tensordot(brightness, part, axes=1)
    z, y, x = (np.linspace(-1, 1, k) for k in clean.shape)
    clean *= np.exp(0.2 * x - 0.15 * y[:, None] * x + 0.1 * z[:, None, None])
    sigma = 20.0 if weighting == "t1" else 5.0
    rng = np.random.default_rng(77)
    image = np.hypot(clean + rng.normal(0, sigma, clean.shape), rng.normal(0, sigma, clean.shape))
    truth = part.argmax(axis=0)
    inside = ndi.binary_fill_holes((truth == 1) | (truth == 2)) & (truth != 3) & (truth != 0)
    volume = Volume(image.astype(np.float32), (1.092, 1.092, 1.092), (0.0, 0.0, 0.0))
    gland = gland_probability(volume, inside, weighting == "t1") > 0.5
    scores = dice(gland & inside, truth == 2), dice(~gland & inside, truth == 1)
    print(f"breast CT {weighting}: gland {scores[0]:.3f}, adipose {scores[1]:.3f}")
    assert scores[0] >= 0.8
    assert scores[1] >= 0.9
