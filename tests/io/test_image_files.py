"""NIfTI, NRRD and MetaImage: the header is judged, the bytes are counted and their checksums compared; names decide nothing."""

import bz2
import gzip
import os
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 - the name its own manual uses

from cicatrix.core.errors import InputError
from cicatrix.files.images import open_image, read_image
from cicatrix.files.segmentations import read_labels

BODY = np.random.default_rng(5).integers(0, 1000, (8, 10, 12)).astype(np.int16)  # z, y, x; 3 mm each
FORMATS = ("nii", "nii.gz", "nrrd", "nhdr", "mha", "mhd")


def image(values=BODY, edges=(3.0, 3.0, 3.0), origin=(-20.0, -30.0, 40.0)):
    made = sitk.GetImageFromArray(values)
    made.SetSpacing(edges)
    made.SetOrigin(origin)
    return made


def written(folder, ending="nii", packed=False, **of):
    path = folder / f"body.{ending}"
    sitk.WriteImage(image(**of), str(path), useCompression=packed)
    return path


def patched(path, *changes):
    """Overwrite parts of a NIfTI header: offset, format and values."""
    raw = bytearray(path.read_bytes())
    for offset, form, *values in changes:
        struct.pack_into("<" + form, raw, offset, *values)
    path.write_bytes(raw)
    return path


def refusal(path, read=read_image, **options):
    with pytest.raises(InputError) as caught:
        read(path, **options)
    message = str(caught.value)
    assert message.endswith(".")
    assert "\n" not in message
    assert str(Path(path).parent) not in message
    return message


def is_body(volume, values=BODY):
    np.testing.assert_array_equal(volume.values, values.astype(np.float32))
    assert volume.spacing_mm == pytest.approx((3.0, 3.0, 3.0))
    assert volume.origin_mm == pytest.approx((-20.0, -30.0, 40.0))


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("ending", FORMATS)
@pytest.mark.parametrize("kind", ["u1", "i2", "u2", "i4", "f4", "f8"])
def test_every_format_and_type_is_read(tmp_path, ending, packed, kind):
    values = (BODY % 200).astype(kind)
    is_body(read_image(written(tmp_path, ending, packed, values=values)), values)


@pytest.mark.parametrize("ending", FORMATS[:3])
def test_the_content_decides_and_not_the_name(tmp_path, ending):
    path = written(tmp_path, ending).rename(tmp_path / "scan")
    is_body(read_image(path))
    (tmp_path / "scan.mha").write_bytes(gzip.compress(path.read_bytes()))
    if ending != "nii.gz":
        is_body(read_image(tmp_path / "scan.mha"))


def test_big_endian_and_pairs_and_nifti_2_are_read(tmp_path):
    raw = bytearray(348)
    struct.pack_into(">i", raw, 0, 348)
    struct.pack_into(">8h", raw, 40, 3, 12, 10, 8, 1, 1, 1, 1)
    struct.pack_into(">2h", raw, 70, 4, 16)
    struct.pack_into(">8f", raw, 76, 1, 3, 3, 3, 0, 0, 0, 0)
    struct.pack_into(">3f", raw, 108, 0, 2, 0)  # slope 2
    raw[123] = 2
    struct.pack_into(">h", raw, 254, 1)
    struct.pack_into(">12f", raw, 280, -3, 0, 0, 20, 0, -3, 0, 30, 0, 0, 3, 40)
    raw[344:348] = b"ni1\0"
    (tmp_path / "p.hdr").write_bytes(raw)
    (tmp_path / "p.img").write_bytes(BODY.astype(">i2").tobytes())
    is_body(read_image(tmp_path / "p.hdr"), 2 * BODY)
    is_body(read_image(tmp_path / "p.img"), 2 * BODY)
    two = bytearray(544)
    struct.pack_into("<i8s2h", two, 0, 540, b"n+2\0\r\n\x1a\n", 4, 16)
    struct.pack_into("<8q", two, 16, 3, 12, 10, 8, 1, 1, 1, 1)
    struct.pack_into("<8d", two, 104, 1, 3, 3, 3, 0, 0, 0, 0)
    struct.pack_into("<q2d", two, 168, 544, 1, 0)
    struct.pack_into("<2i", two, 344, 0, 1)
    struct.pack_into("<12d", two, 400, -3, 0, 0, 20, 0, -3, 0, 30, 0, 0, 3, 40)
    struct.pack_into("<i", two, 500, 2)
    (tmp_path / "two.nii").write_bytes(bytes(two) + BODY.tobytes())
    is_body(read_image(tmp_path / "two.nii"))


