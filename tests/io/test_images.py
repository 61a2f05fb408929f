"""Images of every orientation are read to the same positions; every bad file gives a one-sentence error."""

import gzip
import os
import zipfile
from pathlib import Path

import numpy as np
import pydicom
import pytest
import SimpleITK as sitk  # noqa: N813 - the name its own manual uses

from cicatrix.core.errors import InputError
from cicatrix.files.images import read_image, write_volume
from cicatrix.files.segmentations import read_labels
from cicatrix.geometry.volume import Volume

DATA = Path(os.environ.get("CICATRIX_DATA", Path(__file__).parents[3] / "shared" / "data"))


def smooth(points):
    """Return a smooth intensity at points (..., 3) [mm]."""
    x, y, z = np.moveaxis(points, -1, 0)
    return 100 + 30 * np.sin(x / 9) + 20 * np.cos(y / 11) + 10 * np.sin(z / 8)


def stored(direction, size=(24, 20, 16), spacing=(1.0, 1.5, 2.0), origin=(5.0, -7.0, 3.0)):
    """Store an image of `smooth` with the given direction cosines."""
    image = sitk.Image(size, sitk.sitkFloat32)
    image.SetDirection(np.asarray(direction, float).ravel().tolist())
    image.SetSpacing(spacing)
    image.SetOrigin(origin)
    index = np.stack(np.meshgrid(*[np.arange(n) for n in size], indexing="ij"), axis=-1)
    points = (index * spacing) @ np.asarray(direction, float).T + origin
    filled = sitk.GetImageFromArray(smooth(points).transpose(2, 1, 0).astype(np.float32))
    filled.CopyInformation(image)
    return filled


def tilted(degrees):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


@pytest.mark.parametrize(
    "direction",
    [np.eye(3), np.diag([-1, -1, 1]), np.eye(3)[[2, 0, 1]], -np.eye(3)[[1, 2, 0]], tilted(12)],
    ids=["LPS", "RAS", "permuted", "permuted-flipped", "oblique"],
)
@pytest.mark.parametrize("ending", [".nii.gz", ".nrrd", ".mha"])
def test_any_orientation_reads_to_the_same_place(tmp_path, direction, ending):
    path = tmp_path / f"image{ending}"
    image = stored(direction)
    sitk.WriteImage(image, str(path))
    volume = read_image(path)
    index = np.random.default_rng(3).uniform(4, np.array(image.GetSize()) - 5, size=(200, 3))
    points = np.array([image.TransformContinuousIndexToPhysicalPoint(i.tolist()) for i in index])
    np.testing.assert_allclose(volume.sample(points), smooth(points), atol=1.5)  # linear interpolation


def test_write_then_read_keeps_voxels_and_geometry(tmp_path):
    volume = Volume(np.arange(60, dtype=np.float32).reshape(3, 4, 5), (5.0, 10.0, 20.0), (-3.0, 4.0, 5.0))
    write_volume(tmp_path / "v.nii.gz", volume)
    again = read_image(tmp_path / "v.nii.gz")
    np.testing.assert_array_equal(again.values, volume.values)
    assert again.spacing_mm == pytest.approx(volume.spacing_mm)
    assert again.origin_mm == pytest.approx(volume.origin_mm)


def save(path, values, **kw):
    image = sitk.GetImageFromArray(values, **kw)
    image.SetSpacing([10.0] * image.GetDimension())
    sitk.WriteImage(image, str(path))
    return path


def missing(folder):
    return folder / "none.nii.gz"


def truncated(folder):
    path = save(folder / "cut.nii.gz", np.random.default_rng(0).normal(size=(20, 20, 20)))
    path.write_bytes(path.read_bytes()[:20000])
    return path


def truncated_plain(folder):
    path = save(folder / "cut.nii", np.random.default_rng(0).normal(size=(20, 20, 20)))
    path.write_bytes(path.read_bytes()[:20000])
    return path


def text(folder):
    (folder / "text.nii.gz").write_text("not an image\n")
    return folder / "text.nii.gz"


def zipped_text(folder):
    (folder / "text.nii.gz").write_bytes(gzip.compress(b"not an image\n" * 100))
    return folder / "text.nii.gz"


def no_dicom(folder):
    (folder / "readme.txt").write_text("nothing here\n")
    return folder


