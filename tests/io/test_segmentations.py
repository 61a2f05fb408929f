"""Segmentations of 3D Slicer and in DICOM, read by the names of their segments."""

import os
import tomllib
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, generate_uid
from shared_inputs import FAULTS

from cicatrix.core.errors import InputError
from cicatrix.files.segmentations import read_labels
from cicatrix.files.toml import toml_text

SHAPE = (5, 6, 7)  # slices, rows, columns; 42 pixels a frame, so that packed frames begin within a byte
SPACING_MM = (2.0, 3.0, 4.0)
ORIGIN_MM = (-10.0, -20.0, 30.0)
NAMES = {1: "Fat", 2: "FGT", 3: "Skin"}


def tissue_values() -> np.ndarray:
    """Return voxels (nz, ny, nx): 1, 2 and 3 in one corner, with slices 0 and 4 empty."""
    values = np.zeros(SHAPE, np.uint8)
    values[1:4, 1:5, 1:6] = 3
    values[1:4, 2:4, 2:5] = 1
    values[2, 2:4, 3] = 2
    return values


def slicer(path: Path, values: np.ndarray, fields: dict[str, str]) -> Path:
    """Write a .seg.nrrd: values (nz, ny, nx), or (nz, ny, nx, n_layers)."""
    layers = values.ndim == 4
    sizes = " ".join(str(n) for n in values.shape[::-1])
    directions = " ".join("({},{},{})".format(*row) for row in np.diag(SPACING_MM))
    lines = [
        "NRRD0004",
        "type: unsigned char",
        f"dimension: {values.ndim}",
        "space: left-posterior-superior",
        f"sizes: {sizes}",
        f"space directions: {'none ' if layers else ''}{directions}",
        f"kinds: {'list ' if layers else ''}domain domain domain",
        "encoding: raw",
        "space origin: ({},{},{})".format(*ORIGIN_MM),
        *(f"{key}:={value}" for key, value in fields.items()),
    ]
    path.write_bytes("\n".join(lines).encode() + b"\n\n" + np.ascontiguousarray(values).tobytes())
    return path


def named(names: dict[int, str], **more: str) -> dict[str, str]:
    fields = {}
    for number, (value, name) in enumerate(names.items()):
        fields |= {
            f"Segment{number}_Name": name,
            f"Segment{number}_LabelValue": str(value),
            f"Segment{number}_Layer": "0",
        }
        fields[f"Segment{number}_Extent"] = "0 6 0 5 0 4"
    return fields | more


def item(**values) -> Dataset:
    out = Dataset()
    for key, value in values.items():
        setattr(out, key, value)
    return out


def dicom_seg(path: Path, kind: str = "BINARY", names=None, codes=None, **changes) -> Path:
    """Write a DICOM segmentation as highdicom does: frames per segment from the last slice to the first, without empty ones."""
    names, values = names or NAMES, tissue_values()
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.SOPClassUID = "1.2.840.10008.5.1.4.1.1.66." + ("7" if kind == "LABELMAP" else "4")
    data.SOPInstanceUID, data.Modality, data.PatientName = generate_uid(), "SEG", "Secret^Name"
    data.SegmentationType, data.MaximumFractionalValue = kind, 200
    data.SegmentSequence = [
        item(
            SegmentNumber=number,
            SegmentLabel=name,
            SegmentedPropertyTypeCodeSequence=[item(CodeMeaning=(codes or {}).get(number, "Tissue"))],
        )
        for number, name in names.items()
    ]
    data.SharedFunctionalGroupsSequence = [
        item(
            PlaneOrientationSequence=[item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])],
            PixelMeasuresSequence=[item(PixelSpacing=[3.0, 2.0], SliceThickness=4.0)],
        )
    ]
    frames, pixels = [], []
    for number in [0] if kind == "LABELMAP" else NAMES:
        for k in range(SHAPE[0])[::-1]:
            shown = values[k] if kind == "LABELMAP" else (values[k] == number)
            if shown.any():
                frames.append(item(PlanePositionSequence=[item(ImagePositionPatient=[-10.0, -20.0, 30.0 + 4 * k])]))
                if number:
                    frames[-1].SegmentIdentificationSequence = [item(ReferencedSegmentNumber=number)]
                pixels.append(shown * 150 if kind == "FRACTIONAL" else shown)
    data.PerFrameFunctionalGroupsSequence = frames
    data.NumberOfFrames, data.Rows, data.Columns = len(frames), *SHAPE[1:]
    data.SamplesPerPixel, data.PhotometricInterpretation, data.PixelRepresentation = 1, "MONOCHROME2", 0
    bits = 1 if kind == "BINARY" else 8
    data.BitsAllocated, data.BitsStored, data.HighBit = bits, bits, bits - 1
    stack = np.array(pixels, np.uint8)
    packed = np.packbits(stack.ravel(), bitorder="little") if bits == 1 else stack.ravel()
    data.PixelData = packed.tobytes() + b"\0" * (packed.size % 2)
    for key, value in changes.items():
        value(data) if callable(value) else setattr(data, key, value)
    data.save_as(path, enforce_file_format=True)
    return path


