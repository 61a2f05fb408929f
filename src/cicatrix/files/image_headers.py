"""The space that an image covers, read from its header: for images that are too large to be read just to be looked at."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from ..core.errors import InputError
from .grid import Grid, Note, check_grid
from .itk import sitk
from .opening import regular_file


def image_box(path: Path, note: Note) -> np.ndarray:
    """Return the lowest and the highest corner of the voxels of an image (2, 3) LPS [mm], without reading its voxels.

    Parameters
    ----------
    path : Path
        A file in a format of SimpleITK.
    note : callable
        Takes sentences on what is assumed.

    Raises
    ------
    InputError
        If the header cannot be read, or cannot be true (:func:`.grid.check_grid`).
    """
    reader = sitk.ImageFileReader()
    reader.SetFileName(str(regular_file(path)))
    try:
        reader.ReadImageInformation()
    except RuntimeError:
        raise InputError("the header of the image cannot be read; copy the file again from its source") from None
    n = reader.GetDimension()
    size, spacing, origin = (
        tuple(values[:3]) for values in (reader.GetSize(), reader.GetSpacing(), reader.GetOrigin())
    )
    directions = np.array(reader.GetDirection()).reshape(n, n)[:3, :3]
    check_grid(Grid(spacing, origin, directions), size[::-1], note)
    ends = np.array(list(product(*((-0.5, count - 0.5) for count in size))))
    corners = np.array(origin) + ends @ (directions * spacing).T
    return np.stack([corners.min(axis=0), corners.max(axis=0)])
