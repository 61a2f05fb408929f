"""Classic and enhanced DICOM give the same volume however its planes are stored; what contradicts itself is refused."""

import os
import zlib

import numpy as np
import pydicom
import pytest
import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
from dicom_phantoms import AXIAL, BODY, SHAPE, enhanced, place_of, save, series, slice_of
from pydicom.dataset import Dataset
from pydicom.uid import DeflatedExplicitVRLittleEndian, ExplicitVRBigEndian, RLELossless

from cicatrix.core.errors import InputError
from cicatrix.files.images import read_image

SCRAMBLED = [5, 0, 7, 2, 1, 6, 3, 4]


def read(path, **options):
    """Return the volume and the notes."""
    notes = []
    return read_image(path, note=notes.append, **options), notes


def refusal(path, **options):
    """Return the one sentence with which a path is refused; it names no patient."""
    with pytest.raises(InputError) as caught:
        read_image(path, **options)
    message = str(caught.value)
    assert message.endswith(".")
    assert "\n" not in message
    assert "Secret" not in message
    return message


def is_body(volume, values=BODY):
    np.testing.assert_array_equal(volume.values, values.astype(np.float32))
    assert volume.spacing_mm == pytest.approx((3.0, 3.0, 3.0))
    assert volume.origin_mm == pytest.approx(tuple(place_of(0)))


def test_a_classic_series_is_read_in_any_order(tmp_path):
    files = series()
    volume, notes = read(save(tmp_path / "s", [files[k] for k in SCRAMBLED]))
    is_body(volume)
    assert notes == []


def test_every_slice_has_its_own_slope_and_intercept(tmp_path):
    files, slopes = series(), 1e-5 * np.arange(1, 9)
    for k, data in enumerate(files):
        data.RescaleSlope, data.RescaleIntercept = f"{slopes[k]:g}", f"{k}"
    volume, _ = read(save(tmp_path / "s", files))
    truth = slopes[:, None, None] * BODY + np.arange(8)[:, None, None]
    np.testing.assert_allclose(volume.values, truth, rtol=1e-6)


@pytest.mark.parametrize("order", [None, SCRAMBLED])
def test_enhanced_frames_are_sorted_and_scaled_one_by_one(tmp_path, order):
    slopes = [0.25, 0.5, 1, 2, 4, 8, 16, 32]
    save(tmp_path / "s", [enhanced(order, slopes)])
    by_folder, _ = read(tmp_path / "s")
    by_path, _ = read(tmp_path / "s" / "im000.dcm")
    scale = np.array(slopes)[np.argsort(order if order else range(8))]
    is_body(by_folder, BODY * scale[:, None, None])
    np.testing.assert_array_equal(by_folder.values, by_path.values)


def test_a_scout_is_left_out_and_said(tmp_path):
    files = [*series(), slice_of(BODY[0], place_of(0), [1, 0, 0, 0, 0, -1])]
    volume, notes = read(save(tmp_path / "s", files))
    is_body(volume)
    assert notes == ["Left out: 1 of 9 slices, of another orientation, as a scout has."]


@pytest.mark.parametrize("largest", [0.05, 0.09])
def test_slices_may_lie_a_tenth_of_a_millimetre_off(tmp_path, largest):
    rng = np.random.default_rng(2)
    files = series()
    for data in files:
        data.ImagePositionPatient[2] += rng.uniform(-largest, largest)
    volume, _ = read(save(tmp_path / "s", files))
    np.testing.assert_array_equal(volume.values, BODY)
    assert volume.spacing_mm[2] == pytest.approx(3.0, abs=0.03)


def sheared(files):
    for k, data in enumerate(files):
        data.ImagePositionPatient[1] += k


def one_aside(files):
    files[3].ImagePositionPatient[0] += 1


def one_missing(files):
    del files[3]


def one_twice(files):
    files[3].ImagePositionPatient = files[2].ImagePositionPatient