def expected(mapping: dict[int, int]) -> np.ndarray:
    return np.array([mapping.get(v, 0) for v in range(4)], np.uint8)[tissue_values()]


def test_slicer_segments_are_read_by_name_and_not_by_value(tmp_path):
    notes = []
    names = {1: "Gland", 2: "adipose tissue", 3: "skin"}
    volume = read_labels(slicer(tmp_path / "a.seg.nrrd", tissue_values(), named(names)), note=notes.append)
    np.testing.assert_array_equal(volume.values, expected({1: 2, 2: 1, 3: 3}))
    assert (volume.spacing_mm, volume.origin_mm) == (SPACING_MM, ORIGIN_MM)
    assert notes == ['labels by name: "Gland" is gland, "adipose tissue" is fat, "skin" is skin']


def test_slicer_layers_that_overlap_follow_a_rule_that_is_said(tmp_path):
    values = tissue_values()
    layers = np.stack([values != 0, values == 2], axis=-1).astype(np.uint8)
    fields = named({1: "Fat"}) | {"Segment1_Name": "tumor_1", "Segment1_LabelValue": "1", "Segment1_Layer": "1"}
    notes = []
    volume = read_labels(slicer(tmp_path / "a.seg.nrrd", layers, fields), note=notes.append)
    np.testing.assert_array_equal(volume.values, expected({1: 1, 2: 4, 3: 1}))
    assert "overlap in 2 voxels; such a voxel gets the first of tumour" in notes[1]


def test_an_old_slicer_file_has_one_layer_per_segment(tmp_path):
    values = tissue_values()
    layers = np.stack([values == 1, values == 3, values == 2], axis=-1).astype(np.uint8)
    fields = {f"Segment{k}_Name": name for k, name in enumerate(("fat", "skin", "fibroglandular tissue"))}
    volume = read_labels(slicer(tmp_path / "a.nrrd", layers, fields))
    np.testing.assert_array_equal(volume.values, expected({1: 1, 2: 2, 3: 3}))


def test_a_slicer_segment_without_a_telling_name_is_read_by_its_coded_type(tmp_path):
    tags = "TerminologyEntry:Segmentation category and type - 3D Slicer General Anatomy list~SCT^85756007^Tissue"
    fields = named({1: "Segment_1", 2: "Segment_2", 3: "Skin"})
    for number, code in enumerate(("SCT^55603005^Adipose tissue", "SCT^4147007^Mass", "SCT^85756007^Tissue")):
        fields[f"Segment{number}_Tags"] = f"Segmentation.Status:inprogress|{tags}~{code}~^^~list~^^~^^|"
    volume = read_labels(slicer(tmp_path / "a.seg.nrrd", tissue_values(), fields))
    np.testing.assert_array_equal(volume.values, expected({1: 1, 2: 4, 3: 3}))


@pytest.mark.parametrize("kind", ["BINARY", "LABELMAP", "FRACTIONAL"])
def test_dicom_segments_are_read_by_name_at_their_positions(tmp_path, kind):
    notes = []
    volume = read_labels(dicom_seg(tmp_path / "a", kind), note=notes.append)
    np.testing.assert_array_equal(volume.values, expected({1: 1, 2: 2, 3: 3})[1:4])
    assert volume.spacing_mm == SPACING_MM
    assert volume.origin_mm == (-10.0, -20.0, 34.0)
    assert notes == ['labels by name: "Fat" is fat, "FGT" is gland, "Skin" is skin']


def test_a_folder_with_one_dicom_segmentation_is_read(tmp_path):
    dicom_seg(tmp_path / "a.dcm")
    assert read_labels(tmp_path).values.max() == 3
    dicom_seg(tmp_path / "b.dcm")
    with pytest.raises(InputError, match="has 2 DICOM segmentations"):
        read_labels(tmp_path)