PIXDIM, OFFSET, SLOPE, CODES, QUATERN, SROW = 80, 108, 112, 252, 256, 280


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ((PIXDIM, "f", np.nan), "edges of a voxel (pixdim[1..3]) are nan, 3, 3 mm"),
        ((PIXDIM, "f", np.inf), "pixdim[1..3]) are inf"),
        ((PIXDIM + 4, "f", 0.0), "are 3, 0, 3 mm"),
        ((PIXDIM + 8, "f", -3.0), "are 3, 3, -3 mm"),
        ((PIXDIM, "f", 1e-30), "contradicts itself: voxels of 3 x 3 x 3 mm"),
        ((PIXDIM, "f", 4.0), "contradicts itself"),
        ((OFFSET, "f", 0.0), "voxels begin at byte 0 (vox_offset)"),
        ((OFFSET, "f", 348.0), "must be a whole number, 352 or more"),
        ((OFFSET, "f", -352.0), "byte -352"),
        ((OFFSET, "f", np.nan), "byte nan"),
        ((OFFSET, "f", 352.5), "byte 352.5"),
        ((OFFSET, "f", 384.0), "cut short"),
        ((348, "B", 1), "extension at byte 352"),
        ((SLOPE, "2f", np.nan, 0.0), "scales voxels by nan"),
        ((QUATERN, "f", np.nan), "not a rotation"),
        ((QUATERN, "f", 2.0), "not a rotation"),
        ((SROW + 12, "f", np.nan), "not all numbers"),
        ((SROW + 12, "f", 98.0), "places the image twice, up to 78.0 mm apart: qform (code 1) puts the first voxel"),
        ((CODES, "2h", 0, 0), "how the image lies in the patient"),
        ((40, "8h", 3, 12, 10, 4, 1, 1, 1, 1), "more bytes than its header says"),
        ((40, "8h", 3, 12, 10, 16, 1, 1, 1, 1), "cut short"),
        ((40, "8h", 3, 12, -10, 8, 1, 1, 1, 1), "each number must be 1 or more"),
        ((40, "8h", 9, 12, 10, 8, 1, 1, 1, 1), "9 dimensions"),
        ((40, "8h", 3, 32000, 32000, 32000, 1, 1, 1, 1), "at most 500,000,000"),
        ((70, "h", 2304), "4 values"),
        ((70, "h", 1536), "datatype 1536"),
        ((344, "4s", b"xyz\0"), "no mark of NIfTI"),
    ],
)
def test_a_nifti_header_that_cannot_be_true_is_refused(tmp_path, change, says):
    assert says in refusal(patched(written(tmp_path), change))


def test_voxels_shifted_by_an_extension_that_is_not_counted_are_refused(tmp_path):
    path = written(tmp_path)
    raw = path.read_bytes()
    path.write_bytes(raw[:352] + struct.pack("<2i24x", 32, 6) + raw[352:])
    assert "more bytes than its header says" in refusal(path)
    counted = patched(path, (OFFSET, "f", 384.0), (348, "B", 1))
    is_body(read_image(counted))
    assert "extension at byte 352 has 64 bytes" in refusal(patched(counted, (352, "i", 64)))


def test_orientation_that_a_header_lacks_can_be_given(tmp_path):
    path = patched(written(tmp_path), (CODES, "2h", 0, 0))
    notes = []
    volume = read_image(path, axes="LPS", note=notes.append)
    np.testing.assert_array_equal(volume.values, BODY)
    assert notes == ["The header gives no position of the image; its first voxel is taken to lie at 0, 0, 0 mm."]
    turned = read_image(path, axes="RAS")
    np.testing.assert_array_equal(turned.values, BODY[:, ::-1, ::-1])
    assert 'the axes "LPP" are not' in refusal(path, axes="LPP")


