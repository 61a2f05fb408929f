"""NIfTI-1 and NIfTI-2 images, single files or pairs of header and voxels.

Source: R. W. Cox et al., NIfTI-1 data format, nifti1.h; NIfTI-2 data format, nifti2.h (NIMH).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.errors import InputError
from .grid import Grid, Stored, check_size, scaled
from .streams import Source, opened
from .voxels import decoded

FIELDS = (
    "dim", "datatype", "pixdim", "vox_offset", "scl_slope", "scl_inter", "xyzt_units",
    "qform_code", "sform_code", "quatern", "qoffset", "srow",
)  # fmt: skip
VERSIONS = {  # length of the header: types and offsets of the fields, where the mark stands, and its last letter
    348: (
        ("8i2", "i2", "8f4", "f4", "f4", "f4", "u1", "i2", "i2", "3f4", "3f4", "(3,4)f4"),
        (40, 70, 76, 108, 112, 116, 123, 252, 254, 256, 268, 280),
        slice(344, 347),
        b"1",
    ),
    540: (
        ("8i8", "i2", "8f8", "i8", "f8", "f8", "i4", "i4", "i4", "3f8", "3f8", "(3,4)f8"),
        (16, 12, 104, 168, 176, 184, 500, 344, 348, 352, 376, 400),
        slice(4, 7),
        b"2",
    ),
}
TYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8"}
COMPONENTS = {32: 2, 1792: 2, 128: 3, 2304: 4}  # complex numbers and colours
MM = {0: 1.0, 1: 1e3, 2: 1.0, 3: 1e-3}  # mm per unit of length, by its code; unknown is taken as mm
LPS = np.array([-1.0, -1.0, 1.0])  # from the format's own RAS
APART_MM = 0.5  # largest distance of a corner between the two placements that a header may give
EDGE_APART = 0.01  # largest relative difference of a voxel's edge between pixdim and sform


def is_nifti(head: bytes) -> bool:
    """Return whether a file begins as a NIfTI or Analyze header."""
    return len(head) >= 348 and any(int.from_bytes(head[:4], order) in VERSIONS for order in ("little", "big"))  # pyright: ignore[reportArgumentType]


def read_nifti(path: Path) -> Stored:
    """Read a volume.

    Parameters
    ----------
    path : Path
        A ``.nii`` or ``.nii.gz`` file, or the header of a pair, whose voxels are beside it.

    Raises
    ------
    InputError
        If the header contradicts itself or the format, or the voxels are cut short, damaged or too many.
    """
    with opened(path) as source:
        header, length, is_pair = _header(source)
        size, grid = _described(header)
        kind = np.dtype(header.dtype["datatype"].byteorder + TYPES[int(header["datatype"])])
        offset = _offset(header, 0 if is_pair else length + 4)
        if not is_pair:
            _skip_extensions(source, offset, length + 4, header)
            values = decoded(source, "raw", kind, size[::-1])
    if is_pair:
        with opened(_beside(path)) as source:
            values = decoded(source, "raw", kind, size[::-1], offset)
    slope, intercept = float(header["scl_slope"]), float(header["scl_inter"])
    return Stored(values if slope == 0 else scaled(values, slope, intercept), grid)  # 0: there is no scale


def nifti_header(path: Path) -> tuple[tuple[int, int, int], Grid]:
    """Return the numbers of voxels along x, y, z, and where they lie; voxels are not read. InputError as :func:`read_nifti`."""
    with opened(path) as source:
        header, length, is_pair = _header(source)
        _offset(header, 0 if is_pair else length + 4)
        return _described(header)


def _described(header: np.void) -> tuple[tuple[int, int, int], Grid]:
    rank, code = int(header["dim"][0]), int(header["datatype"])
    if not 1 <= rank <= 7:
        raise InputError(f"the header gives {rank} dimensions (dim[0]); 3 are needed")
    size = check_size(tuple(header["dim"][1 : rank + 1].tolist()), COMPONENTS.get(code, 1))
    if code not in TYPES:
        raise InputError(f"the header's datatype {code} is unknown; convert the image to integers or floats")
    return size, _grid(header, size)


def _header(source: Source) -> tuple[np.void, int, bool]:
    """Return the fields of a header, its length, and whether the voxels are in another file."""
    data = source.read(348)
    order = "<" if int.from_bytes(data[:4], "little") in VERSIONS else ">"
    length = int(np.frombuffer(data, order + "i4", 1)[0])
    data += source.read(length - len(data))
    formats, offsets, at, version = VERSIONS[length]
    mark = bytes(data[at])
    if mark not in (b"n+" + version, b"ni" + version):
        raise InputError(
            "the header has no mark of NIfTI (Analyze 7.5 has none, and no orientation); convert the image to NIfTI"
        )
    kind = np.dtype({"names": FIELDS, "formats": formats, "offsets": offsets, "itemsize": length}).newbyteorder(order)
    return np.frombuffer(data, kind)[0], length, mark.startswith(b"ni")


def _offset(header: np.void, least: int) -> int:
    """Return where the voxels begin, in bytes; not before ``least``."""
    offset = float(header["vox_offset"])
    if not (np.isfinite(offset) and offset == int(offset) and offset >= least):
        raise InputError(
            f"the header says that voxels begin at byte {offset:g} (vox_offset); it must be a whole number, {least} or more"
        )
    return int(offset)


def _skip_extensions(source: Source, offset: int, at: int, header: np.void) -> None:
    """Read from byte ``at``, behind the header, to the voxels; extensions there must end before these."""
    order = "little" if header["dim"].dtype.newbyteorder("<") == header["dim"].dtype else "big"
    has_extensions = source.read(4)[0] != 0
    while has_extensions:
        length = int.from_bytes(source.read(8)[:4], order)
        if length < 16 or at + length > offset:
            raise InputError(
                f"the header's extension at byte {at} has {length} bytes, but voxels begin at byte {offset} (vox_offset); "
                "convert the image again"
            )
        source.skip(length - 8)
        at += length
        has_extensions = at < offset
    source.skip(offset - at)


def _beside(path: Path) -> Path:
    """Return the file with the voxels of a pair."""
    stem = path.name.removesuffix(".gz").rpartition(".")[0]
    for ending in (".img", ".img.gz"):
        if (there := path.with_name(stem + ending)).exists():
            return there
    raise InputError("the header is one of a pair, but the file with its voxels (.img) is not beside it")


def _grid(header: np.void, size: tuple[int, int, int]) -> Grid:
    """Return where the voxels lie, by the placements that the header says it has.

    Raises
    ------
    InputError
        If a number is not finite or an edge not positive, or the two placements, or the edges, contradict each other.
    """
    unit = MM.get(int(header["xyzt_units"]) & 7, 1.0)
    edges = header["pixdim"][1:4].astype(float) * unit
    if not (np.isfinite(edges).all() and (edges > 0).all()):
        shown = ", ".join(f"{edge:g}" for edge in edges)
        raise InputError(f"the header's edges of a voxel (pixdim[1..3]) are {shown} mm; each must be a positive number")
    codes = {name: int(header[f"{name}_code"]) for name in ("qform", "sform")}
    placed = {
        name: place(header, edges, unit)
        for name, place in (("qform", _by_quaternion), ("sform", _by_matrix))
        if codes[name] > 0
    }
    if len(placed) == 2:
        _check_equal(placed, codes, edges, size)
    directions, origin = next(iter(placed.values()), (None, None))
    sx, sy, sz = edges.tolist()
    return Grid((sx, sy, sz), None if origin is None else (origin[0], origin[1], origin[2]), directions)


def _by_quaternion(header: np.void, edges: np.ndarray, unit: float) -> tuple[np.ndarray, list[float]]:
    """Return directions (3, 3) and origin (3,) of the qform, LPS; nifti1.h, method 2."""
    b, c, d = header["quatern"].astype(float)
    offset = header["qoffset"].astype(float) * unit
    length = b * b + c * c + d * d
    if not (np.isfinite(length) and length < 1.001 and np.isfinite(offset).all()):
        raise InputError("the header's quaternion or offset (qform) is not a rotation and a place; convert it again")
    a = np.sqrt(max(1.0 - length, 0.0))
    turn = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    ) / (a * a + length)
    if header["pixdim"][0] < 0:
        turn[:, 2] *= -1
    return LPS[:, None] * turn, (LPS * offset).tolist()


def _by_matrix(header: np.void, edges: np.ndarray, unit: float) -> tuple[np.ndarray, list[float]]:
    """Return directions (3, 3) and origin (3,) of the sform, LPS; nifti1.h, method 3."""
    matrix = header["srow"].astype(float) * unit
    if not np.isfinite(matrix).all():
        raise InputError("the header's matrix (srow_x, srow_y, srow_z) is not all numbers; convert the image again")
    lengths = np.linalg.norm(matrix[:, :3], axis=0)
    if (np.abs(lengths - edges) > EDGE_APART * edges).any():
        told = [" x ".join(f"{n:.4g}" for n in which) for which in (lengths, edges)]
        raise InputError(
            f"the header contradicts itself: voxels of {told[0]} mm by its matrix (sform), of {told[1]} mm by pixdim; "
            "keep the right one"
        )
    return LPS[:, None] * matrix[:, :3] / lengths, (LPS * matrix[:, 3]).tolist()


def _check_equal(placed: dict, codes: dict[str, int], edges: np.ndarray, size: tuple[int, int, int]) -> None:
    """Refuse two placements in the patient that put a corner of the image at two places."""
    corners = np.array(list(np.ndindex(2, 2, 2))) * (np.array(size) - 1) * edges
    (q, q_origin), (s, s_origin) = placed["qform"], placed["sform"]
    apart = np.linalg.norm(corners @ (q - s).T + np.subtract(q_origin, s_origin), axis=1).max()
    if apart > APART_MM:
        words = [
            f"{name} (code {codes[name]}) puts the first voxel at {', '.join(f'{x:.1f}' for x in placed[name][1])} mm"
            for name in placed
        ]
        raise InputError(
            f"the header places the image twice, up to {apart:.1f} mm apart: {words[0]}, {words[1]} (LPS); "
            "keep the right one and set the other's code to 0"
        )