def four_d(folder):
    return save(folder / "four.nii.gz", np.zeros((3, 4, 5, 6)), isVector=False)


def nan(folder):
    values = np.ones((4, 5, 6))
    values[1, 2, 3] = np.nan
    return save(folder / "nan.nii.gz", values)


def infinite(folder):
    values = np.ones((4, 5, 6))
    values[0, 0, 0] = np.inf
    return save(folder / "inf.nrrd", values)


def single_slice(folder):
    return save(folder / "one.nii.gz", np.ones((1, 8, 8)))


def colour(folder):
    return save(folder / "colour.nrrd", np.ones((4, 5, 6, 3), np.uint8), isVector=True)


def two_series(folder):
    for series in (1, 2):
        for k in range(3):
            dicom_slice(folder / f"s{series}k{k}.dcm", f"1.2.3.{series}", k)
    return folder


def missing_slice(folder):
    for k in (0, 1, 2, 4):
        dicom_slice(folder / f"k{k}.dcm", "1.2.3.1", k)
    return folder


def dicom_slice(path, series, k):
    image = sitk.GetImageFromArray(np.full((1, 8, 8), 10 * k, np.int16))
    image.SetOrigin((0, 0, 2.0 * k))
    image.SetSpacing((3.0, 3.0, 2.0))
    image.SetMetaData("0020|000e", series)
    image.SetMetaData("0020|000d", "1.2.3")
    image.SetMetaData("0010|0010", "Secret^Name")
    image.SetMetaData("0020|0032", f"0\\0\\{2.0 * k}")
    image.SetMetaData("0020|0037", "1\\0\\0\\0\\1\\0")
    image.SetMetaData("0028|0030", "3\\3")
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    writer.SetFileName(str(path))
    writer.Execute(image)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (missing, "there is no such image"),
        (truncated, "cut short"),
        (truncated_plain, "cut short"),
        (text, "not an image"),
        (zipped_text, "not an image"),
        (no_dicom, "no DICOM"),
        (two_series, "2 DICOM series"),
        (missing_slice, "slices are missing"),
        (four_d, "4 dimensions"),
        (nan, "1 of 120 voxels are NaN"),
        (infinite, "NaN or infinite"),
        (single_slice, "single slice"),
        (colour, "3 values"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(tmp_path, capfd, make, says):
    path = make(tmp_path)
    capfd.readouterr()
    with pytest.raises(InputError) as caught:
        read_image(path)
    message = str(caught.value)
    assert says in message
    assert message.endswith(".")
    assert "\n" not in message
    assert "Secret" not in message
    assert "1.2.3" not in message
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("value", "says"), [(7, "this one also has 7"), (0, "no voxel of the breast"), (5, "no voxel")]
)
def test_label_maps_are_checked(tmp_path, value, says):
    path = save(tmp_path / "labels.nii.gz", np.full((4, 4, 4), value, np.uint8))
    with pytest.raises(InputError, match=says):
        read_labels(path)


def test_dicom_folder_is_read_in_order_and_loses_its_identifiers(tmp_path):
    for k in (2, 0, 1):
        dicom_slice(tmp_path / f"slice{(k * 7) % 5}.dcm", "1.2.3.4", k)
    volume = read_image(tmp_path)
    assert volume.values[:, 0, 0].tolist() == [0, 10, 20]
    assert volume.spacing_mm[2] == pytest.approx(2.0)
    write_volume(tmp_path / "out.nii", volume)
    assert b"Secret" not in (tmp_path / "out.nii").read_bytes()


def test_shared_dicom_series(tmp_path):
    archive = DATA / "mimbcd_uta4p1_dicom12.zip"
    if not archive.exists():
        pytest.skip("the shared image data is not beside the project; set CICATRIX_DATA to its folder")
    with zipfile.ZipFile(archive) as z:
        z.extractall(tmp_path)
    volume = read_image(tmp_path)
    assert volume.shape == (12, 352, 352)
    assert volume.spacing_mm == pytest.approx((1.0227, 1.0227, 1.5), abs=1e-3)
    first = pydicom.dcmread(min(tmp_path.glob("*.dcm"), key=lambda p: pydicom.dcmread(p).ImagePositionPatient[2]))
    np.testing.assert_array_equal(volume.values[0], first.pixel_array)