@pytest.mark.parametrize("header", ["LPS", "RAS"])
def test_given_axes_are_those_of_the_file_whatever_its_header_says(tmp_path, header):
    made = image()
    made.SetDirection((1, 0, 0, 0, 1, 0, 0, 0, 1) if header == "LPS" else (-1, 0, 0, 0, -1, 0, 0, 0, 1))
    sitk.WriteImage(made, str(tmp_path / "a.nrrd"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.nrrd", axes="LPS").values, BODY)
    np.testing.assert_array_equal(read_image(tmp_path / "a.nrrd", axes="PSL").values, from_psl(BODY))


def from_psl(values):
    """Reorder voxels whose x, y, z point to P, S, L, by hand: new x is old z, new y is old x, new z is old y."""
    return np.array([[[values[x, z, y] for x in range(8)] for y in range(12)] for z in range(10)])


@pytest.mark.parametrize("ending", FORMATS)
@pytest.mark.parametrize(
    ("edge", "says"),
    [
        (0.003, "0.036 mm wide"),
        (0.3, "centimetres or inches?"),
        (3000.0, "micrometres?"),
        (90.0, "1080 mm wide"),
    ],
)
def test_a_size_that_no_body_part_has_is_doubted(tmp_path, ending, edge, says):
    path = written(tmp_path, ending, edges=(edge, edge, edge), origin=(0.0, 0.0, 0.0))
    assert says in refusal(path)
    assert "a body part 20 to 800 mm" in refusal(path)


def test_an_image_in_metres_is_asked_about(tmp_path):
    path = written(tmp_path, edges=(0.03, 0.03, 0.03))
    assert "0.36 mm wide (0.36 x 0.3 x 0.24 mm), a body part 20 to 800 mm: metres?" in refusal(path)
    in_metres = patched(written(tmp_path, edges=(0.003,) * 3, origin=(-0.02, -0.03, 0.04)), (123, "B", 1))
    is_body(read_image(in_metres))  # NIfTI says its unit


def test_values_below_zero_are_shifted_once(tmp_path):
    notes = []
    path = patched(written(tmp_path), (SLOPE, "2f", 0.5, -512.0))
    volume = read_image(path, note=notes.append)
    assert len(notes) == 1
    assert notes[0].startswith("Air lies below 0 in the image: intensities are shifted by 5")
    assert volume.values.min() == 0
    assert np.ptp(volume.values) == pytest.approx(np.ptp(BODY) / 2, rel=0.01)


@pytest.mark.parametrize("ending", FORMATS)
def test_voxels_are_finite_as_they_are_used(tmp_path, ending):
    values = BODY.astype(float)
    values[1, 2, 3] = 1e300
    assert "1 of 960 voxels are NaN or infinite" in refusal(written(tmp_path, ending, values=values))
    values[1, 2, 4] = np.nan
    assert "2 of 960 voxels are NaN or infinite" in refusal(written(tmp_path, ending, values=values))


@pytest.mark.parametrize("at", [0.1, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("ending", ["nii.gz", "nrrd", "mha"])
def test_a_damaged_byte_is_noticed_by_the_checksum(tmp_path, ending, at):
    path = written(tmp_path, ending, packed=True)
    raw = bytearray(path.read_bytes())
    start = max(raw.find(b"\n\n"), raw.find(b"LOCAL"), 20) + 12
    raw[start + int(at * (len(raw) - start))] ^= 0x10
    path.write_bytes(raw)
    assert "damaged" in refusal(path)


@pytest.mark.parametrize("ending", FORMATS)
@pytest.mark.parametrize("packed", [False, True])
def test_a_file_cut_short_is_refused(tmp_path, ending, packed):
    path = written(tmp_path, ending, packed)
    data = max(tmp_path.iterdir(), key=lambda file: file.stat().st_size)
    data.write_bytes(data.read_bytes()[:-20])
    assert "cut short" in refusal(path)


def test_metaimages_that_are_not_compressed_as_they_say_are_refused(tmp_path):
    plain, packed = written(tmp_path, "mha").read_bytes(), written(tmp_path, "mha", packed=True).read_bytes()
    path = tmp_path / "a.mha"
    path.write_bytes(plain.replace(b"CompressedData = False", b"CompressedData = True"))
    assert "damaged" in refusal(path)
    path.write_bytes(packed.replace(b"CompressedData = True", b"CompressedData = False"))
    assert "damaged" in refusal(path)
    head = packed[: packed.index(b"LOCAL") + 6]
    path.write_bytes(head + zlib.compress(BODY.tobytes()[:-2]))
    assert "damaged" in refusal(path)
    path.write_bytes(head + zlib.compress(BODY.tobytes() + b"\0\0"))
    assert "more bytes" in refusal(path)


@pytest.mark.parametrize(
    ("line", "instead", "says"),
    [
        ("ElementSpacing", None, "no size of a voxel"),
        ("TransformMatrix", None, "how the image lies"),
        ("TransformMatrix", "TransformMatrix = 1 0 0 0 1 0 0.3 0 0.953939", "sheared"),
        ("ElementSpacing", "ElementSpacing = 3 3 nan", "positive number"),
        ("ElementSpacing", "ElementSpacing = 3 3", "needs 3 numbers"),
        ("Offset", "Offset = 0 0 inf", "all three must be numbers"),
        ("DimSize", "DimSize = 12 10 8.5", "needs 3 numbers as DimSize"),
        ("ElementType", "ElementType = MET_OTHER", '"MET_OTHER" is unknown'),
        ("DimSize", "DimSize = 1_2 10 8", "needs 3 numbers as DimSize"),
        ("ObjectType", "ObjectType = Image\nHeaderSize = nan", "HeaderSize is nan"),
        ("ElementSpacing", "ElementSpacing = 3 3 3\nElementSpacing = 2 2 2", "ElementSpacing twice"),
    ],
)
def test_a_metaimage_header_that_cannot_be_true_is_refused(tmp_path, line, instead, says):
    path = written(tmp_path, "mha")
    lines = path.read_bytes().split(b"\n")
    lines = [given for given in lines if not given.startswith(line.encode()) or instead]
    lines = [(instead or "").encode() if given.startswith(line.encode()) else given for given in lines]
    path.write_bytes(b"\n".join(lines))
    assert says in refusal(path)


NRRD = {
    "type": "int16", "dimension": "3", "sizes": "12 10 8", "space": "left-posterior-superior",
    "space directions": "(3,0,0) (0,3,0) (0,0,3)", "space origin": "(-20,-30,40)", "encoding": "raw", "endian": "little",
}  # fmt: skip


def nrrd(path, data=None, **fields):
    table = NRRD | {key.replace("_", " "): value for key, value in fields.items()}
    head = "".join(f"{key}: {value}\n" for key, value in table.items() if value is not None)
    path.write_bytes(f"NRRD0004\n# made by hand\n{head}\n".encode() + (BODY.tobytes() if data is None else data))
    return path


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"space_directions": None}, "no size of a voxel"),
        ({"space_directions": None, "spacings": "3 3 3"}, "how the image lies"),
        ({"space_directions": "(3,0,0) none (0,0,3)"}, "no direction of the axis y"),
        ({"space_directions": "(3,0,0) (0,3,0)"}, "2 space directions for 3 axes"),
        ({"space_directions": "(3,0,0) (0,0,0) (0,0,3)"}, "each edge must be a positive number"),
        ({"space_directions": "(3,0,0) (0,nan,0) (0,0,3)"}, "each edge must be a positive number"),
        ({"space_directions": "(3,0,0) (0.6,3,0) (0,0,3)"}, "sheared"),
        ({"space": "scanner-xyz"}, "how the image lies"),
        ({"space_units": '"m" "m" "m"'}, 'lengths in "m"'),
        ({"encoding": "rar"}, 'encoding "rar" is unknown'),
        ({"encoding": "gzip"}, "damaged"),
        ({"endian": None}, "order of bytes"),
        ({"sizes": "12 10 9"}, "cut short"),
        ({"sizes": "12 10 7"}, "more bytes"),
        ({"sizes": "12 10"}, "2 sizes"),
        ({"sizes": "12 ten 8"}, "whole numbers"),
        ({"data_file": "/dev/zero"}, "device"),
        ({"data_file": "none.raw"}, "are missing"),
        ({"data_file": 5000 * "x"}, "are missing"),
        ({"line_skip": "999999999999"}, "leave out 999,999,999,999 lines"),
        ({"byte_skip": "999999999999"}, "behind 999,999,999,999 bytes"),
        ({"byte_skip": "-2"}, '"byte skip" is -2'),
        ({"sizes": "1_2 10 8"}, "whole numbers"),
        ({"space_origin": "(1_0,0,0)"}, "not numbers"),
        ({"space_origin": "(1e30,0,0)"}, "farther than 10 m"),
        ({"Sizes": "12 10 9"}, '"sizes" twice'),
    ],
)
def test_an_nrrd_header_that_cannot_be_true_is_refused(tmp_path, fields, says):
    assert says in refusal(nrrd(tmp_path / "a.nrrd", **fields))


