"""Image, labels and planned resection as volumes for the slice view of a page."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..files.images import read_image, write_volume
from ..files.pictures import picture
from ..files.segmentations import read_labels
from ..geometry.labels import Label
from ..geometry.volume import Volume
from .packing import encoded
from .run_view import RunView

EXCISED, MARGIN = 1, 2  # values in the volume of zones


def slices_of(view: RunView) -> tuple[dict[str, Any] | None, list[str]]:
    """Return picture, labels and resection of a lumpectomy, and a sentence for each part that is missing."""
    if view.kind != "lumpectomy":
        return None, []
    shown, missing = _volumes(view.folder)
    if not shown:
        return None, missing
    centre = view.manifest.get("found", {}).get("resection_centre_mm") or view.case_value("resection", "centre_mm")
    radius, margin = (view.case_value("resection", f"{name}_mm", default=0.0) for name in ("radius", "margin"))
    if centre is None or not radius:
        missing.append("The manifest does not say where the resection lies, so it is not drawn on the slices.")
    else:
        grid = next(iter(shown.values()))
        shown["zones"] = zones(grid, np.array(centre, float), radius, margin)
    return {
        "volumes": {name: encoded(nifti(volume)) for name, volume in shown.items()},
        "labels": [label.name.lower() for label in Label],
        "centre": centre,
        "radius": radius,
        "margin": margin,
        "hasPicture": "picture" in shown,
    }, missing


def _volumes(folder: Path) -> tuple[dict[str, Volume], list[str]]:
    shown, missing = {}, []
    for name, read, lack in (
        ("picture", read_image, "the slices show only the labels"),
        ("labels", read_labels, "the slices show no labels"),
    ):
        path = folder / f"{name}.nii.gz"
        try:
            shown[name] = read(path)
        except InputError as error:
            missing.append(
                f"{lack[0].upper()}{lack[1:]}: {error}" if path.exists() else f"{name}.nii.gz is missing; {lack}."
            )
    if "picture" in shown:
        shown["picture"] = shown["picture"].with_values(shown["picture"].values.astype(np.uint8))
    if "labels" in shown:
        shown["labels"] = thin_labels(shown["labels"])
    return shown, missing


def thin_labels(labels: Volume) -> Volume:
    """Subsample labels to the grid of the picture."""
    grid, _ = picture(labels)
    steps = tuple(round(a / b) for a, b in zip(grid.spacing_mm[::-1], labels.spacing_mm[::-1]))
    return labels.every((steps[0], steps[1], steps[2]))


def zones(grid: Volume, centre: np.ndarray, radius: float, margin: float) -> Volume:
    """Return which voxels are excised and which of these are the margin that should be free of tumour (nz, ny, nx) uint8."""
    z, y, x = (grid.axis(number) for number in range(3))
    away = np.sqrt((z[:, None, None] - centre[2]) ** 2 + (y[:, None] - centre[1]) ** 2 + (x - centre[0]) ** 2)
    out = np.where(away <= radius, np.where(away > radius - margin, MARGIN, EXCISED), 0)
    return grid.with_values(out.astype(np.uint8))


def nifti(volume: Volume) -> bytes:
    """Return a volume as the bytes of a NIfTI file whose header contains geometry only."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "volume.nii.gz"
        write_volume(path, volume)
        return path.read_bytes()
