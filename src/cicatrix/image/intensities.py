"""Intensities counted from air, as segmentation and pictures need them: a ratio means nothing where 0 is somewhere else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

DARK, BRIGHT = 0.5, 99.5  # percentiles that stand for air and for the brightest tissue
OFFSET_SHARE = 0.02  # air this far below 0, relative to the range, is an offset and not noise


def from_zero(values: np.ndarray, note: Callable[[str], None]) -> np.ndarray:
    """Shift intensities so that air lies at 0, if it lies below.

    Parameters
    ----------
    values : (nz, ny, nx) float32 array
        Intensities, such as those of a file with a negative intercept.
    note : callable
        Takes the sentence that says so.

    Returns
    -------
    (nz, ny, nx) float32 array
        The same values if air is not below 0, else shifted ones >= 0.
    """
    if values.min() >= 0:
        return values
    dark, bright = (float(v) for v in np.percentile(values, (DARK, BRIGHT)))
    if -dark <= OFFSET_SHARE * (bright - dark):
        return values
    note(f"Air lies below 0 in the image: intensities are shifted by {-dark:.4g}, so that it lies at 0.")
    return np.maximum(values - np.float32(dark), np.float32(0.0))