def test_slices_between_frames_are_empty(tmp_path):
    """The segments lie in slices 1 and 3 of a stack whose slices are 4 mm apart; slice 2 has no frame."""

    def thin(data):
        keep = [k for k, frame in enumerate(data.PerFrameFunctionalGroupsSequence) if _height(frame) != 38.0]
        pixels = pydicom.pixels.unpack_bits(data.PixelData)[: len(data.PerFrameFunctionalGroupsSequence) * 42].reshape(
            -1, 42
        )
        packed = np.packbits(pixels[keep].ravel(), bitorder="little")
        data.PixelData = packed.tobytes() + b"\0" * (packed.size % 2)
        data.PerFrameFunctionalGroupsSequence = [data.PerFrameFunctionalGroupsSequence[k] for k in keep]
        data.NumberOfFrames = len(keep)
        data.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SpacingBetweenSlices = 4.0

    volume = read_labels(dicom_seg(tmp_path / "a.dcm", thin=thin))
    right = expected({1: 1, 2: 2, 3: 3})[1:4]
    right[1] = 0
    np.testing.assert_array_equal(volume.values, right)


def test_sagittal_frames_lie_as_their_orientation_says(tmp_path):
    """Columns run to the back, rows to the feet, and frames to the right, so slices and rows come in reverse order."""

    def sagittal(data):
        data.SharedFunctionalGroupsSequence[0].PlaneOrientationSequence[0].ImageOrientationPatient = [0, 1, 0, 0, 0, -1]
        for frame in data.PerFrameFunctionalGroupsSequence:
            frame.PlanePositionSequence[0].ImagePositionPatient = [30.0 - (_height(frame) - 30.0), -20.0, 50.0]

    volume = read_labels(dicom_seg(tmp_path / "a.dcm", sagittal=sagittal))
    right = expected({1: 1, 2: 2, 3: 3})[1:4]
    np.testing.assert_array_equal(volume.values, right.transpose(1, 2, 0)[::-1, :, ::-1])
    assert volume.spacing_mm == (4.0, 2.0, 3.0)
    np.testing.assert_allclose(volume.origin_mm, (18.0, -20.0, 50.0 - 3 * 5))


def _height(frame) -> float:
    return float(frame.PlanePositionSequence[0].ImagePositionPatient[2])


def test_the_largest_fraction_wins(tmp_path):
    """Every frame of fat says 0.75, those of skin and gland 0.4 where fat is absent: a voxel less than half full is air."""

    def weaken(data):
        pixels = (
            np.frombuffer(data.PixelData, np.uint8)[: len(data.PerFrameFunctionalGroupsSequence) * 42]
            .reshape(-1, 42)
            .copy()
        )
        for frame, values in zip(data.PerFrameFunctionalGroupsSequence, pixels):
            if frame.SegmentIdentificationSequence[0].ReferencedSegmentNumber != 1:
                values[values > 0] = 80
        data.PixelData = pixels.tobytes() + b"\0" * (pixels.size % 2)

    volume = read_labels(dicom_seg(tmp_path / "a.dcm", "FRACTIONAL", weaken=weaken))
    np.testing.assert_array_equal(volume.values, expected({1: 1})[1:4])


def test_names_given_by_hand_come_first(tmp_path):
    path = slicer(tmp_path / "a.seg.nrrd", tissue_values(), named({1: "Segment_1", 2: "Fat", 3: "Skin"}))
    volume = read_labels(path, {"Segment_1": "fat", "Fat": "tumour"})
    np.testing.assert_array_equal(volume.values, expected({1: 1, 2: 4, 3: 3}))
    with pytest.raises(InputError, match=r'no segment "Segment_2" .* did you mean "Segment_1"'):
        read_labels(path, {"Segment_2": "fat"})


def test_names_with_blanks_survive_in_a_case_file():
    names = {"FGT left": "gland", 'a "b"': "fat", "plain": "skin"}
    assert tomllib.loads(toml_text({"image": {"label_names": names}}))["image"]["label_names"] == names