def one_turned(files):
    c, s = np.cos(0.2), np.sin(0.2)
    files[3].ImageOrientationPatient = [c, s, 0, -s, c, 0]


def one_stretched(files):
    files[3].ImageOrientationPatient = [1.1, 0, 0, 0, 1, 0]


def one_not_square(files):
    files[3].ImageOrientationPatient = [1, 0, 0, 0.1, 0.99498744, 0]


def one_without_orientation(files):
    del files[3].ImageOrientationPatient


def one_place_nan(files):
    files[3]._dict[pydicom.tag.Tag("ImagePositionPatient")] = pydicom.dataelem.RawDataElement(
        pydicom.tag.Tag("ImagePositionPatient"), "DS", 10, b"0\\0\\NaN   ", 0, False, True
    )


def one_coarser(files):
    files[3].PixelSpacing = [3.5, 3.5]


def one_larger(files):
    files[3].Rows, files[3].Columns = files[3].Columns, files[3].Rows


def one_unsigned(files):
    files[3].PixelRepresentation = 0


def one_inverted(files):
    files[3].PhotometricInterpretation = "MONOCHROME1"


def one_of_colours(files):
    files[3].SamplesPerPixel = 3


def high_bit_15(files):
    for data in files:
        data.BitsStored, data.HighBit = 12, 15


def too_few_bits(files):
    for data in files:
        data.BitsStored, data.HighBit = 8, 7


def halved(files):
    files[3].PixelData = files[3].PixelData[: len(files[3].PixelData) // 2]


def doubled(files):
    files[3].PixelData *= 2


def slope_zero(files):
    files[3].RescaleSlope, files[3].RescaleIntercept = 0, 0


def other_series(files):
    files[3].SeriesInstanceUID = "1.2.3.9"


def other_half_turned(files):
    for data in files[4:]:
        data.ImageOrientationPatient = [0, 1, 0, 0, 0, -1]


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (sheared, "sheared by 18.4 degrees"),
        (one_aside, "aside of a straight stack"),
        (one_missing, "slices are missing"),
        (one_twice, "the same position"),
        (one_turned, "1 of 8 slices are turned"),
        (one_stretched, "not of length 1"),
        (one_not_square, "sheared (not orthonormal) by 5.7 degrees"),
        (one_without_orientation, "ImageOrientationPatient is missing: 6 finite numbers"),
        (one_place_nan, "ImagePositionPatient is not as the standard says"),
        (one_coarser, "different pixel spacings: 1 of 8"),
        (one_larger, "different sizes: 1 of 8"),
        (one_unsigned, "different pixel formats"),
        (one_inverted, "MONOCHROME1"),
        (one_of_colours, "3 values"),
        (high_bit_15, "BitsStored 12, HighBit 15"),
        (too_few_bits, "more than the 8 bits"),
        (halved, "the file has 120"),
        (doubled, "the file has 480"),
        (slope_zero, "RescaleSlope is 0"),
        (other_series, "2 DICOM series (7, 1 files)"),
        (other_half_turned, "2 orientations"),
    ],
)
def test_slices_that_make_no_volume_are_refused(tmp_path, spoil, says):
    files = series()
    spoil(files)
    assert says in refusal(save(tmp_path / "s", files))


@pytest.mark.parametrize("value", [None, b"0\\0 ", b"-3\\-3 ", b"3,0\\3,0 ", b"nan\\3 ", b"3 "])
@pytest.mark.parametrize("n", [1, 8])
def test_pixel_spacing_must_be_two_positive_numbers_in_every_file(tmp_path, value, n):
    files = series()
    tag = pydicom.tag.Tag("PixelSpacing")
    for data in files[:n]:
        if value is None:
            del data.PixelSpacing
        else:
            data._dict[tag] = pydicom.dataelem.RawDataElement(tag, "DS", len(value), value, 0, False, True)
    assert "PixelSpacing is" in refusal(save(tmp_path / "s", files))


