"""Phantoms saved in the ways that public reports describe read right or are refused; damage is a sentence; no name leaks."""

import contextlib
import json
import random
import tarfile

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
from dicom_phantoms import BODY, enhanced, save, series
from shared_inputs import FAULTS

from cicatrix.cases.reading import case_table, input_files
from cicatrix.core.errors import InputError
from cicatrix.files.bare_names import bare_name
from cicatrix.files.images import read_image
from cicatrix.kinds.registry import load_case
from cicatrix.runs.manifest import new_manifest

PHANTOMS = FAULTS / "images" / "failing_images.tgz"


@pytest.fixture(scope="module")
def phantoms(tmp_path_factory):
    if not PHANTOMS.exists():
        pytest.skip("the phantoms of failing images are not beside the project")
    folder = tmp_path_factory.mktemp("phantoms")
    with tarfile.open(PHANTOMS) as archive:
        archive.extractall(folder, filter="data")
    return folder


@pytest.mark.parametrize(
    ("name", "notes"),
    [
        ("dcm_slopes_small", []),
        ("enh_scrambled.dcm", []),
        ("enh_slopes.dcm", []),
        ("dcm_enh", []),
        ("dcm_scout", ["Left out: 1 of 50 slices"]),
        ("dcm_jitter", []),
        ("dcm_nopreamble", []),
        ("inter_neg.nii.gz", ["Air lies below 0 in the image"]),
        ("slope_small.nii.gz", ["Air lies below 0 in the image"]),
    ],
)
def test_phantoms_read_as_the_one_that_is_right(phantoms, name, notes):
    said = []
    truth = read_image(phantoms / "dcm_enh" / "enh.dcm")
    volume = read_image(phantoms / name, note=said.append)
    assert [note.startswith(start) for note, start in zip(said, notes, strict=True)] == [True] * len(notes)
    assert volume.shape == truth.shape == (49, 45, 64)
    assert volume.spacing_mm == pytest.approx((3.0, 3.0, 3.0), abs=1e-3)
    assert volume.origin_mm == pytest.approx(truth.origin_mm, abs=0.05)
    found, right = volume.values[1:], truth.values[1:]  # one file has the first slice in whole numbers from 0 to 1
    assert np.corrcoef(found.ravel(), right.ravel())[0, 1] > 0.9999  # scales differ, and rounding in the files


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("dcm_tilt", "sheared by 18.4 degrees"),
        ("dcm_sag_two", "say which side"),
        ("qs_shift.nii.gz", "sform (code 2) puts the first voxel at -56.5, -64.5, -11.5 mm"),
        ("nocodes.nii.gz", "how the image lies in the patient"),
        ("nospacing.nrrd", "no size of a voxel"),
        ("metres.nrrd", "the image is 0.19 mm wide (0.192 x 0.135 x 0.147 mm), a body part 20 to 800 mm: metres?"),
        ("nounits_metres.nii.gz", "the image is 0.19 mm wide"),
        ("pair.hdr", "1 of 141120 voxels are NaN"),
        ("pair.img", "1 of 141120 voxels are NaN"),
    ],
)
def test_phantoms_that_cannot_be_told_are_refused(phantoms, name, says):
    with pytest.raises(InputError) as caught:
        read_image(phantoms / name)
    assert says in str(caught.value)


def test_the_name_of_a_folder_or_file_is_in_no_output(tmp_path):
    folder = save(tmp_path / "Doe^Jane", series())
    sitk.WriteImage(sitk.GetImageFromArray(BODY), str(tmp_path / "Doe^Jane.nii.gz"))
    (tmp_path / "case.toml").write_text(
        'kind = "lumpectomy"\n[image]\npath = "Doe^Jane"\nlabels = "Doe^Jane.nii.gz"\n'
        "[resection]\ncentre_mm = [0, 0, 0]\nradius_mm = 5\n",
        encoding="utf-8",
    )
    case = load_case(tmp_path / "case.toml")
    manifest = new_manifest(case_table(case), 1, input_files(case), {})
    assert "Doe" not in json.dumps(manifest)
    assert manifest["case"]["image"]["path"] == manifest["inputs"]["image.path"]["name"] == "DICOM folder, 8 files"
    assert manifest["inputs"]["image.labels"]["name"] == "NIfTI image"
    (tmp_path / "scan.Doe^Jane").write_bytes((folder / "im000.dcm").read_bytes())
    assert bare_name(tmp_path / "scan.Doe^Jane") == "DICOM image"
    assert bare_name(tmp_path / "other.Doe^Jane") == "file"
    (tmp_path / "Jane").mkdir()
    assert bare_name(tmp_path / "Jane") == "folder, 0 files"


def damaged(raw, rng):
    """Return bytes with one to eight changes, most of them in the header."""
    raw = bytearray(raw)
    for _ in range(rng.choice([1, 1, 2, 8])):
        at = rng.randrange(min(len(raw), 1200)) if rng.random() < 0.8 else rng.randrange(len(raw))
        kind = rng.randrange(5)
        if kind == 0:
            raw[at] = rng.randrange(256)
        elif kind == 1:
            raw[at : at + 4] = rng.choice([b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff", b"\0\0\xc0\x7f"])
        elif kind == 2:
            del raw[at : at + rng.randrange(1, min(20, len(raw)))]
        elif kind == 3:
            raw[at:at] = rng.randbytes(rng.randrange(1, 20))
        elif rng.random() < 0.2:
            del raw[at + 1 :]
    return bytes(raw)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["nii", "nii.gz", "nrrd", "mha", "enhanced", "classic"])
def test_damaged_files_are_read_or_end_in_a_sentence(tmp_path, ending):
    if ending in ("enhanced", "classic"):
        folder = save(tmp_path / "s", [enhanced()] if ending == "enhanced" else series())
        file, target = folder / "im000.dcm", folder
    else:
        made = sitk.GetImageFromArray(BODY)
        made.SetSpacing((3.0, 3.0, 3.0))
        file = target = tmp_path / f"a.{ending}"
        sitk.WriteImage(made, str(file), useCompression=ending in ("nii.gz", "mha"))
    right, rng = file.read_bytes(), random.Random(3)
    for _ in range(200):
        file.write_bytes(damaged(right, rng))
        with contextlib.suppress(InputError):
            volume = read_image(target)
            assert np.isfinite(volume.values).all()
            assert 20 <= max(n * edge for n, edge in zip(volume.shape[::-1], volume.spacing_mm)) <= 1200