def test_nrrd_is_read_in_all_its_encodings(tmp_path):
    text = " ".join(str(v) for v in BODY.ravel()).encode()
    files = {
        "gzip": gzip.compress(BODY.tobytes()), "bzip2": bz2.compress(BODY.tobytes()), "ascii": text,
        "hex": BODY.tobytes().hex().encode(), "raw": None,
    }  # fmt: skip
    for encoding, data in files.items():
        is_body(read_image(nrrd(tmp_path / "a.nrrd", data, encoding=encoding)))
    is_body(read_image(nrrd(tmp_path / "a.nrrd", b"skip\n12" + BODY.tobytes(), line_skip="1", byte_skip="2")))
    is_body(read_image(nrrd(tmp_path / "a.nrrd", b"any bytes" + BODY.tobytes(), byte_skip="-1")))
    for k in range(4):
        (tmp_path / f"s{k}.raw").write_bytes(BODY[2 * k : 2 * k + 2].tobytes())
    is_body(read_image(nrrd(tmp_path / "a.nhdr", b"", data_file="s%d.raw 0 3 1")))
    is_body(read_image(nrrd(tmp_path / "a.nhdr", b"", data_file="LIST\ns0.raw\ns1.raw\ns2.raw\ns3.raw")))
    is_body(
        read_image(
            nrrd(
                tmp_path / "a.nrrd",
                space="RAS",
                space_directions="(-3,0,0) (0,-3,0) (0,0,3)",
                space_origin="(20,30,40)",
            )
        )
    )


