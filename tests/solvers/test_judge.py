"""Segmentations that cannot be those of a breast are refused, with what to give by hand."""

import os
from pathlib import Path

import numpy as np
import pytest
from shared_inputs import FAULTS

from cicatrix.core.errors import InputError
from cicatrix.files.images import read_image, write_volume
from cicatrix.geometry.labels import Label
from cicatrix.geometry.volume import Volume
from cicatrix.image.judge import judge_labels
from cicatrix.image.phantom import phantom
from cicatrix.image.segment import segment
from cicatrix.kinds.lumpectomy.anatomy import anatomy_of
from cicatrix.kinds.registry import load_case

SHARED = Path(__file__).parents[3] / "shared"
DATA = Path(os.environ.get("CICATRIX_DATA", SHARED / "data"))


@pytest.fixture(scope="module")
def made():
    """Return image and labels of a left breast of about 540 ml, alone in its image."""
    return phantom(spacing_mm=4.0, seed=2)


def turned(image: Volume, values: np.ndarray, spacing=None) -> Volume:
    return Volume(np.ascontiguousarray(values), spacing or image.spacing_mm, image.origin_mm)


WRONG = {
    "the other side": (lambda image: image, {"side": "right"}, r"as if this were the other breast; check image\.side"),
    "front to back": (lambda image: turned(image, image.values[:, ::-1]), {}, r"front edge cuts .* give image\.axes"),
    "head to front": (lambda image: turned(image, image.values.transpose(1, 0, 2)), {}, r"give image\.axes"),
    "fat-saturated for T1": (
        lambda image: image,
        {"weighting": "t1-fatsat"},
        r"fat is not equally .* image\.weighting",
    ),
    "spacing lost": (lambda image: turned(image, image.values, (1.7, 1.7, 1.7)), {}, "check the voxel size"),
    "cut before the wall": (lambda image: turned(image, image.values[:, :14]), {}, r"image\.labels"),
    "wall given too far back": (
        lambda image: image,
        {"chest_wall": {"point_mm": (78.0, 40.0, 0.0), "normal": (0.0, -1.0, 0.0)}},
        r"(1\.00, .*) .* give image\.chest_wall",
    ),
    "wall given behind the image": (
        lambda image: image,
        {"chest_wall": {"point_mm": (78.0, 90.0, 0.0), "normal": (0.0, -1.0, 0.0)}},
        "ends before the chest wall behind",
    ),
}


SLOW = ("head to front", "wall given behind the image")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in WRONG])
def test_a_wrong_segmentation_is_refused(made, name):
    change, options, says = WRONG[name]
    with pytest.raises(InputError, match=says) as caught:
        segment(change(made[0]), **{"weighting": "t1", "side": "left"} | options)
    assert str(caught.value).startswith("image: ")