def test_bits_beside_the_stored_ones_do_not_change_values(tmp_path):
    files = series(BitsStored=12, HighBit=11)
    for k, data in enumerate(files):
        data.PixelData = (BODY[k] - 500).astype(np.int16).tobytes()
    volume, notes = read(save(tmp_path / "s", files))
    assert len(notes) == 1  # air below 0
    dark = float(np.percentile(BODY - np.float32(500), 0.5))
    np.testing.assert_allclose(volume.values, np.maximum(BODY - 500.0 - dark, 0), atol=1e-3)


def frames_twice(data):
    data.NumberOfFrames = 16


def frames_half(data):
    data.NumberOfFrames = 4


def frames_and_places_half(data):
    data.NumberOfFrames = 4
    data.PerFrameFunctionalGroupsSequence = list(data.PerFrameFunctionalGroupsSequence)[:4]


def no_planes(data):
    for groups in data.PerFrameFunctionalGroupsSequence:
        del groups.PlanePositionSequence


def no_measures(data):
    del data.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence


def no_groups(data):
    del data.PerFrameFunctionalGroupsSequence


def two_at_a_place(data):
    planes = data.PerFrameFunctionalGroupsSequence
    for k in range(4):
        planes[k + 4].PlanePositionSequence[0].ImagePositionPatient = (
            planes[k].PlanePositionSequence[0].ImagePositionPatient
        )


def slope_not_finite(data):
    data.PerFrameFunctionalGroupsSequence[2].PixelValueTransformationSequence[0].RescaleSlope = "1e400"


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (frames_twice, "16 frames, but places 8"),
        (frames_half, "4 frames, but places 8"),
        (frames_and_places_half, "the file has 1920"),
        (no_planes, "ImagePositionPatient is missing"),
        (no_measures, "PixelSpacing is missing"),
        (no_groups, "no place of their own"),
        (two_at_a_place, "the same position"),
        (slope_not_finite, "RescaleSlope"),
    ],
)
def test_frames_that_contradict_their_header_are_refused(tmp_path, spoil, says):
    data = enhanced()
    spoil(data)
    assert says in refusal(save(tmp_path / "s", [data]))


def slabs(tmp_path, gap=27.0):
    sagittal = [0, 1, 0, 0, 0, -1]
    places = [*range(0, 24, 3), *(21 + gap + 3 * k for k in range(8))]
    pixels = [*BODY, *(BODY + 1000)]
    return save(tmp_path / "s", [slice_of(p, [x, 0, 0], sagittal) for p, x in zip(pixels, places)])


@pytest.mark.parametrize(("side", "low", "x"), [("right", 0, 0.0), ("left", 1000, 48.0)])
def test_of_two_sagittal_slabs_the_side_asked_for_is_read(tmp_path, side, low, x):
    volume, notes = read(slabs(tmp_path), side=side)
    assert volume.shape == (10, 12, 8)
    assert volume.origin_mm[0] == pytest.approx(x)
    assert low <= volume.values.min() <= volume.values.max() < low + 1000
    assert notes == [f"The slices form two sagittal slabs; the 8 slices of the {side} one are used."]


def test_two_sagittal_slabs_need_a_side(tmp_path):
    assert "say which side" in refusal(slabs(tmp_path))


def test_one_missing_sagittal_slice_makes_no_slabs(tmp_path):
    assert "slices are missing" in refusal(slabs(tmp_path, gap=6.0), side="left")


def emptied(path):
    path.write_bytes(b"")


def mark_damaged(path):
    path.write_bytes(path.read_bytes().replace(b"DICM", b"XXXX", 1))


