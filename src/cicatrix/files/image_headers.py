"""The space that an image covers, read from its header: for images that are too large to be read just to be looked at."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np

from .grid import Note
from .images import read_grid


def image_box(path: Path, note: Note, *, axes: str | None = None, name: str | None = None) -> np.ndarray | None:
    """Return the lowest and the highest corner of the voxels of an image (2, 3) LPS [mm], without reading its voxels.

    Parameters
    ----------
    path : Path
        A NIfTI, NRRD or MetaImage file; None is returned for DICOM, whose frames must be read.
    note : callable
        Takes sentences on what is assumed.
    axes : str, optional
        Directions of the file's x, y and z in the patient, in place of what its header says.
    name : str, optional
        What errors call the image; by default the file's name.

    Raises
    ------
    InputError
        If the header cannot be read, or cannot be true (:func:`.grid.check_grid`).
    """
    found = read_grid(path, note=note, axes=axes, name=name)
    if found is None:
        return None
    size, grid = found
    ends = np.array(list(product(*((-0.5, count - 0.5) for count in size))))
    corners = np.array(grid.origin_mm or (0.0, 0.0, 0.0)) + ends @ (np.asarray(grid.directions) * grid.spacing_mm).T
    return np.stack([corners.min(axis=0), corners.max(axis=0)])