def test_values_of_a_label_map_can_be_given_a_tissue(tmp_path):
    path = slicer(tmp_path / "a.nrrd", np.where(tissue_values() == 3, 7, tissue_values()).astype(np.uint8), {})
    with pytest.raises(InputError, match="also has 7: name its tissue, in a case"):
        read_labels(path)
    notes = []
    volume = read_labels(path, {"1": "gland", "2": "fat", "7": "skin"}, notes.append)
    np.testing.assert_array_equal(volume.values, expected({1: 2, 2: 1, 3: 3}))
    assert notes == ["labels by value: 1 is gland, 2 is fat, 7 is skin"]


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        (named({1: "Segment_1", 2: "Fat", 3: "Skin"}), '"Segment_1" has no name of a tissue that is known'),
        (named({1: "One", 2: "Fat", 3: "Two"}), 'the segments "One", "Two" have no name of a tissue that is known'),
        (named({1: "gland", 2: "fat"}), 'the segment "3" has no name'),
        (named({1: "gland", 2: "fat", 3: "skin"}, Segment1_LabelValue="x"), 'Segment1_LabelValue .* has "x"'),
        (named({1: "gland", 2: "fat", 3: "skin"}, Segment1_Layer="4"), "in layer 4, which is not in the file"),
        (named({1: "gland", 2: "fat", 3: "skin"}, Segment1_LabelValue="1"), "as another one has"),
        (named({1: "gland", 2: "", 3: "skin"}), "Segment1_Name is missing"),
        (named({1: "air", 2: "background", 3: "muscle"}), "no voxel of the breast"),
        (
            named({1: "fat", 2: "gland", 3: "skin"}, Segment0_Tags="TerminologyEntry:a~SCT^1^Tissue~SCT^2^Skin~^^|"),
            '"fat" has the coded type "Skin"',
        ),
    ],
)
def test_a_slicer_file_that_is_not_clear_is_refused(tmp_path, fields, says):
    path = slicer(tmp_path / "a.seg.nrrd", tissue_values(), fields)
    with pytest.raises(InputError, match=says) as caught:
        read_labels(path)
    assert str(caught.value).startswith("a.seg.nrrd: ")


def shifted(data):
    data.PerFrameFunctionalGroupsSequence[0].PlanePositionSequence[0].ImagePositionPatient = [-9.0, -20.0, 42.0]


def doubled(data):
    data.PerFrameFunctionalGroupsSequence[0] = data.PerFrameFunctionalGroupsSequence[1]


def unplaced(data):
    del data.PerFrameFunctionalGroupsSequence[2].PlanePositionSequence


def turned(data):
    data.PerFrameFunctionalGroupsSequence[1].PlaneOrientationSequence = [
        item(ImageOrientationPatient=[0, 1, 0, 0, 0, -1])
    ]


def nan(data):
    data.PerFrameFunctionalGroupsSequence[1].PlanePositionSequence[0].ImagePositionPatient = [float("nan"), 0.0, 0.0]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"names": {1: "Fat", 2: "Node", 3: "Skin"}}, '"Node" has no name of a tissue that is known'),
        ({"names": {1: "Fat", 2: "FGT"}}, "no segment has the number 3"),
        ({"codes": {1: "Skin"}}, '"Fat" has the coded type "Skin"'),
        ({"NumberOfFrames": 14}, "says 14 frames and describes 7"),
        ({"Rows": 12}, "bytes for 74; the file is cut short"),
        ({"change": shifted}, "do not lie at multiples of 4 mm"),
        ({"change": doubled}, "two frames show the same segment"),
        ({"change": unplaced}, "PlanePositionSequence is missing"),
        ({"change": turned}, "differ in orientation"),
        ({"change": nan}, "not a number above 0"),
        ({"change": lambda data: delattr(data, "SegmentSequence")}, "SegmentSequence is missing"),
        ({"change": lambda data: delattr(data, "PixelData")}, "PixelData is missing"),
        (
            {"change": lambda data: delattr(data, "SharedFunctionalGroupsSequence")},
            "PlaneOrientationSequence is missing",
        ),
    ],
)
def test_a_dicom_segmentation_that_is_not_whole_is_refused(tmp_path, changes, says):
    path = dicom_seg(tmp_path / "a.dcm", **changes)
    with pytest.raises(InputError, match=says) as caught:
        read_labels(path)
    assert "Secret" not in str(caught.value)


@pytest.mark.parametrize("length", [140, 400, 900, 1500, -20])
def test_a_dicom_segmentation_that_is_cut_short_is_refused(tmp_path, length):
    path = dicom_seg(tmp_path / "a.dcm")
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(InputError):
        read_labels(path)


def test_only_regular_files_are_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe.nrrd")
    with pytest.raises(InputError, match="a device, a pipe or a socket"):
        read_labels(tmp_path / "pipe.nrrd")
    with pytest.raises(InputError, match="a device, a pipe or a socket"):
        read_labels("/dev/zero")


@pytest.mark.skipif(not FAULTS.exists(), reason="the shared folder is not beside the project")
def test_a_slicer_file_that_names_two_of_its_five_values_is_refused_until_the_case_names_the_others():
    path = FAULTS / "toml" / "slicer.seg.nrrd"
    with pytest.raises(InputError, match='the segments "3", "4", "5" have no name'):
        read_labels(path)
    labels = read_labels(path, {"3": "skin", "4": "tumour", "5": "chest"}).values
    cropped = read_labels(FAULTS / "toml" / "cropped.nii.gz").values
    assert np.bincount(labels.ravel())[1:3].tolist() == np.bincount(cropped.ravel())[[2, 1]].tolist()  # names swapped