def cut(path):
    path.write_bytes(path.read_bytes()[:-100])


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (emptied, "1 of 8 files cannot be read as DICOM (the first is number 4"),
        (mark_damaged, "1 of 8 files cannot be read as DICOM (the first is number 4"),
        (cut, "(file 4 of 8"),
    ],
)
def test_no_file_of_a_series_is_dropped_in_silence(tmp_path, spoil, says):
    folder = save(tmp_path / "s", series())
    spoil(folder / "im003.dcm")
    assert says in refusal(folder)


def test_other_files_in_the_folder_are_left_out_and_said(tmp_path):
    folder = save(tmp_path / "s", series())
    (folder / "report.txt").write_text("nothing here\n")
    (folder / ".DS_Store").write_bytes(b"\0\1")
    os.mkfifo(folder / "pipe.dcm")
    volume, notes = read(folder)
    is_body(volume)
    assert notes == ["Left out: 1 of the files in the folder, no DICOM images."]


@pytest.mark.parametrize(
    ("uid", "again", "is_damaged"),
    [
        ("1.3.12.2.1107.5.9.1", "1.3.12.2.1107.5.9.1", False),  # Siemens CSA Non-Image Storage
        ("1.2.840.10008.5.1.4.1.1.88.11", "1.2.840.10008.5.1.4.1.1.88.11", False),  # a report
        ("1.3.12.2.1107.5.9.1", "1.3.12.2.1107.5.9.2", True),  # a damaged digit
        ("1.2.840.10008.5.1.4.1.1.4", "1.2.840.10008.5.1.4.1.1.4", True),  # an MR image that has lost its pixels
        ("1.2.840.10008.5.1.4.9.9.9", "1.2.840.10008.5.1.4.9.9.9", True),  # no class of the standard
    ],
)
def test_a_file_without_image_is_left_out_where_its_class_says_so(tmp_path, uid, again, is_damaged):
    folder = save(tmp_path / "s", series())
    other = pydicom.dcmread(folder / "im000.dcm", stop_before_pixels=True)
    del other.Rows
    other.file_meta.MediaStorageSOPClassUID, other.SOPClassUID = uid, again
    other.save_as(folder / "im999.dcm")
    if is_damaged:
        assert "1 of 9 files cannot be read as DICOM" in refusal(folder)
    else:
        assert read(folder)[1] == ["Left out: 1 of the files in the folder, no DICOM images."]


def test_only_elements_of_a_reserved_block_follow_the_pixels(tmp_path):
    canon = series()
    for data in canon:  # as MR scanners of Toshiba and Canon write them
        data.private_block(0xE401, "TOSHIBA_MEC_MR3^10", create=True).add_new(0x01, "LO", "anything")
    is_body(read(save(tmp_path / "a", canon))[0])
    stray = series()
    stray[3].add_new(0xE4011001, "LO", "no block")
    assert "no DICOM element follow" in refusal(save(tmp_path / "b", stray))


@pytest.mark.parametrize("start", ["", "a"])
def test_a_text_that_is_cut_within_a_letter_is_a_text(tmp_path, start):
    folder = save(tmp_path / "s", series(), "im{:03d}")
    (folder / "readme").write_text(start + 3000 * "\N{LATIN SMALL LETTER E WITH ACUTE}", encoding="utf-8")
    assert read(folder)[1] == ["Left out: 1 of the files in the folder, no DICOM images."]


def test_files_without_preamble_are_read(tmp_path):
    folder = tmp_path / "s"
    folder.mkdir()
    for k, data in enumerate(series()):
        plain = Dataset()
        plain.update({element.tag: element for element in data})
        pydicom.dcmwrite(folder / f"i{k}", plain, implicit_vr=True, little_endian=True)
    volume, _ = read(folder)
    is_body(volume)