def breast_of(ml: float, shape=(20, 20, 20)) -> Volume:
    """Return a label map in which a block of fat, clear of the edges, has a volume of ``ml``."""
    values = np.zeros(shape, np.uint8)
    values[5:15, 5:15, 5:15] = Label.FAT
    values[5:15, 15:18, 5:15] = Label.CHEST
    edge = (ml * 1000 / 1000) ** (1 / 3)  # a block of 1000 voxels
    return Volume(values, (edge, edge, edge), (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("ml", "fits"), [(0.5, False), (49, False), (51, True), (3900, True), (4100, False), (5e8, False)]
)
def test_labels_by_hand_have_the_volume_of_a_breast(ml, fits):
    if fits:
        assert not list(judge_labels(breast_of(ml)))
    else:
        with pytest.raises(InputError, match="and a breast has 50 to 4000 ml; check the voxel size"):
            list(judge_labels(breast_of(ml)))


def test_a_slab_of_labels_may_be_thin_and_a_cut_breast_is_said():
    whole = breast_of(400)
    slab = turned(whole, whole.values[8:10])
    assert not list(judge_labels(slab))
    cut = turned(whole, whole.values[:, :15, :])
    assert list(judge_labels(cut)) == ["no chest label; the breast touches the image at y high"]
    cut.values[0, -1, 0] = Label.CHEST
    assert list(judge_labels(cut)) == ["behind 100 % of the breast the image ends before the chest wall"]


CASE = """kind = "lumpectomy"
dimension = 2
[image]
path = "image.nii.gz"
labels = "labels.nii.gz"
{names}
[resection]
centre_mm = [70.0, -40.0, 0.0]
"""


def test_labels_lie_in_their_image_by_position(made, tmp_path):
    """The label map is a part of the image on its own grid; moved by 400 mm it belongs to another one."""
    image, labels = made
    write_volume(tmp_path / "image.nii.gz", image)
    part = Volume(labels.values[3:-3, :, 6:], labels.spacing_mm, tuple(labels.position(np.array([3, 0, 6]))))
    write_volume(tmp_path / "labels.nii.gz", part)
    (tmp_path / "case.toml").write_text(CASE.format(names=""))
    case = load_case(tmp_path / "case.toml")
    anatomy, notes = anatomy_of(case)
    assert anatomy.labels.shape == part.shape
    assert not any("outside" in note for note in notes)
    moved = Volume(part.values, part.spacing_mm, (part.origin_mm[0] + 400, *part.origin_mm[1:]))
    write_volume(tmp_path / "labels.nii.gz", moved)
    with pytest.raises(InputError, match=r"image\.labels: 0 % of the labelled breast lie in the image"):
        anatomy_of(case)
    shifted = Volume(part.values, part.spacing_mm, (part.origin_mm[0] + 60, *part.origin_mm[1:]))
    write_volume(tmp_path / "labels.nii.gz", shifted)
    assert any("lie outside of the image" in note for note in anatomy_of(case)[1])


def test_a_case_gives_the_tissue_of_labels(made, tmp_path):
    image, labels = made
    write_volume(tmp_path / "image.nii.gz", image)
    swapped = labels.with_values(np.array([0, 2, 1, 3, 4, 9], np.uint8)[labels.values])
    write_volume(tmp_path / "labels.nii.gz", swapped)
    names = '[image.label_names]\n"1" = "gland"\n"2" = "fat"\n"9" = "chest"'
    (tmp_path / "case.toml").write_text(CASE.format(names=names))
    anatomy, notes = anatomy_of(load_case(tmp_path / "case.toml"))
    np.testing.assert_array_equal(anatomy.labels.values, labels.values)
    assert "labels by value: 1 is gland, 2 is fat, 9 is chest" in notes


@pytest.mark.parametrize(
    ("names", "says"),
    [
        ('[image.label_names]\n"1" = "bone"', r'image\.label_names\.1 must be .*"gland".*; got "bone"'),
        ('label_names = "gland"', r'image\.label_names must be a table; got "gland"'),
    ],
)
def test_label_names_name_tissues(case_file, tmp_path, names, says):
    for name in ("image.nii.gz", "labels.nii.gz"):
        (tmp_path / name).touch()
    with pytest.raises(InputError, match=says):
        load_case(case_file(CASE.format(names=names)))


@pytest.mark.skipif(not FAULTS.exists(), reason="the shared folder is not beside the project")
def test_shared_cases_on_the_wrong_side_are_refused_and_those_with_labels_are_read():
    folder = FAULTS / "toml"
    with pytest.raises(InputError, match="as if this were the other breast"):
        anatomy_of(load_case(folder / "otherside.toml"))
    assert "labels imported" in anatomy_of(load_case(folder / "labels_small.toml"))[1]


@pytest.mark.slow
@pytest.mark.skipif(
    not DATA.exists(), reason="the shared image data is not beside the project; set CICATRIX_DATA to its folder"
)
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("name", "weighting", "right"),
    [
        ("A13_t1tse", "t1", True),
        ("A13_t1fs_pre", "t1-fatsat", True),
        ("A13_t1fs_post", "t1-fatsat", True),
        ("A25_t1fs", "t1-fatsat", True),
        ("full_d9e7d915", "t1-fatsat", True),
        ("full_540c8ee4", "t1-fatsat", False),  # the midline between the breasts is missed
        ("full_3a7ea86f", "t1-fatsat", False),
    ],
)
def test_real_images_read_right_pass_and_those_read_wrong_are_refused(name, weighting, right, side):
    image = read_image(DATA / f"mimbcd_{name}.nii.gz")
    if right:
        segment(image, weighting=weighting, side=side)
    else:
        with pytest.raises(InputError, match="and a breast has 50 to 4000 ml"):
            segment(image, weighting=weighting, side=side)
