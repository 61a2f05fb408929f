"""DICOM files of a small body, written as the standard says, for tests that then spoil them."""

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import EnhancedMRImageStorage, ExplicitVRLittleEndian, MRImageStorage

SHAPE = (8, 10, 12)  # slices, rows, columns; 3 mm each
AXIAL = [1, 0, 0, 0, 1, 0]
BODY = np.random.default_rng(7).integers(0, 1000, SHAPE).astype(np.int16)


def place_of(k):
    """Return where slice k begins, LPS [mm]."""
    return [-20.0, -30.0, 40.0 + 3.0 * k]


def _image(sop_class, syntax=ExplicitVRLittleEndian):
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = sop_class, pydicom.uid.generate_uid()
    meta.TransferSyntaxUID = syntax
    data = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    data.SOPClassUID, data.SOPInstanceUID = sop_class, meta.MediaStorageSOPInstanceUID
    data.PatientName, data.StudyInstanceUID, data.SeriesInstanceUID = "Secret^Name", "1.2.3", "1.2.3.4"
    data.Modality = "MR"
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 1
    return data


def slice_of(pixels, position, orientation=AXIAL, **changes):
    """Return a file with one slice; ``changes`` replace elements, None removes one."""
    data = _image(MRImageStorage)
    data.Rows, data.Columns = pixels.shape
    data.ImagePositionPatient, data.ImageOrientationPatient = [float(x) for x in position], list(orientation)
    data.PixelSpacing, data.SliceThickness = [3.0, 3.0], 3.0
    data.PixelData = np.ascontiguousarray(pixels).tobytes()
    change(data, changes)
    return data


def change(data, changes):
    for name, value in changes.items():
        if value is None:
            del data[name]
        else:
            setattr(data, name, value)


def series(**changes):
    """Return the slices of the body, as files."""
    return [slice_of(BODY[k], place_of(k), **changes) for k in range(len(BODY))]


def save(folder, files, name="im{:03d}.dcm"):
    """Write files to a folder, and return it."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, data in enumerate(files):
        data.save_as(folder / name.format(number), enforce_file_format=True)
    return folder


def enhanced(order=None, slopes=None, syntax=ExplicitVRLittleEndian, **changes):
    """Return the body as one enhanced file, with its frames in any order, each with its own slope."""
    order = list(range(len(BODY))) if order is None else order
    data = _image(EnhancedMRImageStorage, syntax)
    data.Rows, data.Columns, data.NumberOfFrames = *SHAPE[1:], len(order)
    shared, measures, orientation = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing, measures.SliceThickness = [3.0, 3.0], 3.0
    orientation.ImageOrientationPatient = AXIAL
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = [measures], [orientation]
    data.SharedFunctionalGroupsSequence = [shared]
    frames = []
    for at, k in enumerate(order):
        groups, plane, scale = Dataset(), Dataset(), Dataset()
        plane.ImagePositionPatient = place_of(k)
        scale.RescaleIntercept, scale.RescaleSlope = 0, 1 if slopes is None else slopes[at]
        groups.PlanePositionSequence, groups.PixelValueTransformationSequence = [plane], [scale]
        frames.append(groups)
    data.PerFrameFunctionalGroupsSequence = frames
    data.PixelData = np.ascontiguousarray(BODY[order]).tobytes()
    change(data, changes)
    return data