def test_deeply_nested_sequences_are_a_sentence(tmp_path):
    files = series()
    raw = bytearray()
    for _ in range(3000):  # a sequence and its item, both of undefined length
        raw += b"\x40\x00\x75\x02SQ\0\0\xff\xff\xff\xff\xfe\xff\x00\xe0\xff\xff\xff\xff"
    folder = save(tmp_path / "s", files)
    path = folder / "im003.dcm"
    content = path.read_bytes()
    at = content.index(b"\x28\x00\x02\x00")  # before the first element of group 0028
    path.write_bytes(content[:at] + bytes(raw) + content[at:])
    assert "cannot be read as DICOM" in refusal(folder)


def deflated(folder):
    files = series()
    for data in files:
        data.file_meta.TransferSyntaxUID = DeflatedExplicitVRLittleEndian
    return save(folder, files)


def test_deflated_files_are_read_and_damaged_ones_refused(tmp_path):
    folder = deflated(tmp_path / "s")
    is_body(read(folder)[0])
    path = folder / "im003.dcm"
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2 : len(raw) // 2 + 40] = b"\xff" * 40
    path.write_bytes(raw)
    refusal(folder)


def test_a_deflated_file_that_unpacks_to_gigabytes_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("cicatrix.files.dicom_pixels.LARGEST", 1 << 20)
    folder = deflated(tmp_path / "s")
    path = folder / "im003.dcm"
    head = path.read_bytes()[: 132 + 12 + pydicom.dcmread(path).file_meta.FileMetaInformationGroupLength]
    pack = zlib.compressobj(9, zlib.DEFLATED, -15)
    path.write_bytes(head + pack.compress(bytes(1 << 23)) + pack.flush())
    assert "cannot be read as DICOM" in refusal(folder)


def test_big_endian_and_run_length_pixels_are_decoded(tmp_path):
    files = series()
    for k, data in enumerate(files):
        data.file_meta.TransferSyntaxUID = ExplicitVRBigEndian
        data.PixelData = BODY[k].astype(">i2").tobytes()
    folder = tmp_path / "big"
    folder.mkdir()
    for k, data in enumerate(files):
        plain = Dataset()
        plain.update({element.tag: element for element in data})
        plain.file_meta = data.file_meta
        pydicom.dcmwrite(folder / f"{k}.dcm", plain, implicit_vr=False, little_endian=False, enforce_file_format=True)
    is_body(read(folder)[0])
    packed = enhanced()
    packed.compress(RLELossless)
    is_body(read(save(tmp_path / "rle", [packed]))[0])


@pytest.mark.parametrize("compressor", ["JPEG2000", "JPEGLS"])
def test_compressed_slices_are_decoded(tmp_path, compressor):
    folder = tmp_path / "s"
    folder.mkdir()
    pixels = np.tile(np.arange(32, dtype=np.int16) * 20, (32, 1))
    for k in range(4):
        image = sitk.GetImageFromArray((pixels + k)[None])
        for tag, value in {
            "0020|000e": "1.2.3", "0020|0037": "1\\0\\0\\0\\1\\0", "0020|0032": f"0\\0\\{3 * k}", "0028|0030": "3\\3",
            "0008|0016": "1.2.840.10008.5.1.4.1.1.4",
        }.items():  # fmt: skip
            image.SetMetaData(tag, value)
        writer = sitk.ImageFileWriter()
        writer.KeepOriginalImageUIDOn()
        writer.UseCompressionOn()
        writer.SetCompressor(compressor)
        writer.SetFileName(str(folder / f"{k}.dcm"))
        writer.Execute(image)
    assert pydicom.dcmread(folder / "0.dcm").file_meta.TransferSyntaxUID.is_compressed
    volume, _ = read(folder)
    np.testing.assert_array_equal(volume.values, pixels + np.arange(4)[:, None, None])


def test_a_single_slice_by_its_own_path_asks_for_the_folder(tmp_path):
    save(tmp_path / "s", [slice_of(BODY[0], place_of(0), AXIAL)])
    assert "give its folder" in refusal(tmp_path / "s" / "im000.dcm")
    assert BODY.shape == SHAPE
