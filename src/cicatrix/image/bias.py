"""Removal of the slow brightness drift of surface coils (N4)."""

from __future__ import annotations

import numpy as np
import SimpleITK as sitk  # noqa: N813 - the name its own manual uses

from ..geometry.volume import Volume

COARSE_MM = 5.5  # the field is smoother than this by far
ITERATIONS = (30, 20, 15)


def remove_bias(image: Volume, mask: np.ndarray) -> Volume:
    """Divide by the bias field that N4 finds on a shrunken grid; its logarithm is interpolated to full resolution.

    Source: Tustison et al., N4ITK: improved N3 bias correction, IEEE TMI 29 (2010).

    Parameters
    ----------
    image : Volume
        (nz, ny, nx) intensities >= 0.
    mask : (nz, ny, nx) bool array
        The body; only its voxels shape the field.

    Returns
    -------
    Volume
        (nz, ny, nx) float32.
    """
    full = _to_itk(image.values.astype(np.float32), image)
    factors = [max(round(COARSE_MM / s), 1) for s in image.spacing_mm]
    factors = [min(f, max(n // 4, 1)) for f, n in zip(factors, image.shape[::-1])]
    small = sitk.BinShrink(full, factors)
    inside = sitk.BinShrink(_to_itk(mask.astype(np.float32), image), factors) > 0.5
    n4 = sitk.N4BiasFieldCorrectionImageFilter()
    n4.SetMaximumNumberOfIterations(list(ITERATIONS))
    n4.Execute(sitk.Maximum(small, 1e-3), inside)
    coarse_field = n4.GetLogBiasFieldAsImage(small)
    extended = sitk.Resample(
        coarse_field, full, sitk.Transform(3, sitk.sitkIdentity), sitk.sitkLinear, 0.0, sitk.sitkFloat32, True
    )
    log_field = np.clip(sitk.GetArrayFromImage(extended), -3, 3)
    return image.with_values((image.values / np.exp(log_field)).astype(np.float32))


def _to_itk(values: np.ndarray, grid: Volume) -> sitk.Image:
    """Voxels with their geometry."""
    image = sitk.GetImageFromArray(values)
    image.SetSpacing([float(s) for s in grid.spacing_mm])
    image.SetOrigin([float(o) for o in grid.origin_mm])
    return image