@pytest.mark.parametrize("value", ["40000", "-40000", "1.5", "nan", "ten", "1_0"])
def test_a_text_voxel_beyond_its_type_is_refused(tmp_path, value):
    text = " ".join([value, *(str(v) for v in BODY.ravel()[1:])]).encode()
    assert "a voxel is" in refusal(nrrd(tmp_path / "a.nrrd", text, encoding="ascii"))


def test_layers_and_pairs_of_a_segmentation_are_passed_on(tmp_path):
    layers = np.stack([BODY % 2, BODY % 3], axis=-1).astype(np.uint8)
    of_layers = {"type": "uint8", "dimension": "4", "sizes": "2 12 10 8", "kinds": "list domain domain domain"}
    directions = "none (3,0,0) (0,3,0) (0,0,3)"
    path = nrrd(tmp_path / "a.seg.nrrd", layers.tobytes(), space_directions=directions, **of_layers)
    path.write_bytes(path.read_bytes().replace(b"\n\n", b"\nSegment0_Name:=gland\n\n", 1))
    found = open_image(path, layers=True)
    np.testing.assert_array_equal(sitk.GetArrayFromImage(found), layers)
    assert found.GetMetaData("Segment0_Name") == "gland"
    assert "2 values" in refusal(path)


def test_a_small_gzip_that_unpacks_to_much_is_left_early(tmp_path, monkeypatch):
    path = written(tmp_path)
    path.write_bytes(gzip.compress(path.read_bytes() + bytes(1 << 24), 9))
    read = []
    unpack = gzip.GzipFile.read
    monkeypatch.setattr(gzip.GzipFile, "read", lambda self, n: read.append(n) or unpack(self, n))
    assert "more bytes than its header says" in refusal(path)
    assert sum(read) < 10_000


@pytest.mark.parametrize("ending", ["nii.gz", "nrrd"])
def test_bytes_before_the_voxels_are_not_kept(tmp_path, monkeypatch, ending):
    if ending == "nrrd":
        body = gzip.compress(bytes(1 << 22) + BODY.tobytes())
        path = nrrd(tmp_path / "a.nrrd", body, encoding="gzip", byte_skip=str(1 << 22))
    else:
        head = bytearray(written(tmp_path, "nii").read_bytes()[:352])
        struct.pack_into("<f", head, 108, 352.0 + (1 << 22))
        path = tmp_path / "a.nii.gz"
        path.write_bytes(gzip.compress(bytes(head) + bytes(1 << 22) + BODY.tobytes()))
    monkeypatch.setattr("cicatrix.files.streams.PIECE", 1 << 16)
    tracemalloc.start()
    is_body(read_image(path))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1 << 21
    monkeypatch.setattr("cicatrix.files.streams.LONGEST_SKIP", 1 << 20)
    assert "at most 1,048,576 can be left out" in refusal(path)


def test_an_endless_header_is_left_early(tmp_path, monkeypatch):
    monkeypatch.setattr("cicatrix.files.nrrd.LONGEST_HEADER", 1 << 16)
    (tmp_path / "a.nrrd").write_bytes(gzip.compress(b"NRRD0004\n" + b"key: value\n" * 100_000))
    assert "header has more than" in refusal(tmp_path / "a.nrrd")
    (tmp_path / "b.mha").write_bytes(gzip.compress(b"ObjectType = Image\n" * 100_000))
    assert "ElementDataFile" in refusal(tmp_path / "b.mha")


@pytest.mark.parametrize("special", ["/dev/zero", "fifo"])
def test_only_regular_files_are_opened(tmp_path, special):
    os.mkfifo(tmp_path / "fifo")
    path = Path(special) if special.startswith("/") else tmp_path / special
    assert "a device, a pipe or a socket" in refusal(path)
    assert "a device, a pipe or a socket" in refusal(path, read_labels)
    assert "there is no such image" in refusal(tmp_path / ("x" * 5000))
