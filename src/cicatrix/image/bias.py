"""Correction of the bias field, the slow brightness variation of surface coils (N4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..core.deferred import Deferred
from ..geometry.volume import Volume

if TYPE_CHECKING:
    import SimpleITK as sitk  # noqa: N813 - the name its own manual uses
else:
    sitk = Deferred("SimpleITK")

COARSE_MM = 5.5  # voxel edge of the grid on which the bias field, which is much smoother, is estimated
ITERATIONS = (30, 20, 15)


def remove_bias(image: Volume, mask: np.ndarray) -> Volume:
    """Divide an image by its bias field, which N4 estimates on a coarse grid; the log field is interpolated to full resolution.

    Source: Tustison et al., N4ITK: improved N3 bias correction, IEEE TMI 29 (2010).

    Parameters
    ----------
    image : Volume
        (nz, ny, nx) intensities >= 0.
    mask : (nz, ny, nx) bool array
        Voxels of the body; the field is estimated from these alone.

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
    """Convert voxel values to a SimpleITK image with the spacing and origin of a grid."""
    image = sitk.GetImageFromArray(values)
    image.SetSpacing([float(s) for s in grid.spacing_mm])
    image.SetOrigin([float(o) for o in grid.origin_mm])
    return image
