"""Check for faults in NIfTI files that the NIfTI library ignores: truncated files, and NaN voxels, which it sets to 0."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np

from ..core.errors import InputError

FLOATS = {16: "f4", 64: "f8"}


def check_nifti(path: Path) -> None:
    """Refuse a NIfTI-1 file that is truncated or has NaN or infinite voxels; other files pass.

    Raises
    ------
    InputError
        If the file is truncated, or has NaN or infinite voxels.
    """
    try:
        raw = gzip.decompress(path.read_bytes()) if path.name.endswith(".gz") else path.read_bytes()
    except (EOFError, zlib.error):
        raise InputError(f"{path.name}: the file is cut short or damaged; copy it again from its source.") from None
    except gzip.BadGzipFile:
        return
    if len(raw) < 352 or raw[344:348] not in (b"n+1\0",):
        return
    order = "<" if 1 <= int(np.frombuffer(raw, "<i2", 1, 40)[0]) <= 7 else ">"
    rank, *size = np.frombuffer(raw, order + "i2", 8, 40).astype(int).tolist()
    kind, bits = np.frombuffer(raw, order + "i2", 2, 70).astype(int).tolist()
    start = int(np.frombuffer(raw, order + "f4", 1, 108)[0])
    n = int(np.prod([max(k, 1) for k in size[:rank]]))
    if len(raw) < start + n * bits // 8:
        raise InputError(f"{path.name}: the file is cut short or damaged; copy it again from its source.")
    if kind in FLOATS:
        bad = n - int(np.isfinite(np.frombuffer(raw, order + FLOATS[kind], n, start)).sum())
        if bad:
            raise InputError(
                f"{path.name}: {bad} of {n} voxels are NaN or infinite; give an image whose voxels are all numbers."
            )
